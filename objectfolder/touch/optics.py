"""What the sensor's camera sees of the gel."""

import math

import numpy as np
import torch
from torch.nn.functional import pad

from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.profiles import SensorProfile

Vectors = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  #: x, y and z apart, as fast code wants them

# Reflectance of a dielectric at normal incidence, as in glTF.
_DIELECTRIC = 0.04

# Two neighbouring pixels whose depths differ by more pixel pitches are on two surfaces.
_STEP = 2.0

# Of the gel's slopes, pixels: what finite differences of a faceted imprint need.
_SLOPE_SIGMA = 1.0

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
        The untouched sensor; synthetic, a function of the profile only.
    untouched : (1, 3, H, W) float32 tensor
        Shading of the undeformed gel, 0 to 1.
    """

    def __init__(self, profile: SensorProfile, device: str | torch.device = "cpu"):
        self.profile = profile
        self.device = torch.device(device)
        rays = torch.from_numpy(ray_directions(profile))
        gel = torch.from_numpy(gel_depth(profile))
        self._pitch = (float(rays[0, 0, 1] - rays[0, 1, 1]), float(rays[0, 0, 2] - rays[1, 0, 2]))
        along_z, along_y = torch.gradient(gel, spacing=(-self._pitch[1], -self._pitch[0]))
        maps = (rays[..., 1], rays[..., 2], gel, along_y, along_z)
        self._y, self._z, self._gel, self._gel_y, self._gel_z = (m.float().to(self.device) for m in maps)
        self.background = _synthetic_background(profile, rays.numpy(), gel.numpy()).to(self.device)
        self.untouched = self._display(torch.zeros_like(self._gel)[None])

    def render(self, displacement: torch.Tensor) -> torch.Tensor:
        """Images of the deformed gel.

        Parameters
        ----------
        displacement : (N, H, W) float32 tensor
            Metres towards the camera along the pixel rays, from `gel.deform`.

        Returns
        -------
        (N, H, W, 3) uint8 tensor, RGB, on the device of the optics. Each image has the same bits whatever
        else is in the batch.
        """
        images = torch.empty(*displacement.shape, 3, dtype=torch.uint8, device=self.device)
        background = self.background.permute(2, 0, 1).float()
        sigma = self.profile.image_smoothing / self.profile.pixel_pitch
        # One at a time on a CPU: which of its instructions compute a pixel depends on the place in the batch.
        chunk = 1 if self.device.type == "cpu" else _CHUNK
        for out, moved in zip(images.split(chunk), displacement.to(self.device).float().split(chunk)):
            change = 255 * self.profile.gain * (self._display(moved) - self.untouched)
            out.copy_((background + blur(change, sigma)).round().clamp(0, 255).permute(0, 2, 3, 1))
        return images

    def noise(self, images: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Add the camera's pixel noise to (N, H, W, 3) uint8 images; none if the profile has none."""
        if self.profile.noise_std == 0:
            return images
        noise = torch.randn(images.shape, generator=generator) * self.profile.noise_std
        return (images + noise.to(images.device)).round().clamp(0, 255).to(torch.uint8)

    def _display(self, displacement: torch.Tensor) -> torch.Tensor:
        """Display values (N, 3, H, W) of the gel, displaced by (N, H, W)."""
        depth = self._gel - displacement
        slope_y, slope_z = self._slopes(displacement)
        along_y, along_z = self._gel_y - slope_y, self._gel_z - slope_z
        normal = unit((-(depth + self._y * along_y + self._z * along_z), along_y, along_z))
        return shade((depth, self._y * depth, self._z * depth), normal, self.profile)

    def _slopes(self, displacement: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Derivatives of the displacement along the two coordinates of the image plane.

        Gaussian-weighted means of the differences between neighbours. Those across a step, or across the
        rim of the contact, where the slope jumps, do not count: the edge stays sharp.
        """
        inside = displacement > 0
        step = _STEP * self.profile.pixel_pitch
        slopes = []
        for axis, pitch in zip((2, 1), self._pitch):
            size = displacement.shape[axis] - 1
            ahead, here = displacement.narrow(axis, 1, size), displacement.narrow(axis, 0, size)
            difference = here - ahead
            counts = inside.narrow(axis, 1, size) & inside.narrow(axis, 0, size) & (difference.abs() < step)
            weight = counts.float()
            total, weight = (
                _smooth_differences(values, axis, _SLOPE_SIGMA) for values in (difference * weight, weight)
            )
            slopes.append(torch.where(inside, total / (weight * pitch).clamp_min(1e-12), 0))
        return slopes[0], slopes[1]


def shade(point: Vectors, normal: Vectors, profile: SensorProfile) -> torch.Tensor:
    """Display values of surface points under the profile's lights.

    Lambert and GGX with Smith's and Schlick's terms (glTF 2.0, appendix B), with the bounds that pyrender's
    shader puts on the cosines.

    Parameters
    ----------
    point : three (N, ...) float32 tensors
        Metres, camera frame; the first one's sizes are those of the result.
    normal : three (N, ...) float32 tensors
        Unit, towards the camera.
    profile : SensorProfile

    Returns
    -------
    (N, 3, ...) float32 tensor, 0 to 1
    """
    f0 = _DIELECTRIC * (1 - profile.metallic) + profile.albedo * profile.metallic
    diffuse = profile.albedo * (1 - _DIELECTRIC) * (1 - profile.metallic) / math.pi
    alpha2 = profile.roughness**4
    k = (profile.roughness + 1) ** 2 / 8

    view = unit((-point[0], -point[1], -point[2]))
    facing = _dot(normal, view)
    cos_view = facing.abs().clamp(0.001, 1)
    view_term = (alpha2 / math.pi) / (1 + (1 / cos_view - 1) * k)  # with the constant of the distribution
    radiance: list[torch.Tensor | float] = [profile.ambient] * 3
    for source in profile.lights:
        towards = (source.position[0] - point[0], source.position[1] - point[1], source.position[2] - point[2])
        inverse_square = 1 / _dot(towards, towards)
        inverse = inverse_square.sqrt()
        lit = _dot(normal, towards) * inverse
        cos_light = lit.clamp(0.001, 1)
        # The half vector h = (l + v) / |l + v| enters by its products only, and |l + v|² = 2 + 2 l·v.
        light_view = _dot(view, towards) * inverse
        half = (2 + 2 * light_view).clamp_min(1e-12).rsqrt()
        cos_normal_half = ((lit + facing) * half).clamp(0, 1)
        fresnel = f0 + (1 - f0) * (1 - ((1 + light_view) * half).clamp(0, 1)) ** 5
        spread = cos_normal_half * cos_normal_half * (alpha2 - 1) + 1
        shadowing = cos_light / (cos_light * (1 - k) + k)
        specular = fresnel * view_term * shadowing / (spread * spread * (4 * cos_light * cos_view + 0.001))
        reflected = cos_light * inverse_square * source.intensity * ((1 - fresnel) * diffuse + specular)
        radiance = [r + c * reflected if c else r for r, c in zip(radiance, source.color)]
    stacked = torch.stack([torch.as_tensor(r).to(point[0]).expand_as(point[0]) for r in radiance], dim=1)
    return stacked.clamp(0, 1) ** (1 / profile.gamma)


def blur(images: torch.Tensor, sigma: float) -> torch.Tensor:
    """Gaussian blur of (..., H, W) float images; ``sigma`` in pixels, 0 for none.

    Cut off at two deviations (rounded up), mirrored at the border; sums of shifted images, whose bits do not
    depend on the batch.
    """
    if sigma == 0:
        return images
    radius = math.ceil(2 * sigma)
    weights = np.exp(-(np.arange(-radius, radius + 1) ** 2) / (2 * sigma**2))
    weights /= weights.sum()
    mirrored = pad(images, (radius,) * 4, mode="reflect")
    return _correlate(_correlate(mirrored, weights, -1), weights, -2)


def unit(a: Vectors) -> Vectors:
    """Vectors of length 1."""
    scale = _dot(a, a).rsqrt()
    return a[0] * scale, a[1] * scale, a[2] * scale


def _dot(a: Vectors, b: Vectors) -> torch.Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _correlate(images: torch.Tensor, weights: np.ndarray, axis: int) -> torch.Tensor:
    """Sum of shifted images; shorter by ``len(weights) - 1`` along the axis."""
    size = images.shape[axis] - len(weights) + 1
    total = images.narrow(axis, 0, size) * float(weights[0])
    for shift, weight in enumerate(weights[1:].tolist(), 1):
        total.add_(images.narrow(axis, shift, size), alpha=weight)
    return total


def _smooth_differences(values: torch.Tensor, axis: int, sigma: float) -> torch.Tensor:
    """Gaussian sums at the pixels of (N, H, W) values between them; one longer along ``axis`` (1 or 2)."""
    radius = math.ceil(2 * sigma)
    between = np.exp(-((np.arange(-radius, radius) + 0.5) ** 2) / (2 * sigma**2))
    across = np.exp(-(np.arange(-radius, radius + 1) ** 2) / (2 * sigma**2))
    padding = [radius] * 4
    padded = pad(values, padding)
    return _correlate(_correlate(padded, between, axis), across, 3 - axis)


def _synthetic_background(profile: SensorProfile, rays: np.ndarray, gel: np.ndarray) -> torch.Tensor:
    """A dim grey with each light's glow on its side of the gel; (H, W, 3) uint8."""
    display = np.empty((*gel.shape, 3))
    display[:] = profile.background_color
    for light in profile.lights:
        distance = np.hypot(*(light.position[i] - rays[..., i] * gel for i in (1, 2)))
        distance -= distance.min()
        glow = profile.background_glow / (1 + (distance / profile.background_falloff) ** 2)
        display += glow[..., None] * np.array(light.color)
    return torch.from_numpy((255 * display).round().clip(0, 255).astype(np.uint8))
