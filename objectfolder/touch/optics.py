"""Camera images of the deformed gel."""

import numpy as np
import torch

from objectfolder.touch.arrays import (
    Array,
    array_library,
    blur,
    convolve,
    gaussian_weights,
    neighbours,
    zeros,
)
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.residual import places, residual_levels, tilt
from objectfolder.touch.shading import Vectors, shade, unit_components

# Neighbouring pixels whose depths differ by more pixel pitches than this lie on different surfaces.
_MAX_STEP = 2.0

_GPU_BATCH = 64  # images that a GPU renders at once


class Optics:
    """Renderer of the gel, lit from inside, on a device.

    An image is the background plus the change in shading from the undeformed gel, as in TACTO's calibration
    (Wang et al. 2022), plus the profile's residual, if it has one. Shading is glTF's metallic-roughness model
    under point lights, without shadows or interreflections. ``untouched`` (3, H, W) float32 is the shading of
    the undeformed gel, 0 to 1. Raises ObjectFolderError if the profile's background picture cannot be used.
    """

    def __init__(self, profile: SensorProfile, device: str | torch.device = "cpu"):
        self.profile = profile
        self.device = torch.device(device)
        rays, gel = ray_directions(profile), gel_depth(profile)
        self._pitch = (float(rays[0, 0, 1] - rays[0, 1, 1]), float(rays[0, 0, 2] - rays[1, 0, 2]))
        along_z, along_y = np.gradient(gel, -self._pitch[1], -self._pitch[0])
        maps = np.stack([rays[..., 1], rays[..., 2], gel, along_y, along_z])
        self._maps = self._array(torch.from_numpy(maps))
        self._places = self._array(torch.from_numpy(places(profile)))
        if profile.background_image:
            from objectfolder.touch.photographs import read_photograph  # loads PIL

            background = read_photograph(profile.background_image, profile)
        else:
            background = _synthetic_background(profile)
        self.background = torch.from_numpy(background)
        still = 0 * self._maps[:1]
        self._still = self._display(self._maps, still, still, still)
        self.untouched = torch.as_tensor(self._still)[:, 0]

    @property
    def background(self) -> torch.Tensor:
        """Image of the untouched sensor, (H, W, 3) uint8: the profile's photograph, or a synthetic one.

        It can be replaced.
        """
        return self._background

    @background.setter
    def background(self, picture: torch.Tensor) -> None:
        self._background = picture.to(self.device)
        self._planes = self._array(self._background.permute(2, 0, 1).contiguous())

    def render(self, displacement: torch.Tensor) -> torch.Tensor:
        """Return images (N, H, W, 3) uint8, RGB, of the deformed gel, on the device of the optics.

        Displacements (N, H, W) float32 are metres towards the camera along the pixel rays, from `gel.deform`;
        exactly 0 where the gel rests. The bits of an image do not depend on the rest of the batch.
        """
        images = torch.empty(*displacement.shape, 3, dtype=torch.uint8, device=self.device)
        library = array_library(self._planes)
        # One at a time on a CPU: more do not fit into its caches.
        chunk = 1 if self.device.type == "cpu" else _GPU_BATCH
        for out, moved in zip(images.split(chunk), displacement.split(chunk)):
            levels = self._change(self._array(moved))
            levels += self._planes
            library.round(levels, out=levels)
            library.clip(levels, 0, 255, out=levels)
            # Convert to bytes first: interleaving the three planes is the slow part.
            planes = library.empty(levels.shape, dtype=library.uint8, device=levels.device)
            planes[:] = levels
            pixels = out.numpy() if library is np else out
            for channel in range(3):
                pixels[..., channel] = planes[:, channel]
        return images

    def change(self, displacement: torch.Tensor) -> torch.Tensor:
        """Return the change in grey levels, (N, 3, H, W) float32, that displacements (N, H, W) cause."""
        return torch.as_tensor(self._change(self._array(displacement)))

    def tilted(self, slope_y: np.ndarray, slope_z: np.ndarray) -> np.ndarray:
        """Return the change in grey levels of a gel that is only tilted, everywhere; (3, N, H, W) float32.

        Slopes (N,) are derivatives of the displacement along y and z.
        """
        slopes = np.stack([slope_y, slope_z]).astype(np.float32)[..., None, None]
        slopes = self._array(torch.from_numpy(slopes)) * self._maps[2]
        change = self._display(self._maps, 0 * slopes[0], *slopes) - self._still
        change *= 255 * self.profile.gain
        if self.profile.residual:
            leaning = tilt(slopes, self._maps[2])
            change += residual_levels(leaning, self._places[:, None], self.profile.residual)
        return np.asarray(torch.as_tensor(change).cpu())

    def surface(self, displacement: torch.Tensor) -> tuple[Vectors, Vectors, Array]:
        """Return points, unit normals and tilt of a gel displaced by (N, H, W); see `shade`, ``tilt``."""
        moved = self._array(displacement)
        slopes = self._slopes(moved)
        return *self._geometry(self._maps, moved, *slopes), tilt(slopes, self._maps[2])

    def noise(self, images: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Add the profile's pixel noise, if any, to (N, H, W, 3) uint8 images."""
        if self.profile.noise_std == 0:
            return images
        noise = torch.randn(images.shape, generator=generator) * self.profile.noise_std
        return (images + noise.to(images.device)).round().clamp(0, 255).to(torch.uint8)

    def _array(self, values: torch.Tensor) -> Array:
        """Convert values to what the optics compute with: float32, a NumPy array on the CPU."""
        values = values.to(self.device, torch.float32)
        return values.numpy() if self.device.type == "cpu" else values

    def _change(self, displacement: Array) -> Array:
        rows, columns = self._window(displacement)
        moved = displacement[:, rows, columns]
        slopes = self._slopes(moved)
        still = self._still[:, :, rows, columns]
        display = self._display(self._maps[:, rows, columns], moved, *slopes) - still
        display *= 255 * self.profile.gain
        if self.profile.residual:
            leaning = tilt(slopes, self._maps[2, rows, columns])
            display += residual_levels(leaning, self._places[:, rows, columns], self.profile.residual)
        display *= moved != 0  # exactly 0 where the gel is at rest
        change = zeros((len(displacement), 3, *displacement.shape[1:]), displacement)
        for channel, brighter in enumerate(display):
            change[:, channel, rows, columns] = brighter
        return blur(change, self.profile.image_smoothing / self.profile.pixel_pitch)

    def _display(self, maps: Array, moved: Array, slope_y: Array, slope_z: Array) -> Array:
        """Return display values (3, N, H, W) of a displacement (N, H, W) with the given slopes."""
        return shade(*self._geometry(maps, moved, slope_y, slope_z), self.profile)

    @staticmethod
    def _geometry(maps: Array, moved: Array, slope_y: Array, slope_z: Array) -> tuple[Vectors, Vectors]:
        """Return points and unit normals of the gel, moved (N, H, W) with the given slopes."""
        y, z, gel, gel_y, gel_z = maps
        depth, along_y, along_z = gel - moved, gel_y - slope_y, gel_z - slope_z
        normal = unit_components((-(depth + y * along_y + z * along_z), along_y, along_z))
        return (depth, y * depth, z * depth), normal

    def _slopes(self, displacement: Array) -> Array:
        """Return the derivatives (2, N, H, W) of the displacement along y and z of the image plane.

        Gaussian-weighted means of the differences between neighbouring pixels. Differences across a step or
        across the rim of the contact, where the slope jumps, are left out to keep edges sharp.
        """
        inside = displacement != 0
        step = _MAX_STEP * self.profile.pixel_pitch
        weights = gaussian_weights(self.profile.slope_smoothing / self.profile.pixel_pitch)
        around = len(weights) - 1  # border of zeros, for the filter
        count, height, width = displacement.shape
        padded = zeros((3, count, height + 2 * around, width + 2 * around), displacement)
        sums = padded[:, :, around : around + height, around : around + width]
        for i, (pitch, axis) in enumerate(zip(self._pitch, (-1, -2))):
            here, ahead = neighbours(displacement, axis)
            difference = here - ahead
            counts = abs(difference) < step
            for among in neighbours(inside, axis):
                counts &= among
            difference *= counts
            # Each difference belongs to the pixels on both sides; a pixel with two takes their mean.
            total, weight = (zeros(displacement.shape, displacement) for _ in range(2))
            for side in range(2):  # torch's views are stale after their base has changed
                to, of = (neighbours(image, axis)[side] for image in (total, weight))
                to += difference
                of += counts
            sums[i] = total / (weight.clip(1, 2) * pitch)
        sums[2] = inside
        smooth = convolve(padded, weights)
        return smooth[:2] / smooth[2].clip(1e-12, 1)

    def _window(self, displacement: Array) -> tuple[slice, slice]:
        """Return the rows and columns that hold all displaced pixels; on a GPU all, to avoid a wait."""
        height, width = displacement.shape[1:]
        whole = slice(0, height), slice(0, width)
        if self.device.type != "cpu":
            return whole
        ends = displacement[:, [0, -1]].any(axis=(0, 2)), displacement[..., [0, -1]].any(axis=(0, 1))
        if np.all(ends):
            return whole
        found = [np.flatnonzero(displacement.any(axis=axes)) for axes in ((0, 2), (0, 1))]
        rows, columns = (slice(int(f[0]), int(f[-1]) + 1) if f.size else slice(0, 1) for f in found)
        return rows, columns


def _synthetic_background(profile: SensorProfile) -> np.ndarray:
    """Return a dim grey with each light's glow on its side of the gel; (H, W, 3) uint8."""
    rays, gel = ray_directions(profile), gel_depth(profile)
    display = np.empty((*gel.shape, 3))
    display[:] = profile.background_color
    for light in profile.lights:
        distance = np.hypot(*(light.position[i] - rays[..., i] * gel for i in (1, 2)))
        distance -= distance.min()
        glow = profile.background_glow / (1 + (distance / profile.background_falloff) ** 2)
        display += glow[..., None] * np.array(light.color)
    return (255 * display).round().clip(0, 255).astype(np.uint8)
