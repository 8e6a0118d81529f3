"""Vision of an Object File: cameras and lights in, pictures out."""

import copy
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import repeat
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch

from objectfolder.checks import real_array, require_memory
from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile.arguments import Rows, broadcast_rows, finite_rows
from objectfolder.objectfile.reading import StoredNet, damaged_net, once, report_damage
from objectfolder.objectfile.torch_modes import usual_modes
from objectfolder.vision.cameras import MAX_COORDINATE, Intrinsics, look_at, require_rigid
from objectfolder.vision.color import on_white
from objectfolder.vision.lighting import Lamp, PointLight
from objectfolder.vision.picture import Drawer, Picture, Views
from objectfolder.vision.view import Shader, draw

if TYPE_CHECKING:
    from objectfolder.nets.vision_surface import Baked

_CHUNK = 2**17  # points whose base colours are evaluated at once
_BYTES_DRAWING = 64  # per pixel of the image that is being drawn

#: Kinds of the paper's VisionNet.
OSF_KINDS = ("osf", "osf_hull")
#: (N, 3) points near the surface, unit frame -> base colours (N, 3), sRGB uint8.
BaseColors = Callable[[np.ndarray], np.ndarray]


class VisionSense(Protocol):
    """What an Object File asks a vision net of any kind."""

    @property
    def base_colors(self) -> BaseColors | None:
        """Base colours at points, if the net stores them apart from the light."""

    def drawer(self, supersample: bool) -> Drawer:
        """Return the function that draws views."""


def vision_sense(stored: StoredNet) -> VisionSense:
    """Load a vision net. The code of a kind is imported when a file holds it."""
    if stored.kind == "surface":
        return SurfaceSense(stored)
    if stored.kind in OSF_KINDS:
        from objectfolder.nets.vision_osf import OsfNet

        return VolumeSense(stored.load(OsfNet).picture, stored.key)
    from objectfolder.nets.released.registry import released_net

    return VolumeSense(stored.load(released_net(stored.kind)).picture, stored.key)


class SurfaceSense:
    """Vision by shading the stored surface."""

    def __init__(self, stored: StoredNet):
        from objectfolder.nets.vision_surface import SurfaceNet

        self.net: SurfaceNet = stored.load(SurfaceNet)
        self._stored = stored
        self._lock = threading.RLock()

    @property
    def surface(self) -> Isosurface:
        """The stored surface, unit frame."""
        return self._stored.surface.read()

    @once
    def baked(self) -> "Baked":
        """What the net knows of the surface alone, on the CPU."""
        surface = self.surface
        with report_damage(self._stored.key, "vision net"):
            return copy.deepcopy(self.net).cpu().bake(surface)

    @once
    def _shader(self) -> Shader:
        return self.net.shader(self.surface, self._stored.device, self.baked)

    def drawer(self, supersample: bool) -> Drawer:
        """Return the function that draws views."""
        picture = partial(draw, self.surface, self._shader, supersample=supersample)
        return _checked(picture, self._stored.key)

    @usual_modes()
    @torch.no_grad()
    def base_colors(self, points: np.ndarray) -> np.ndarray:
        """Return base colours (N, 3), sRGB uint8, at (N, 3) points near the surface, unit frame."""
        points = finite_rows("points", points, 3)
        _require_near("points", points)
        if not len(points):
            return np.zeros((0, 3), np.uint8)
        colors = []
        for part in torch.from_numpy(points.astype(np.float32)).to(self._stored.device).split(_CHUNK):
            color = self.net.base_colors(part)
            colors.append((255 * color.clamp(0, 1)).round().to(torch.uint8))
        return torch.cat(colors).cpu().numpy()


class VolumeSense:
    """Vision by a net that is rendered along rays; every pixel is the ray through its centre.

    These nets know point lights only: a distant light is one at distance 1, where they were trained.
    """

    base_colors = None

    def __init__(self, picture: Drawer, key: str):
        def under_points(pose: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> Picture:
            return picture(pose, light[:3], intrinsics)

        self._picture = _checked(under_points, key)

    def drawer(self, supersample: bool) -> Drawer:
        """Return the function that draws views, the same with and without supersampling."""
        return self._picture


def _checked(drawer: Drawer, key: str) -> Drawer:
    """Return a drawer that refuses pictures that are not finite: weights of a damaged net can overflow."""

    def draw_checked(pose: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> Picture:
        picture = drawer(pose, light, intrinsics)
        if not (np.isfinite(picture.rgba).all() and np.isfinite(picture.normals).all()):
            raise damaged_net(key, "vision")
        return picture

    return draw_checked


def lit_picture(drawer: Drawer, pose: np.ndarray, lamps: Sequence[Lamp], intrinsics: Intrinsics) -> Picture:
    """Draw an object under several lights: the sum of its radiances under each.

    Depth, normals and coverage are those of the first light.
    """
    first = drawer(pose, lamps[0].place, intrinsics)
    rgba = first.rgba
    if len(lamps) > 1 or tuple(lamps[0].color) != (1, 1, 1):
        rgba = rgba * np.array([*lamps[0].color, 1], np.float32)
        for lamp in lamps[1:]:
            seen = drawer(pose, lamp.place, intrinsics).rgba
            rgba[..., :3] += seen[..., :3] * np.array(lamp.color, np.float32)
    return replace(first, rgba=rgba)


def view_images(
    load_drawer: Callable[[], Drawer],
    camera: Rows,
    light: Rows | None,
    intrinsics: Intrinsics,
    lamps: Sequence[Lamp] = (),
) -> np.ndarray:
    """Render an object on white.

    Parameters
    ----------
    load_drawer : callable
        Returns what draws; called once the other arguments are found to be good.
    camera : (N, 3) array or (N, 4, 4) array
        Positions of cameras that look at the centre with z up, or camera-to-world matrices (OpenGL axes);
        unit frame. One row may be given without its first axis.
    light : (N, 3) or (3,) array, optional
        Point light, unit frame. A white Lambertian surface that faces it at distance 1 has radiance 1.
    intrinsics : Intrinsics
    lamps : sequence of Lamp
        More lights, of every row.

    Returns
    -------
    (N, H, W, 3) float32, sRGB in [0, 1]

    Raises
    ------
    ObjectFolderError
        If shapes do not fit, values are not finite, there is no light, or the images do not fit into memory.
    """
    room = partial(require_image_room, intrinsics=intrinsics, bytes_per_pixel=12)
    poses, lights = poses_and_lights(camera, light, lamps, room)
    drawer = load_drawer()
    images = np.empty((len(poses), intrinsics.height, intrinsics.width, 3), np.float32)
    for image, pose, lit_by in zip(images, poses, lights):
        image[:] = on_white(torch.from_numpy(lit_picture(drawer, pose, lit_by, intrinsics).rgba)).numpy()
    return images


def render_views(
    load_drawer: Callable[[], Drawer],
    scale: float,
    camera: Rows,
    light: Rows | None,
    intrinsics: Intrinsics,
    lamps: Sequence[Lamp] = (),
) -> Views:
    """Render colour, alpha, depth and normals; otherwise as `view_images`, whose result is ``rgb`` here.

    Where an edge crosses a pixel, its colour is a mean of samples. Its depth and normal belong to one point:
    the one at its centre, or the nearest sample if the centre misses the object.

    Parameters
    ----------
    scale : float
        Longest side, metres.
    """
    room = partial(require_image_room, intrinsics=intrinsics, bytes_per_pixel=44)
    poses, lights = poses_and_lights(camera, light, lamps, room)
    drawer = load_drawer()
    size = len(poses), intrinsics.height, intrinsics.width
    views = Views(*(np.empty((*size, *last), np.float32) for last in ((3,), (4,), (), (3,))))
    for i, (pose, lit_by) in enumerate(zip(poses, lights)):
        picture = lit_picture(drawer, pose, lit_by, intrinsics)
        views.rgb[i] = on_white(torch.from_numpy(picture.rgba)).numpy()
        views.rgba[i], views.normals[i] = picture.rgba, picture.normals
        views.depth[i] = picture.depth * scale
    return views


def require_image_room(count: int, intrinsics: Intrinsics, bytes_per_pixel: int) -> None:
    """Raise ObjectFolderError if images do not fit into memory; ``bytes_per_pixel`` are those of each."""
    width, height = intrinsics.width, intrinsics.height
    require_memory(
        f"{count} images of {width} x {height} pixels",
        (count * bytes_per_pixel + _BYTES_DRAWING) * width * height,
        "ask for a lower resolution or fewer images",
    )


def poses_and_lights(
    camera: Rows,
    light: Rows | None,
    lamps: Sequence[Lamp],
    require_room: Callable[[int], None] = lambda count: None,
) -> tuple[np.ndarray, Iterator[list[Lamp]]]:
    """Check cameras and lights; other parameters and errors are those of `view_images`.

    Parameters
    ----------
    require_room : callable
        Called with N before anything is computed of N rows.

    Returns
    -------
    poses : (N, 4, 4) float64 array, camera to world
    lamps : iterator over lists of Lamp
        Of each camera.
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
    require_room(len(places) if points is None else max(len(places), len(points)))
    poses = _poses(places)
    if points is None:
        return poses, repeat(list(lamps), len(poses))
    _require_near("light", points)
    poses, points = broadcast_rows("camera", poses, "light", points)
    return poses, ([PointLight(point), *lamps] for point in points)


def _poses(places: np.ndarray) -> np.ndarray:
    """Check positions (N, 3) or camera-to-world matrices (N, 4, 4), and return matrices."""
    if places.ndim == 2:
        _require_near("camera", places)
        return look_at(places)
    _require_near("camera", places[:, :3, 3])
    require_rigid(places)
    return places


def _require_near(name: str, positions: np.ndarray) -> None:
    wrong = np.flatnonzero(~(np.abs(positions) <= MAX_COORDINATE).all(1))
    if len(wrong):
        raise ObjectFolderError(
            f"{name}: row {wrong[0]} is at {positions[wrong[0]].tolist()}, expected finite coordinates of "
            f"at most {MAX_COORDINATE:g}: positions are in the unit frame, in which the object's longest "
            "side is 1"
        )
