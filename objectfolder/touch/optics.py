"""What the sensor's camera sees of the gel."""

import math

import torch

from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.smoothing import smooth

# Reflectance of a dielectric at normal incidence, as in glTF.
_DIELECTRIC = 0.04


class Optics:
    """Renders the gel, lit from inside.

    An image is the background plus the difference in shading to the undeformed gel, as TACTO calibrates
    (Wang et al. 2022). Shading is glTF's metallic-roughness model under point lights, without shadows or
    interreflections.

    Parameters
    ----------
    profile : SensorProfile

    Attributes
    ----------
    background : (H, W, 3) uint8 tensor
        The untouched sensor; synthetic, a function of the profile only.
    """

    def __init__(self, profile: SensorProfile):
        self.profile = profile
        rays = torch.from_numpy(ray_directions(profile)).float()
        self._slope_y = rays[..., 1].contiguous()
        self._slope_z = rays[..., 2].contiguous()
        self._gel = torch.from_numpy(gel_depth(profile)).float()
        self._positions = torch.tensor([light.position for light in profile.lights])
        self._colors = torch.tensor([light.color for light in profile.lights])
        self._intensities = torch.tensor([light.intensity for light in profile.lights])
        self.background = self._background()
        self._reference = self._shade(self._gel)

    def render(self, displacement: torch.Tensor) -> torch.Tensor:
        """Images of the deformed gel.

        Parameters
        ----------
        displacement : (N, H, W) float32 tensor
            Metres towards the camera along the pixel rays, from `gel.deform`.

        Returns
        -------
        (N, H, W, 3) uint8 tensor, RGB.
        """
        images = torch.empty(*displacement.shape, 3, dtype=torch.uint8)
        sigma = self.profile.image_smoothing / self.profile.pixel_pitch
        background = self.background.permute(2, 0, 1).float()
        # One image at a time: the same bits whatever else is in the batch.
        for image, moved in zip(images, displacement.unbind()):
            change = 255 * self.profile.gain * (self._shade(self._gel - moved) - self._reference)
            change = torch.stack([smooth(channel, sigma) for channel in change])
            image.copy_((background + change).round().clamp(0, 255).permute(1, 2, 0))
        return images

    def noise(self, images: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Add the camera's pixel noise to (N, H, W, 3) uint8 images; none if the profile has none."""
        if self.profile.noise_std == 0:
            return images
        noise = torch.randn(images.shape, generator=generator) * self.profile.noise_std
        return (images + noise).round().clamp(0, 255).to(torch.uint8)

    def _background(self) -> torch.Tensor:
        """A dim grey with each light's glow on its side of the gel; (H, W, 3) uint8."""
        y, z = self._slope_y * self._gel, self._slope_z * self._gel
        light_y, light_z = self._positions[:, 1, None, None], self._positions[:, 2, None, None]
        distance = torch.sqrt((light_y - y) ** 2 + (light_z - z) ** 2)
        distance = distance - distance.amin(dim=(1, 2), keepdim=True)
        glow = self.profile.background_glow / (1 + (distance / self.profile.background_falloff) ** 2)
        color = torch.tensor(self.profile.background_color)
        display = color + torch.einsum("lhw,lc->hwc", glow, self._colors)
        return (255 * display).round().clamp(0, 255).to(torch.uint8)

    def _shade(self, depth: torch.Tensor) -> torch.Tensor:
        """Display values (3, H, W), 0 to 1, of the surface at ``depth`` (H, W) along the pixel rays."""
        point = (depth, self._slope_y * depth, self._slope_z * depth)
        normal = self._normals(depth)
        view = _unit(tuple(-p for p in point))
        towards = tuple(self._positions[:, i, None, None] - point[i] for i in range(3))
        square = _dot(towards, towards)
        light = tuple(t * square.rsqrt() for t in towards)
        irradiance = self._intensities[:, None, None] / square
        radiance = irradiance * _metallic_roughness(normal, view, light, self.profile)
        color = torch.stack(
            [sum(c * r for c, r in zip(channel.tolist(), radiance)) for channel in self._colors.T]
        )
        return (color + self.profile.ambient).clamp(0, 1) ** (1 / self.profile.gamma)

    def _normals(self, depth: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Unit normals towards the camera of the surface depth · (1, a, b), by central differences."""
        step_z = float(self._slope_z[1, 0] - self._slope_z[0, 0])
        step_y = float(self._slope_y[0, 1] - self._slope_y[0, 0])
        along_z, along_y = torch.gradient(depth, spacing=(step_z, step_y))
        return _unit((-(depth + self._slope_y * along_y + self._slope_z * along_z), along_y, along_z))


def _metallic_roughness(
    normal: tuple[torch.Tensor, ...],
    view: tuple[torch.Tensor, ...],
    light: tuple[torch.Tensor, ...],
    profile: SensorProfile,
) -> torch.Tensor:
    """BRDF times cosine: Lambert plus GGX, Smith's and Schlick's terms (glTF 2.0, appendix B)."""
    f0 = _DIELECTRIC * (1 - profile.metallic) + profile.albedo * profile.metallic
    diffuse = profile.albedo * (1 - _DIELECTRIC) * (1 - profile.metallic) / math.pi
    alpha2 = profile.roughness**4
    k = (profile.roughness + 1) ** 2 / 8

    cos_light = _dot(normal, light).clamp(0.001, 1)
    cos_view = _dot(normal, view).clamp(0.001, 1)
    half = _unit(tuple(l + v for l, v in zip(light, view)))
    cos_normal_half = _dot(normal, half).clamp(0, 1)
    cos_view_half = _dot(view, half).clamp(0, 1)

    fresnel = f0 + (1 - f0) * (1 - cos_view_half) ** 5
    shadowing = cos_light * cos_view / ((cos_light * (1 - k) + k) * (cos_view * (1 - k) + k))
    distribution = alpha2 / (math.pi * (cos_normal_half**2 * (alpha2 - 1) + 1) ** 2)
    specular = fresnel * shadowing * distribution / (4 * cos_light * cos_view + 0.001)
    return cos_light * ((1 - fresnel) * diffuse + specular)


def _dot(a: tuple[torch.Tensor, ...], b: tuple[torch.Tensor, ...]) -> torch.Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(a: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
    scale = _dot(a, a).rsqrt()
    return tuple(component * scale for component in a)
