"""Shading of the gel under point lights: glTF's metallic-roughness model."""

import math
from collections.abc import Callable

import numpy as np

from objectfolder.touch.arrays import Array, array_library, zeros
from objectfolder.touch.profiles import SensorProfile

Vectors = tuple[Array, Array, Array]  #: x, y and z as separate arrays

_DIELECTRIC = 0.04  # reflectance of a dielectric at normal incidence (glTF 2.0)
_COSINE = (0.001, 1)  # bounds of cosines in pyrender's shader


def shade(point: Vectors, normal: Vectors, profile: SensorProfile) -> Array:
    """Return display values (3, ...) float32, 0 to 1, of surface points under the profile's lights.

    Points, metres, and unit normals towards the camera are three float32 arrays or tensors each, camera
    frame.
    """
    light = radiance(point, normal, profile)
    library = array_library(light)
    return library.exp(library.log(light.clip(1e-30, 1)) / profile.gamma)  # twice as fast as a power


def radiance(point: Vectors, normal: Vectors, profile: SensorProfile) -> Array:
    """Return the radiance towards the camera; (3, ...) float32. Parameters are those of `shade`."""
    library = array_library(point[0])
    square, height = _dot(point, point), _dot(normal, point)
    length = library.sqrt(square)
    normal_view = -height / length  # the view direction is -point / length
    reflectance = ggx_reflectance(normal_view, profile)
    total = zeros((3, *square.shape), square) + profile.ambient
    for light in profile.lights:  # one at a time, whose arrays fit into the caches
        position: Vectors = tuple(np.array(light.position, np.float32))
        point_light = _dot(point, position)
        distance = library.sqrt(point_light * -2 + square + _dot(position, position))
        normal_light = (_dot(normal, position) - height) / distance
        view_light = (point_light / -length + length) / distance
        reflected = reflectance(normal_light, view_light)
        reflected *= normal_light.clip(*_COSINE)
        reflected /= distance * distance
        for channel, weight in enumerate(light.color):
            if weight:
                total[channel] += reflected * (weight * light.intensity)
    return total


def ggx_reflectance(normal_view: Array, profile: SensorProfile) -> Callable[[Array, Array], Array]:
    """Return the BRDF of glTF's metallic-roughness model (glTF 2.0, appendix B) for directions to the camera.

    A Lambert base under a GGX layer with Smith's shadowing, in the approximation by Schlick, and Schlick's
    Fresnel term; cosines and denominator are bounded as in pyrender's shader. With the half vector h = (l +
    v) / sqrt(2 (1 + l·v)), the cosines of the terms are

        n·h = (n·l + n·v) / sqrt(2 (1 + l·v)),    v·h = sqrt((1 + l·v) / 2).

    Takes the cosine n·v between unit normal and direction to the camera, and returns a function from the
    cosines n·l and l·v, l being the direction to a light, to the BRDF, 1/sr; all (...) float32.
    """
    albedo, metallic = profile.albedo, profile.metallic
    f0 = _DIELECTRIC * (1 - metallic) + albedo * metallic
    diffuse = albedo * (1 - _DIELECTRIC) * (1 - metallic) / math.pi
    alpha2 = profile.roughness**4
    k = (profile.roughness + 1) ** 2 / 8
    cos_view = abs(normal_view).clip(*_COSINE)
    shadowed = cos_view / (cos_view * (1 - k) + k) * (alpha2 / math.pi)
    four_cos_view = 4 * cos_view

    def reflectance(normal_light: Array, view_light: Array) -> Array:
        cos_light = normal_light.clip(*_COSINE)
        one_plus_view_light = (view_light + 1).clip(1e-12, 2)
        twice_half = (normal_light + normal_view).clip(0, 2)  # n·(l + v)
        spread = twice_half * twice_half
        spread /= one_plus_view_light
        spread *= (alpha2 - 1) / 2
        spread += 1
        spread = spread.clip(alpha2, 1)
        grazing = array_library(view_light).sqrt(one_plus_view_light * 0.5) - 1  # v·h - 1
        square = grazing * grazing
        fresnel = square * square
        fresnel *= grazing
        fresnel *= f0 - 1
        fresnel += f0
        denominator = cos_light * four_cos_view
        denominator += 0.001
        denominator *= spread
        denominator *= spread
        denominator *= cos_light * (1 - k) + k
        specular = cos_light * shadowed
        specular /= denominator
        specular -= diffuse
        specular *= fresnel
        specular += diffuse
        return specular

    return reflectance


def unit_components(a: Vectors) -> Vectors:
    """Return the vectors scaled to length 1."""
    length = array_library(a[0]).sqrt(_dot(a, a))
    return a[0] / length, a[1] / length, a[2] / length


def _dot(a: Vectors, b: Vectors) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
