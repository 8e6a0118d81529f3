"""Shading of the gel under point lights: glTF's metallic-roughness model."""

import math

import numpy as np

from objectfolder.touch.arrays import Array, array_library, zeros
from objectfolder.touch.profiles import SensorProfile

Vectors = tuple[Array, Array, Array]  #: x, y and z as separate arrays

_DIELECTRIC = 0.04  # reflectance of a dielectric at normal incidence (glTF 2.0)
_COSINE = (0.001, 1)  # bounds of cosines in pyrender's shader


def shade(point: Vectors, normal: Vectors, profile: SensorProfile) -> Array:
    """Return display values of surface points under the profile's lights.

    Parameters
    ----------
    point : three (...) float32 arrays or tensors
        Metres, camera frame.
    normal : three (...) float32 arrays or tensors
        Unit length, towards the camera.
    profile : SensorProfile

    Returns
    -------
    (3, ...) float32 array or tensor, 0 to 1
    """
    library = array_library(point[0])
    square, height = _dot(point, point), _dot(normal, point)
    length = library.sqrt(square)
    normal_view = -height / length  # the view direction is -point / length
    radiance = zeros((3, *square.shape), square) + profile.ambient
    for light in profile.lights:  # one at a time, whose arrays fit into the caches
        position: Vectors = tuple(np.array(light.position, np.float32))
        point_light = _dot(point, position)
        distance = library.sqrt(point_light * -2 + square + _dot(position, position))
        normal_light = (_dot(normal, position) - height) / distance
        view_light = (point_light / -length + length) / distance
        reflectance = ggx_reflectance(normal_view, normal_light, view_light, profile)
        reflected = reflectance * normal_light.clip(*_COSINE) / distance / distance
        for channel, weight in zip(radiance, light.color):
            if weight:
                channel += reflected * (weight * light.intensity)
    return library.exp(library.log(radiance.clip(1e-30, 1)) / profile.gamma)  # twice as fast as a power


def ggx_reflectance(
    normal_view: Array, normal_light: Array, view_light: Array, profile: SensorProfile
) -> Array:
    """Return the BRDF of glTF's metallic-roughness model (glTF 2.0, appendix B).

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
    grazing = array_library(view_light).sqrt(one_plus_view_light * 0.5) - 1  # v·h - 1
    grazing2 = grazing * grazing
    fresnel = grazing2 * grazing2 * grazing * (f0 - 1) + f0
    shadowing_view = cos_view / (cos_view * (1 - k) + k)
    shadowing_light = cos_light * (1 - k) + k
    denominator = (cos_light * (4 * cos_view) + 0.001) * spread * spread * shadowing_light
    specular = cos_light * (shadowing_view * (alpha2 / math.pi)) / denominator
    return (specular - diffuse) * fresnel + diffuse


def unit_components(a: Vectors) -> Vectors:
    """Return the vectors scaled to length 1."""
    length = array_library(a[0]).sqrt(_dot(a, a))
    return a[0] / length, a[1] / length, a[2] / length


def _dot(a: Vectors, b: Vectors) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
