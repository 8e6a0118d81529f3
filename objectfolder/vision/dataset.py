"""Views of an object with random cameras and lights."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import torch
from annotated_types import Ge, MultipleOf

from objectfolder.settings import Count, NonNegative
from objectfolder.vision.cameras import CAMERA_RADIUS, LIGHT_RADIUS, Intrinsics, look_at, sphere_points
from objectfolder.vision.color import lit_foreground, on_white
from objectfolder.vision.renderers.registry import Renderer

RendererName = Literal["mitsuba", "mitsuba-llvm", "mitsuba-cuda", "cycles", "raster"]
BRIGHTEST = np.finfo(np.float16).max  # highlights of a mirror near the light exceed it


@dataclass(frozen=True, kw_only=True)
class RenderViewsConfig:
    """Section ``render_views`` of ``params.yaml``."""

    renderer: RendererName  #: docs/pipeline.md compares them
    ambient: NonNegative  #: radiance from every direction, beside the point light
    resolution: Count  #: pixels along a side
    train: Count  #: views
    val: Count
    test: Count
    train_samples: Count  #: per pixel
    test_samples: Annotated[int, Ge(2), MultipleOf(2)]  #: per pixel, validation and test: two halves


def render_split(
    renderer: Renderer,
    count: int,
    samples: int,
    intrinsics: Intrinsics,
    rng: np.random.Generator,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
    halves: bool = False,
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
    halves : bool
        Whether to render each view as the mean of two independent renders with half of the samples (an even
        number) each; their difference gives the noise.

    Returns
    -------
    dict
        ``rgba`` (N, H, W, 4) float16, linear and premultiplied; ``camera_to_world`` (N, 4, 4);
        ``light`` (N, 3); ``focal``; ``renderer``, its version. With halves also ``noise`` (N, 2), see
        `shown_noise`.
    """
    camera_to_world = look_at(sphere_points(count, CAMERA_RADIUS, rng))
    light = sphere_points(count, LIGHT_RADIUS, rng)
    parts = 2 if halves else 1
    seeds = rng.integers(2**31, size=(parts, count))
    rgba = np.empty((count, intrinsics.height, intrinsics.width, 4), np.float16)
    noise = np.zeros((count, 2))
    for i in progress(range(count)):
        images = [
            renderer.render(camera_to_world[i], light[i], intrinsics, samples // parts, int(seed)).clip(
                max=BRIGHTEST
            )
            for seed in seeds[:, i]
        ]
        rgba[i] = sum(images) / parts
        if halves:
            noise[i] = shown_noise(*images)
    views = {
        "rgba": rgba,
        "camera_to_world": camera_to_world,
        "light": light,
        "focal": np.asarray(intrinsics.focal, np.float64),
        "renderer": np.asarray(renderer.version),
    }
    return views | {"noise": noise} if halves else views


def shown_noise(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Estimate the mean squared error, in sRGB on white, of the mean of two independent renders of a view.

    First order in the noise: the variance of the mean is a quarter of the mean squared difference. Rare
    bright paths are underestimated where the image clips them, and missed if neither render sampled them.

    Parameters
    ----------
    first, second : (H, W, 4) float32 arrays
        Linear, premultiplied.

    Returns
    -------
    float
        Over all pixels.
    float
        Over the pixels in `lit_foreground`; 0 if there are none.
    """
    shown = [on_white(torch.from_numpy(image)).numpy().astype(np.float64) for image in (first, second)]
    error = np.square(shown[0] - shown[1]).mean(-1) / 4
    lit = lit_foreground((first + second) / 2)
    return float(error.mean()), float(error[lit].mean()) if lit.any() else 0.0
