"""What the sensor's camera sees of the gel."""

import math
from functools import lru_cache

import numpy as np
import torch
from torch.nn.functional import pad

from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.photographs import read_picture
from objectfolder.touch.profiles import Light, SensorProfile

Vectors = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  #: x, y and z apart, as fast code wants them

# Reflectance of a dielectric at normal incidence, as in glTF.
_DIELECTRIC = 0.04

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
    background : (H, W, 3) uint8 tensor
        The untouched sensor: the profile's picture, or a synthetic one.
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
        rays = torch.from_numpy(ray_directions(profile))
        gel = torch.from_numpy(gel_depth(profile))
        self._pitch = (float(rays[0, 0, 1] - rays[0, 1, 1]), float(rays[0, 0, 2] - rays[1, 0, 2]))
        along_z, along_y = torch.gradient(gel, spacing=(-self._pitch[1], -self._pitch[0]))
        maps = torch.stack([rays[..., 1], rays[..., 2], gel, along_y, along_z])
        self._maps = maps.float().to(self.device)
        if profile.background_image:
            background = read_picture(profile.background_image, profile)
        else:
            background = _synthetic_background(profile)
        self.background = torch.from_numpy(background).to(self.device)
        still = torch.zeros_like(self._maps[:1])
        self.untouched = self._display(self._maps, still, still, still)[:, 0]

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
        background = self.background.permute(2, 0, 1).float()
        # One at a time on a CPU: which of its instructions compute a pixel depends on the place in the batch.
        chunk = 1 if self.device.type == "cpu" else _CHUNK
        for out, moved in zip(images.split(chunk), displacement.to(self.device).float().split(chunk)):
            levels = self.change(moved).add_(background).round_().clamp_(0, 255)
            torch.stack(levels.to(torch.uint8).unbind(1), dim=-1, out=out)
        return images

    def change(self, displacement: torch.Tensor) -> torch.Tensor:
        """Grey levels (N, 3, H, W), float32, by which a displacement (N, H, W) brightens the image."""
        sigma = self.profile.image_smoothing / self.profile.pixel_pitch
        return blur(self._sharp_change(displacement.to(self.device).float()), sigma)

    def noise(self, images: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Add the camera's pixel noise to (N, H, W, 3) uint8 images; none if the profile has none."""
        if self.profile.noise_std == 0:
            return images
        noise = torch.randn(images.shape, generator=generator) * self.profile.noise_std
        return (images + noise.to(images.device)).round().clamp(0, 255).to(torch.uint8)

    def _sharp_change(self, displacement: torch.Tensor) -> torch.Tensor:
        """As `change`, before the optical blur."""
        rows, columns = self._window(displacement)
        moved = displacement[:, rows, columns].contiguous()
        maps = self._maps[:, rows, columns].contiguous()
        display = self._display(maps, moved, *self._slopes(moved))
        display -= self.untouched[:, None, rows, columns]
        # Exactly none where the gel is at rest.
        display *= moved.sign().abs_().mul_(255 * self.profile.gain)
        display = display.transpose(0, 1)
        if moved.shape == displacement.shape:
            return display
        change = torch.zeros(len(displacement), 3, *displacement.shape[1:], device=self.device)
        change[:, :, rows, columns] = display
        return change

    def _display(
        self, maps: torch.Tensor, moved: torch.Tensor, slope_y: torch.Tensor, slope_z: torch.Tensor
    ) -> torch.Tensor:
        """Display values (3, N, H, W) of a displacement (N, H, W) with its derivatives along the image."""
        y, z, gel, gel_y, gel_z = maps
        depth, along_y, along_z = gel - moved, gel_y - slope_y, gel_z - slope_z
        normal = unit((-(depth + y * along_y + z * along_z), along_y, along_z))
        return shade((depth, y * depth, z * depth), normal, self.profile)

    def _slopes(self, displacement: torch.Tensor) -> torch.Tensor:
        """Derivatives (2, N, H, W) of the displacement along y and z of the image plane.

        Gaussian-weighted means of the differences between neighbours. Those across a step, or across the
        rim of the contact, where the slope jumps, do not count: the edge stays sharp.
        """
        # Masks of ones and zeros: torch is slow with truth values.
        inside = displacement.sign().abs_()
        apart = displacement + (1 - inside)  # the rim is a step of about a metre
        step = _STEP * self.profile.pixel_pitch
        weights = _gaussian(self.profile.slope_smoothing / self.profile.pixel_pitch)
        around = len(weights) - 1  # pixels of nothing, for the blur
        count, height, width = displacement.shape
        padded = torch.zeros(3, count, height + 2 * around, width + 2 * around, device=self.device)
        sums = padded.narrow(-1, around, width).narrow(-2, around, height)
        for total, pitch, axis in zip(sums, self._pitch, (2, 1)):
            here, ahead = _neighbours(apart, axis)
            difference = here - ahead
            counts = (step - difference.abs()).sign_().clamp_min_(0)
            difference *= counts
            # To both pixels that the difference lies between; half, where both neighbours count.
            weight = torch.zeros_like(displacement)
            for to, of in zip(_neighbours(total, axis), _neighbours(weight, axis)):
                to += difference
                of += counts
            total /= weight.clamp_min_(1).mul_(pitch)
        sums[2] = inside
        smooth = _weighted(_weighted(padded, weights, -1), weights, -2)
        return smooth[:2].div_(smooth[2].clamp_min_(1e-12))

    def _window(self, displacement: torch.Tensor) -> tuple[slice, slice]:
        """Rows and columns that hold every displaced pixel; all on a GPU, which need not wait then."""
        height, width = displacement.shape[1:]
        if self.device.type != "cpu":
            return slice(0, height), slice(0, width)
        moved = displacement.numpy() != 0
        if moved[:, [0, -1]].any(axis=(0, 2)).all() and moved[:, :, [0, -1]].any(axis=(0, 1)).all():
            return slice(0, height), slice(0, width)
        found = [np.flatnonzero(moved.any(axis=axes)) for axes in ((0, 2), (0, 1))]
        rows, columns = (slice(int(f[0]), int(f[-1]) + 1) if f.size else slice(0, 1) for f in found)
        return rows, columns


def shade(point: Vectors, normal: Vectors, profile: SensorProfile) -> torch.Tensor:
    """Display values of surface points under the profile's lights.

    Lambert and GGX with Smith's and Schlick's terms (glTF 2.0, appendix B), with the bounds that pyrender's
    shader puts on the cosines.

    Parameters
    ----------
    point : three (...) float32 tensors
        Metres, camera frame.
    normal : three (...) float32 tensors
        Unit, towards the camera.
    profile : SensorProfile

    Returns
    -------
    (3, ...) float32 tensor, 0 to 1
    """
    f0 = _DIELECTRIC * (1 - profile.metallic) + profile.albedo * profile.metallic
    diffuse = profile.albedo * (1 - _DIELECTRIC) * (1 - profile.metallic) / math.pi
    alpha2 = profile.roughness**4
    k = (profile.roughness + 1) ** 2 / 8

    square, height = _dot(point, point), _dot(normal, point)
    inverse_size = square.rsqrt()
    size, facing = square * inverse_size, (height * inverse_size).neg_()
    # With an axis of lights in front from here on; in place, because memory is what takes the time.
    at = _positions(profile.lights, size.device).reshape(3, -1, *[1] * size.dim())
    light_view, lit = _dot(point, at), _dot(normal, at)
    inverse = torch.add(square, light_view, alpha=-2).add_(_dot(at, at)).rsqrt_()
    light_view.mul_(inverse_size).neg_().add_(size).mul_(inverse).add_(1).clamp_min_(1e-12)
    lit.sub_(height).mul_(inverse)

    cos_view = facing.abs().clamp_(0.001, 1)
    cos_light = lit.clamp(0.001, 1)
    # The half vector h = (l + v) / |l + v| enters by its products only, and |l + v|² = 2 (1 + l·v).
    spread = lit.add_(facing).clamp_min_(0)
    spread.mul_(spread).div_(light_view).mul_((alpha2 - 1) / 2).add_(1).clamp_min_(alpha2)
    grazing = light_view.mul_(0.5).sqrt_().neg_().add_(1)
    fresnel = grazing * grazing
    fresnel.mul_(fresnel).mul_(grazing).mul_(1 - f0).add_(f0)
    divisor = torch.mul(cos_light, 4 * cos_view, out=grazing).add_(0.001).mul_(spread).mul_(spread)
    divisor.mul_(torch.mul(cos_light, 1 - k, out=spread).add_(k))
    # Shadowing, and the constant of the distribution.
    view_term = cos_view / (cos_view * (1 - k) + k) * (alpha2 / math.pi)
    specular = torch.mul(cos_light, view_term, out=spread).div_(divisor)
    reflected = specular.sub_(diffuse).mul_(fresnel).add_(diffuse).mul_(cos_light)
    reflected.mul_(inverse).mul_(inverse)
    radiance = torch.full((3, *size.shape), profile.ambient, device=size.device)
    for light, seen in zip(profile.lights, reflected):
        for total, weight in zip(radiance, light.color):
            if weight:
                total.add_(seen, alpha=weight * light.intensity)
    return radiance.clamp_(0, 1).log_().div_(profile.gamma).exp_()  # twice as fast as a power


@lru_cache(maxsize=64)  # of sensors
def _positions(lights: tuple[Light, ...], device: torch.device) -> torch.Tensor:
    """(3, L) float32."""
    return torch.tensor([light.position for light in lights], device=device).T


def blur(images: torch.Tensor, sigma: float) -> torch.Tensor:
    """Gaussian blur of (N, C, H, W) float images; ``sigma`` in pixels, 0 for none.

    Cut off at two deviations (rounded up), mirrored at the border. A sum of shifted images: its bits do not
    depend on the batch.
    """
    weights = _gaussian(sigma)
    radius = len(weights) - 1
    images = pad(images, (radius,) * 4, mode="reflect")
    for axis in (-1, -2):
        images = _weighted(images, weights, axis)
    return images


def _weighted(images: torch.Tensor, weights: list[float], axis: int) -> torch.Tensor:
    """Sum of shifted images, with symmetric weights from the centre; shorter by the shifts."""
    radius = len(weights) - 1
    size = images.shape[axis] - 2 * radius
    total = images.narrow(axis, radius, size) * weights[0]
    for shift in range(1, radius + 1):
        for start in (radius - shift, radius + shift):
            total.add_(images.narrow(axis, start, size), alpha=weights[shift])
    return total


@lru_cache(maxsize=64)  # of sensors
def _gaussian(sigma: float) -> list[float]:
    """Right half of a normalised discrete Gaussian, from its centre; deviation 0 is a point."""
    if sigma == 0:
        return [1.0]
    weights = np.exp(-(np.arange(math.ceil(2 * sigma) + 1) ** 2) / (2 * sigma**2))
    return (weights / (2 * weights.sum() - 1)).tolist()


def unit(a: Vectors) -> Vectors:
    """Vectors of length 1."""
    scale = _dot(a, a).rsqrt()
    return a[0] * scale, a[1] * scale, a[2] * scale


def _neighbours(images: torch.Tensor, axis: int) -> tuple[torch.Tensor, torch.Tensor]:
    """All but the last and all but the first along an axis."""
    size = images.shape[axis] - 1
    return images.narrow(axis, 0, size), images.narrow(axis, 1, size)


def _dot(a: Vectors, b: Vectors) -> torch.Tensor:
    return torch.addcmul(torch.addcmul(a[0] * b[0], a[1], b[1]), a[2], b[2])


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
