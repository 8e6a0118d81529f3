"""Vision of an Object File: cameras and lights in, pictures out."""

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from objectfolder.base.checks import real_array, refuse_rows, require_memory
from objectfolder.base.errors import ObjectFolderError
from objectfolder.stored.arguments import (
    Answer,
    Rows,
    broadcast_rows,
    finite_rows,
    like_first,
    true_or_false,
    usual_modes,
)
from objectfolder.stored.reading import StoredObject
from objectfolder.vision.cameras import MAX_COORDINATE, Intrinsics, look_at, require_rigid
from objectfolder.vision.color import on_white
from objectfolder.vision.environment import gather_lamps
from objectfolder.vision.lighting import Lamp, PointLight
from objectfolder.vision.picture import Drawer, Picture, Views

_BYTES_DRAWING = 64  # per pixel of the image that is being drawn
_LARGEST = math.sqrt(3) / 2  # radius of the ball about a box whose longest side is 1
log = logging.getLogger(__name__)

#: "studio", or lights.
Lights = str | Sequence[Lamp] | None
#: Equirectangular picture of linear radiance, (H, W, 3), or its path.
Environment = str | Path | np.ndarray | None
#: (N, 3) points near the surface, unit frame -> base colours (N, 3), sRGB uint8.
BaseColors = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class LitCameras:
    """Views of an object that are asked for."""

    poses: np.ndarray  #: (N, 4, 4) float64, camera to world, unit frame
    lights: np.ndarray | None  #: (N, 3) point lights, unit frame
    lamps: Sequence[Lamp]  #: more lights, of every view
    intrinsics: Intrinsics

    @classmethod
    def checked(
        cls,
        camera: Rows,
        light: Rows | None,
        lamps: Sequence[Lamp],
        intrinsics: Intrinsics,
        bytes_per_pixel: int = 0,
    ) -> "LitCameras":
        """Check the arguments of a query; a single camera or light serves all rows of the other.

        The answer, of so many bytes per pixel, has to fit into memory. Errors are those of
        `objectfolder.objectfile.file.ObjectFile.view`.
        """
        places = real_array("camera", camera)
        if places.ndim in (2, 3) and places.shape[-2:] == (4, 4):
            places = places.reshape(-1, 4, 4)
        elif places.ndim in (1, 2) and places.shape[-1] == 3:
            places = places.reshape(-1, 3)
        else:
            raise ObjectFolderError(f"camera has shape {places.shape}, expected (N, 3) or (N, 4, 4)")
        if light is None and not lamps:
            raise ObjectFolderError("there is no light; give light, lights or environment")
        points = None if light is None else finite_rows("light", light, 3)
        count, width, height = len(places), intrinsics.width, intrinsics.height
        count = count if points is None else max(count, len(points))
        needed = (count * bytes_per_pixel + _BYTES_DRAWING) * width * height
        images = f"{count} images of {width} x {height} pixels"
        require_memory(images, needed, "ask for a lower resolution or fewer images")
        poses = _poses(places)
        if points is not None:
            require_near("light", points)
            poses, points = broadcast_rows("camera", poses, "light", points)
        return cls(poses, points, lamps, intrinsics)

    def __len__(self) -> int:
        return len(self.poses)

    def __iter__(self) -> Iterator[tuple[np.ndarray, list[Lamp]]]:
        """Yield each camera and its lights."""
        for i, pose in enumerate(self.poses):
            yield pose, [*([] if self.lights is None else [PointLight(self.lights[i])]), *self.lamps]


class VisionSense(ABC):
    """What an Object File asks a vision net of any kind."""

    warned = False  #: whether a camera inside the object's ball was warned of

    @property
    def base_colors(self) -> BaseColors | None:
        """Base colours at points, if the net stores them apart from the light."""
        return None

    @abstractmethod
    def drawer(self, supersample: bool) -> Drawer:
        """Return the function that draws views."""


class VisionQueries(StoredObject):
    """How an object looks: part of `objectfolder.objectfile.file.ObjectFile`."""

    @property
    @usual_modes()
    def base_colors(self) -> BaseColors | None:
        """Function from points near the surface, (N, 3), unit frame, to base colours, (N, 3) sRGB uint8.

        None if the vision net does not separate them from the light.
        """
        sense: VisionSense = self._parts.vision
        return sense.base_colors

    @property
    @usual_modes()
    def vision_sense(self) -> VisionSense:
        """What asks the vision net."""
        sense: VisionSense = self._parts.vision
        return sense

    @usual_modes()
    def view(
        self,
        camera: Answer | Sequence[Any],
        light: Rows | None = None,
        resolution: int | None = None,
        intrinsics: Intrinsics | None = None,
        supersample: bool = True,
        lights: Lights = None,
        environment: Environment = None,
    ) -> Answer:
        """Render the object on white, under one light, several, or the light of its surroundings.

        Parameters
        ----------
        camera : (N, 3) or (N, 4, 4) array
            Positions, unit frame, that look at the object with z up, or camera-to-world matrices (OpenGL
            axes). One row may be given without its first axis.
        light : (N, 3) array, optional
            Point lights, unit frame. A white Lambertian surface that faces one at distance 1 has radiance 1.
        resolution : int, optional
            Side of a square image with the default field of view, pixels. Default: 256.
        intrinsics : Intrinsics, optional
            Any other camera, instead.
        supersample : bool
            False takes one ray through the centre of each pixel: faster, with jagged edges. Nets of other
            kinds than ``surface`` always do.
        lights : "studio" or sequence, optional
            Lights of `objectfolder.vision.lighting`, of all rows; "studio" stands for its three. Radiances
            add up, before they are clipped and encoded.
        environment : path or (H, W, 3) array, optional
            Equirectangular picture of linear radiance around the object, which 64 distant lights stand for;
            see `objectfolder.vision.environment.environment_lamps`. It is light only: the background stays
            white.

        Returns
        -------
        (N, H, W, 3) float32, sRGB in [0, 1]

        Raises
        ------
        ObjectFolderError
            If shapes do not fit, values are not finite or too large, a matrix is not a rotation and
            position, there is no light, or the images do not fit into memory.
        """
        smooth, seen_by = true_or_false("supersample", supersample), Intrinsics.given(intrinsics, resolution)
        cameras = LitCameras.checked(camera, light, gather_lamps(lights, environment), seen_by, 12)
        self._warn_if_inside(cameras)
        return like_first(view_images(self._parts.vision.drawer(smooth), cameras), camera)

    @usual_modes()
    def render(
        self,
        camera: Rows,
        light: Rows | None = None,
        resolution: int | None = None,
        intrinsics: Intrinsics | None = None,
        supersample: bool = True,
        lights: Lights = None,
        environment: Environment = None,
    ) -> Views:
        """Render colour, alpha, depth and normals; otherwise as `view`.

        Where an edge crosses a pixel, its colour is a mean of samples. Its depth and normal belong to one
        point: the one at its centre, or the nearest sample if the centre misses the object.

        Returns
        -------
        Views
            Of numpy arrays.
        """
        smooth, seen_by = true_or_false("supersample", supersample), Intrinsics.given(intrinsics, resolution)
        cameras = LitCameras.checked(camera, light, gather_lamps(lights, environment), seen_by, 44)
        self._warn_if_inside(cameras)
        return render_views(self._parts.vision.drawer(smooth), cameras, self.scale)

    def _warn_if_inside(self, cameras: LitCameras) -> None:
        """Warn, once, of a camera inside the ball that holds the object: its position may be in metres."""
        sense: VisionSense = self._parts.vision
        places = cameras.poses[:, :3, 3]
        distances = np.linalg.norm(places, axis=1)
        if sense.warned or distances.min(initial=_LARGEST) >= _LARGEST or not self._parts.surface.stored:
            return
        radius = np.linalg.norm(self._parts.geometry.vertices, axis=1).max()
        if distances.min() < radius:
            sense.warned = True
            log.warning(
                "%s: the camera at %s is inside the object's bounding ball of radius %.2f; cameras are in "
                "the unit frame, in which the object's longest side is 1: divide metres by %g",
                *(self.key, places[distances.argmin()].round(4).tolist(), radius, self.scale),
            )


def light_picture(drawer: Drawer, pose: np.ndarray, lamps: Sequence[Lamp], intrinsics: Intrinsics) -> Picture:
    """Draw an object under several lights: the sum of its radiances under each.

    Depth, normals and coverage are those of the first light.
    """
    first = drawer(pose, lamps[0].place, intrinsics)
    rgba = first.rgba
    if len(lamps) > 1 or tuple(lamps[0].color) != (1, 1, 1):
        rgba = rgba * np.array([*lamps[0].color, 1], np.float32)
        for lamp in lamps[1:]:
            more = drawer(pose, lamp.place, intrinsics).rgba
            rgba[..., :3] += more[..., :3] * np.array(lamp.color, np.float32)
    return replace(first, rgba=rgba)


def view_images(drawer: Drawer, cameras: LitCameras) -> np.ndarray:
    """Render an object on white; (N, H, W, 3) float32, sRGB in [0, 1]."""
    size = cameras.intrinsics
    images = np.empty((len(cameras), size.height, size.width, 3), np.float32)
    for image, (pose, lamps) in zip(images, cameras):
        image[:] = on_white(torch.from_numpy(light_picture(drawer, pose, lamps, size).rgba)).numpy()
    return images


def render_views(drawer: Drawer, cameras: LitCameras, scale: float) -> Views:
    """Render colour, alpha, depth and normals of an object whose longest side is ``scale`` metres."""
    size = len(cameras), cameras.intrinsics.height, cameras.intrinsics.width
    views = Views(*(np.empty((*size, *last), np.float32) for last in ((3,), (4,), (), (3,))))
    for i, (pose, lamps) in enumerate(cameras):
        picture = light_picture(drawer, pose, lamps, cameras.intrinsics)
        views.rgb[i] = on_white(torch.from_numpy(picture.rgba)).numpy()
        views.rgba[i], views.normals[i] = picture.rgba, picture.normals
        views.depth[i] = picture.depth * scale
    return views


def _poses(places: np.ndarray) -> np.ndarray:
    """Check positions (N, 3) or camera-to-world matrices (N, 4, 4), and return matrices."""
    if places.ndim == 2:
        require_near("camera", places)
        return look_at(places)
    require_near("camera", places[:, :3, 3])
    require_rigid(places)
    return places


def require_near(name: str, positions: np.ndarray) -> None:
    """Raise ObjectFolderError unless positions (N, 3) are finite and near enough for single precision."""
    limits = f", expected finite coordinates of at most {MAX_COORDINATE:g}: positions are in the unit frame"
    near = (np.abs(positions) <= MAX_COORDINATE).all(1)
    refuse_rows(name, ~near, positions, f"{limits}, in which the object's longest side is 1")
