"""Principled BSDF (Burley 2012) of the ground truth, for a point light."""

import math

import torch
from torch import Tensor

from objectfolder.vision.vectors import dot, normalize_rows

REFRACTIVE_INDEX = 1.5  # principled specular 0.5
MIN_ALPHA = 0.001


def principled(
    normal: Tensor, view: Tensor, light: Tensor, base_color: Tensor, roughness: float, metallic: float
) -> Tensor:
    """Return pi * BSDF * cosine: the radiance under a light that gives a white Lambertian surface 1; (S, 3).

    As in Mitsuba 3, with the lobes of an opaque, isotropic surface without coat and sheen: diffuse with
    retro-reflection, and GGX with Smith's masking (Walter et al. 2007). Shading normals, views from the
    camera to the surface, and directions from there to the light are (S, 3) of unit length; base colours (S,
    3) are linear. 0 where the camera or the light is behind the surface.
    """
    half = normalize_rows(light - view)
    seen, received = -dot(normal, view), dot(normal, light)
    facing = (seen > 0) & (received > 0)
    seen, received = seen.clamp(min=1e-4), received.clamp(min=1e-6)
    grazing = dot(half, light)  # cosine between the half vector and either direction
    squared = max(MIN_ALPHA, roughness**2) ** 2
    along = dot(normal, half)
    across = half - along * normal  # its length is exact where the cosine is nearly 1
    distribution = squared / (math.pi * (squared * along**2 + dot(across, across)) ** 2)
    reflected = fresnel(grazing, base_color, metallic)
    specular = math.pi / 4 * reflected * distribution * _masking(seen, squared) * _masking(received, squared)
    at_light, at_eye, retro = _schlick(received), _schlick(seen), 2 * roughness * grazing**2
    diffuse = (1 - 0.5 * at_light) * (1 - 0.5 * at_eye)
    diffuse = diffuse + retro * (at_light + at_eye + at_light * at_eye * (retro - 1))
    return torch.where(facing, specular / seen + (1 - metallic) * base_color * received * diffuse, 0)


def fresnel(cosine: Tensor, base_color: Tensor, metallic: float) -> Tensor:
    """Return the Fresnel reflectance; (S, 3), or (S, 1) for a dielectric, which has no colour.

    Cosines (S, 1) are between the direction of the light and the (micro)surface normal.
    """
    share = (1 - metallic) * _dielectric(cosine)
    if metallic:
        share = share + metallic * (base_color + (1 - base_color) * _schlick(cosine))
    return share


def _schlick(cosine: Tensor) -> Tensor:
    rest = (1 - cosine).clamp(0, 1)
    squared = rest * rest
    return squared * squared * rest


def _dielectric(cosine: Tensor) -> Tensor:
    """Fresnel reflectance of unpolarised light at a surface of `REFRACTIVE_INDEX`."""
    cosine = cosine.clamp(0, 1)
    inside = (1 - (1 - cosine * cosine) / REFRACTIVE_INDEX**2).sqrt()
    across = (cosine - REFRACTIVE_INDEX * inside) / (cosine + REFRACTIVE_INDEX * inside)
    along = (inside - REFRACTIVE_INDEX * cosine) / (inside + REFRACTIVE_INDEX * cosine)
    return 0.5 * (across**2 + along**2)


def _masking(cosine: Tensor, squared: float) -> Tensor:
    """Smith's masking of GGX, for alpha squared."""
    return 2 * cosine / (cosine + (squared + (1 - squared) * cosine**2).sqrt())
