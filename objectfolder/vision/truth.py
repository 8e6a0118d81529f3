"""Ground-truth views of an object with random cameras and lights: whole, and tiles."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from objectfolder.vision.cameras import (
    CAMERA_RADIUS,
    LIGHT_RADIUS,
    Intrinsics,
    covered_rectangle,
    look_at,
    sphere_points,
)
from objectfolder.vision.renderers.registry import Renderer
from objectfolder.vision.settings import RenderViewsConfig

MAX_RADIANCE = np.finfo(np.float16).max  # highlights of a mirror near the light exceed it
TILES_PER_LIGHT = 4  # a new light costs training as much as a few tiles


@dataclass(frozen=True)
class Frames:
    """What images of one size and focal length show."""

    camera_to_world: np.ndarray  #: (N, 4, 4), unit frame
    light: np.ndarray  #: (N, 3), unit frame
    intrinsics: list[Intrinsics]

    @classmethod
    def views(cls, count: int, intrinsics: Intrinsics, rng: np.random.Generator) -> "Frames":
        """Draw whole views with cameras and lights uniform on their spheres (supplementary C)."""
        cameras = look_at(sphere_points(count, CAMERA_RADIUS, rng))
        return cls(cameras, sphere_points(count, LIGHT_RADIUS, rng), [intrinsics] * count)

    @classmethod
    def tiles(
        cls, count: int, side: int, points: np.ndarray, intrinsics: Intrinsics, rng: np.random.Generator
    ) -> "Frames":
        """Draw square tiles of views, each of another camera; consecutive ones share a light.

        A tile lies anywhere in the rectangle of the view that the object, given by its vertices (P, 3), may
        cover. It is an image of its own: its principal point, measured from its own corner, says where it
        lies.
        """
        cameras = look_at(sphere_points(count, CAMERA_RADIUS, rng))
        lights = sphere_points(-(-count // TILES_PER_LIGHT), LIGHT_RADIUS, rng)
        parts = []
        for camera in cameras:
            left, top, right, bottom = covered_rectangle(points, camera, intrinsics)
            column = rng.integers(left, max(right - side, left), endpoint=True)
            row = rng.integers(top, max(bottom - side, top), endpoint=True)
            center = (float(intrinsics.cx - column), float(intrinsics.cy - row))
            parts.append(Intrinsics(side, side, intrinsics.focal, center))
        return cls(cameras, lights.repeat(TILES_PER_LIGHT, 0)[:count], parts)


def draw_frames(
    vertices: np.ndarray, config: RenderViewsConfig, split: str, rng: np.random.Generator
) -> Frames:
    """Draw the images of a split: whole views, or tiles if the settings have some and it is not the test."""
    count, whole = getattr(config, split), Intrinsics.square(config.resolution)
    if config.tile and split != "test":
        return Frames.tiles(count, config.tile, vertices, whole, rng)
    return Frames.views(count, whole, rng)


def render_frames(
    renderer: Renderer,
    frames: Frames,
    samples: int,
    rng: np.random.Generator,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
    halves: bool = False,
) -> dict[str, np.ndarray]:
    """Render the images of a split; the arrays of ``views/SPLIT.npz``.

    With halves, each image is the mean of two independent renders with half of the samples per pixel (an even
    number) each; their difference gives the noise. ``progress`` wraps the iteration over images.

    ``rgba`` (N, H, W, 4) float16, linear and premultiplied; ``camera_to_world`` (N, 4, 4); ``light`` (N, 3);
    ``focal``; ``center`` (N, 2), column and row of the principal point in each image; ``renderer``, its
    version. With halves also ``noise`` (N, H, W, 4) float16: the first render less the mean of both.
    """
    count, one = len(frames.intrinsics), frames.intrinsics[0]
    parts = 2 if halves else 1
    seeds = rng.integers(2**31, size=(parts, count))
    rgba = np.empty((count, one.height, one.width, 4), np.float16)
    noise = np.zeros_like(rgba)
    for i in progress(range(count)):
        view = frames.camera_to_world[i], frames.light[i], frames.intrinsics[i], samples // parts
        images = [renderer.render(*view, int(seed)).clip(max=MAX_RADIANCE) for seed in seeds[:, i]]
        rgba[i] = sum(images) / parts
        if halves:
            noise[i] = (images[0] - images[1]) / 2
    center = np.array([[part.cx, part.cy] for part in frames.intrinsics])
    views = {"rgba": rgba, "camera_to_world": frames.camera_to_world, "light": frames.light}
    views |= {"focal": np.asarray(one.focal, np.float64), "center": center}
    views |= {"renderer": np.asarray(renderer.version)} | ({"noise": noise} if halves else {})
    return views
