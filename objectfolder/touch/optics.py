"""What the sensor's camera sees of the gel."""

import math
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
import torch

from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.photographs import read_picture
from objectfolder.touch.profiles import Light, SensorProfile

#: An array, or a tensor. Both are computed with alike: NumPy is quicker at small images, torch knows GPUs.
Array = Any
Vectors = tuple[Array, Array, Array]  #: x, y and z apart, as fast code wants them

# Reflectance of a dielectric at normal incidence, as in glTF.
_DIELECTRIC = 0.04

# Bounds of cosines, as in pyrender's shader.
_COSINE = (0.001, 1)

# Two neighbouring pixels whose depths differ by more pixel pitches are on two surfaces.
_STEP = 2.0

# Images that are rendered at once on a GPU.
_CHUNK = 64


class Optics:
    """Renders the gel, lit from inside.

    An image is the background plus the difference in shading to the undeformed gel, as TACTO calibrates
    (Wang et al. 2022). Shading is glTF's metallic-roughness model under point lights, without shadows or
    interreflections.

    Parameters
    ----------
    profile : SensorProfile
    device : str or torch.device
        Where `render` works.

    Attributes
    ----------
    untouched : (3, H, W) float32 tensor
        Shading of the undeformed gel, 0 to 1.

    Raises
    ------
    ObjectFolderError
        If the profile's background picture cannot be used.
    """

    def __init__(self, profile: SensorProfile, device: str | torch.device = "cpu"):
        self.profile = profile
        self.device = torch.device(device)
        rays, gel = ray_directions(profile), gel_depth(profile)
        self._pitch = (float(rays[0, 0, 1] - rays[0, 1, 1]), float(rays[0, 0, 2] - rays[1, 0, 2]))
        along_z, along_y = np.gradient(gel, -self._pitch[1], -self._pitch[0])
        maps = np.stack([rays[..., 1], rays[..., 2], gel, along_y, along_z])
        self._maps = self._own(torch.from_numpy(maps))
        if profile.background_image:
            background = read_picture(profile.background_image, profile)
        else:
            background = _synthetic_background(profile)
        self.background = torch.from_numpy(background)
        still = 0 * self._maps[:1]
        self._still = self._display(self._maps, still, still, still)
        self.untouched = torch.as_tensor(self._still)[:, 0]

    @property
    def background(self) -> torch.Tensor:
        """The untouched sensor: the profile's picture, a synthetic one, or what was set; (H, W, 3) uint8."""
        return self._background

    @background.setter
    def background(self, picture: torch.Tensor) -> None:
        self._background = picture.to(self.device)
        self._planes = self._own(self._background.permute(2, 0, 1).contiguous())

    def render(self, displacement: torch.Tensor) -> torch.Tensor:
        """Images of the deformed gel.

        Parameters
        ----------
        displacement : (N, H, W) float32 tensor
            Metres towards the camera along the pixel rays, from `gel.deform`; exactly 0 where the gel rests.

        Returns
        -------
        (N, H, W, 3) uint8 tensor, RGB, on the device of the optics. Each image has the same bits whatever
        else is in the batch.
        """
        images = torch.empty(*displacement.shape, 3, dtype=torch.uint8, device=self.device)
        library = _library(self._planes)
        # One at a time on a CPU, whose caches hold no more.
        chunk = 1 if self.device.type == "cpu" else _CHUNK
        for out, moved in zip(images.split(chunk), displacement.split(chunk)):
            levels = self._change(self._own(moved))
            levels += self._planes
            library.round(levels, out=levels)
            library.clip(levels, 0, 255, out=levels)
            # To bytes first: what takes long is to spread three planes over the pixels.
            planes = library.empty(levels.shape, dtype=library.uint8, device=levels.device)
            planes[:] = levels
            pixels = out.numpy() if library is np else out
            for channel in range(3):
                pixels[..., channel] = planes[:, channel]
        return images

    def change(self, displacement: torch.Tensor) -> torch.Tensor:
        """Grey levels (N, 3, H, W), float32, by which a displacement (N, H, W) brightens the image."""
        return torch.as_tensor(self._change(self._own(displacement)))

    def noise(self, images: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Add the camera's pixel noise to (N, H, W, 3) uint8 images; none if the profile has none."""
        if self.profile.noise_std == 0:
            return images
        noise = torch.randn(images.shape, generator=generator) * self.profile.noise_std
        return (images + noise.to(images.device)).round().clamp(0, 255).to(torch.uint8)

    def _own(self, values: torch.Tensor) -> Array:
        """Values in single precision, as and where the optics compute."""
        values = values.to(self.device, torch.float32)
        return values.numpy() if self.device.type == "cpu" else values

    def _change(self, displacement: Array) -> Array:
        rows, columns = self._window(displacement)
        moved = displacement[:, rows, columns]
        display = self._display(self._maps[:, rows, columns], moved, *self._slopes(moved))
        display -= self._still[:, :, rows, columns]
        display *= 255 * self.profile.gain
        display *= moved != 0  # exactly none where the gel is at rest
        change = _zeros((len(displacement), 3, *displacement.shape[1:]), displacement)
        for channel, brighter in enumerate(display):
            change[:, channel, rows, columns] = brighter
        return blur(change, self.profile.image_smoothing / self.profile.pixel_pitch)

    def _display(self, maps: Array, moved: Array, slope_y: Array, slope_z: Array) -> Array:
        """Display values (3, N, H, W) of a displacement (N, H, W) with its derivatives along the image."""
        y, z, gel, gel_y, gel_z = maps
        depth, along_y, along_z = gel - moved, gel_y - slope_y, gel_z - slope_z
        normal = unit((-(depth + y * along_y + z * along_z), along_y, along_z))
        return shade((depth, y * depth, z * depth), normal, self.profile)

    def _slopes(self, displacement: Array) -> Array:
        """Derivatives (2, N, H, W) of the displacement along y and z of the image plane.

        Gaussian-weighted means of the differences between neighbours. Those across a step, or across the
        rim of the contact, where the slope jumps, do not count: the edge stays sharp.
        """
        inside = displacement != 0
        step = _STEP * self.profile.pixel_pitch
        weights = _gaussian(self.profile.slope_smoothing / self.profile.pixel_pitch)
        around = len(weights) - 1  # pixels of nothing, for the blur
        count, height, width = displacement.shape
        padded = _zeros((3, count, height + 2 * around, width + 2 * around), displacement)
        sums = padded[:, :, around : around + height, around : around + width]
        for total, pitch, axis in zip(sums, self._pitch, (-1, -2)):
            here, ahead = _neighbours(displacement, axis)
            difference = here - ahead
            counts = abs(difference) < step
            for among in _neighbours(inside, axis):
                counts &= among
            difference *= counts
            # To both pixels that the difference lies between; half, where both neighbours count.
            weight = _zeros(displacement.shape, displacement)
            for to, of in zip(_neighbours(total, axis), _neighbours(weight, axis)):
                to += difference
                of += counts
            total /= weight.clip(1, 2) * pitch
        sums[2] = inside
        smooth = _weighted(_weighted(padded, weights, -1), weights, -2)
        return smooth[:2] / smooth[2].clip(1e-12, 1)

    def _window(self, displacement: Array) -> tuple[slice, slice]:
        """Rows and columns that hold every displaced pixel; all on a GPU, which need not wait then."""
        height, width = displacement.shape[1:]
        whole = slice(0, height), slice(0, width)
        if self.device.type != "cpu":
            return whole
        if (
            displacement[:, [0, -1]].any(axis=(0, 2)).all()
            and displacement[..., [0, -1]].any(axis=(0, 1)).all()
        ):
            return whole
        found = [np.flatnonzero(displacement.any(axis=axes)) for axes in ((0, 2), (0, 1))]
        rows, columns = (slice(int(f[0]), int(f[-1]) + 1) if f.size else slice(0, 1) for f in found)
        return rows, columns


def shade(point: Vectors, normal: Vectors, profile: SensorProfile) -> Array:
    """Display values of surface points under the profile's point lights.

    Parameters
    ----------
    point : three (...) float32 arrays or tensors
        Metres, camera frame.
    normal : three (...) float32 arrays or tensors
        Unit, towards the camera.
    profile : SensorProfile

    Returns
    -------
    (3, ...) float32 array or tensor, 0 to 1
    """
    library = _library(point[0])
    square, height = _dot(point, point), _dot(normal, point)
    to_camera = library.sqrt(square)
    normal_view = -height / to_camera
    # From here on with an axis of lights in front.
    lights = _positions(profile.lights, square)
    point_light = _dot(point, lights)
    distance = library.sqrt(point_light * -2 + square + _dot(lights, lights))
    normal_light = (_dot(normal, lights) - height) / distance
    view_light = (point_light / -to_camera + to_camera) / distance
    reflectance = ggx_reflectance(normal_view, normal_light, view_light, profile)
    reflected = reflectance * normal_light.clip(*_COSINE) / distance / distance
    radiance = _zeros((3, *square.shape), square) + profile.ambient
    for source, light in zip(profile.lights, reflected):
        for channel, weight in zip(radiance, source.color):
            if weight:
                channel += light * (weight * source.intensity)
    return library.exp(library.log(radiance.clip(1e-30, 1)) / profile.gamma)  # a power, twice as fast


def ggx_reflectance(
    normal_view: Array, normal_light: Array, view_light: Array, profile: SensorProfile
) -> Array:
    """Reflectance of glTF's metallic-roughness model (glTF 2.0, appendix B).

    A Lambert base under a GGX layer with Smith's shadowing, in the approximation by Schlick, and Schlick's
    Fresnel term; cosines and denominator are bounded as in pyrender's shader. With the half vector
    h = (l + v) / sqrt(2 (1 + l·v)), the cosines of the terms are

        n·h = (n·l + n·v) / sqrt(2 (1 + l·v)),    v·h = sqrt((1 + l·v) / 2).

    Parameters
    ----------
    normal_view, normal_light, view_light : (...) float32 arrays or tensors
        Cosines between the unit normal n and the directions v to the camera and l to the light.
    profile : SensorProfile
        Its albedo, roughness and metallic.

    Returns
    -------
    (...) float32 array or tensor, 1/sr
    """
    albedo, metallic = profile.albedo, profile.metallic
    f0 = _DIELECTRIC * (1 - metallic) + albedo * metallic
    diffuse = albedo * (1 - _DIELECTRIC) * (1 - metallic) / math.pi
    alpha2 = profile.roughness**4
    k = (profile.roughness + 1) ** 2 / 8

    cos_view, cos_light = abs(normal_view).clip(*_COSINE), normal_light.clip(*_COSINE)
    one_plus_view_light = (view_light + 1).clip(1e-12, 2)
    twice_half = (normal_light + normal_view).clip(0, 2)  # n·(l + v)
    spread = (twice_half * twice_half / one_plus_view_light * ((alpha2 - 1) / 2) + 1).clip(alpha2, 1)
    grazing = _library(view_light).sqrt(one_plus_view_light * 0.5) - 1  # v·h - 1
    grazing2 = grazing * grazing
    fresnel = grazing2 * grazing2 * grazing * (f0 - 1) + f0
    shadowing_view = cos_view / (cos_view * (1 - k) + k)
    shadowing_light = cos_light * (1 - k) + k
    denominator = (cos_light * (4 * cos_view) + 0.001) * spread * spread * shadowing_light
    specular = cos_light * (shadowing_view * (alpha2 / math.pi)) / denominator
    return (specular - diffuse) * fresnel + diffuse


def blur(images: Array, sigma: float) -> Array:
    """Gaussian blur of (N, C, H, W) float images; ``sigma`` in pixels, 0 for none.

    Cut off at two deviations (rounded up), mirrored at the border. A sum of shifted images: its bits do not
    depend on the batch.
    """
    if sigma == 0:
        return images
    weights = _gaussian(sigma)
    radius = len(weights) - 1
    count, channels, height, width = images.shape
    padded = _zeros((count, channels, height + 2 * radius, width + 2 * radius), images)
    padded[..., radius:-radius, radius:-radius] = images
    flip = _library(images).flip
    for axis in (-1, -2):
        for side, inner in ((0, radius + 1), (-radius, -2 * radius - 1)):
            margin = _cut(padded, axis, side, radius)
            margin[:] = flip(_cut(padded, axis, inner, radius), (axis,))
    return _weighted(_weighted(padded, weights, -1), weights, -2)


def unit(a: Vectors) -> Vectors:
    """Vectors of length 1."""
    length = _library(a[0]).sqrt(_dot(a, a))
    return a[0] / length, a[1] / length, a[2] / length


def _dot(a: Vectors, b: Vectors) -> Array:
    total = a[0] * b[0]
    total += a[1] * b[1]
    total += a[2] * b[2]
    return total


def _weighted(images: Array, weights: list[float], axis: int) -> Array:
    """Sum of shifted images with symmetric weights, given from the centre on; shorter by the shifts."""
    radius = len(weights) - 1
    size = images.shape[axis] - 2 * radius
    total = _cut(images, axis, radius, size) * weights[0]
    for shift in range(1, radius + 1):
        pair = _cut(images, axis, radius - shift, size) + _cut(images, axis, radius + shift, size)
        pair *= weights[shift]
        total += pair
    return total


def _neighbours(images: Array, axis: int) -> tuple[Array, Array]:
    """All but the last and all but the first along an axis."""
    return _cut(images, axis, 0, -1), _cut(images, axis, 1, -1)


def _cut(images: Array, axis: int, start: int, size: int) -> Array:
    """Part of the last axis (-1) or the one before (-2); a negative size is what is not in it."""
    start %= images.shape[axis]
    stop = start + (size if size >= 0 else images.shape[axis] + size)
    return images[..., start:stop] if axis == -1 else images[..., start:stop, :]


def _library(of: Array) -> ModuleType:
    return torch if isinstance(of, torch.Tensor) else np


def _zeros(shape: tuple[int, ...], like: Array) -> Array:
    library = _library(like)
    return library.zeros(shape, dtype=library.float32, device=like.device)


def _positions(lights: tuple[Light, ...], like: Array) -> Array:
    """Positions of the lights, to be computed with maps; (3, L, 1...) float32."""
    places = np.array([light.position for light in lights], np.float32).T.reshape(3, -1, *[1] * like.ndim)
    return places if _library(like) is np else torch.as_tensor(places, device=like.device)


@lru_cache(maxsize=64)
def _gaussian(sigma: float) -> list[float]:
    """Right half of a normalised discrete Gaussian, from its centre; deviation 0 is a point."""
    if sigma == 0:
        return [1.0]
    weights = np.exp(-(np.arange(math.ceil(2 * sigma) + 1) ** 2) / (2 * sigma**2))
    return (weights / (2 * weights.sum() - 1)).tolist()


def _synthetic_background(profile: SensorProfile) -> np.ndarray:
    """A dim grey with each light's glow on its side of the gel; (H, W, 3) uint8."""
    rays, gel = ray_directions(profile), gel_depth(profile)
    display = np.empty((*gel.shape, 3))
    display[:] = profile.background_color
    for light in profile.lights:
        distance = np.hypot(*(light.position[i] - rays[..., i] * gel for i in (1, 2)))
        distance -= distance.min()
        glow = profile.background_glow / (1 + (distance / profile.background_falloff) ** 2)
        display += glow[..., None] * np.array(light.color)
    return (255 * display).round().clip(0, 255).astype(np.uint8)
