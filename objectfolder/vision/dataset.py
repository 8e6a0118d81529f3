"""Views of an object with random cameras and lights."""

from collections.abc import Callable, Iterable

import numpy as np

from objectfolder.vision.cameras import CAMERA_RADIUS, LIGHT_RADIUS, Intrinsics, look_at, sphere_points
from objectfolder.vision.renderers.registry import Renderer

BRIGHTEST = np.finfo(np.float16).max  # the highlight of a mirror near the light is brighter


def render_split(
    renderer: Renderer,
    count: int,
    samples: int,
    intrinsics: Intrinsics,
    rng: np.random.Generator,
    progress: Callable[[Iterable], Iterable] = iter,
) -> dict[str, np.ndarray]:
    """Render views with cameras and lights uniform on their spheres (supplementary C).

    Parameters
    ----------
    renderer : Renderer
    count : int
        Views.
    samples : int
        Per pixel.
    intrinsics : Intrinsics
    rng : numpy.random.Generator
    progress : callable
        Wraps the iteration over views.

    Returns
    -------
    dict
        ``rgba`` (N, H, W, 4) float16, linear and premultiplied; ``camera_to_world`` (N, 4, 4);
        ``light`` (N, 3); ``focal``; ``renderer``, its version.
    """
    camera_to_world = look_at(sphere_points(count, CAMERA_RADIUS, rng))
    light = sphere_points(count, LIGHT_RADIUS, rng)
    seeds = rng.integers(2**31, size=count)
    rgba = np.empty((count, intrinsics.height, intrinsics.width, 4), np.float16)
    for i in progress(range(count)):
        image = renderer.render(camera_to_world[i], light[i], intrinsics, samples, int(seeds[i]))
        rgba[i] = image.clip(max=BRIGHTEST)
    return {
        "rgba": rgba,
        "camera_to_world": camera_to_world,
        "light": light,
        "focal": np.asarray(intrinsics.focal, np.float64),
        "renderer": np.asarray(renderer.version),
    }
