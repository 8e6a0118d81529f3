"""Cameras and lights, in the unit frame (OpenGL axes: x right, y up, the camera looks along -z)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from objectfolder.base.checks import finite_number, real_array, refuse_rows, whole_number
from objectfolder.base.errors import ObjectFolderError

CAMERA_RADIUS = 2.5  #: training cameras sit on this sphere (supplementary C)
LIGHT_RADIUS = 1.0
MAX_COORDINATE = 1e3  #: coordinate of a camera or light: beyond, single precision does not resolve the object
#: Largest deviation of a camera's matrix from a rigid motion; single precision leaves 1e-6
RIGID_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without skew or distortion.

    Lengths are in pixels. Image positions are measured from the upper left corner, so that the
    centre of the upper left pixel is (0.5, 0.5). Numbers of numpy and torch are kept as Python's. Raises
    ObjectFolderError if the size is no positive whole number, a focal length is not positive, or the
    principal point is not finite.
    """

    width: int = 256
    height: int = 256
    focal: float = 355.56  #: horizontal
    center: tuple[float, float] | None = None  #: column, row of the principal point; default: the centre
    focal_y: float | None = None  #: vertical; default: the horizontal one, for square pixels

    def __post_init__(self) -> None:
        def store(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        for side in ("width", "height"):
            store(side, whole_number(f"intrinsics: {side}", getattr(self, side), 1))
        store("focal", finite_number("intrinsics: focal", self.focal))
        if self.focal_y is not None:
            store("focal_y", finite_number("intrinsics: focal_y", self.focal_y))
        if min(self.fx, self.fy) <= 0:
            raise ObjectFolderError(f"intrinsics {self}: focal lengths must be positive, in pixels")
        if self.center is not None:
            if np.shape(self.center) != (2,):
                raise ObjectFolderError(
                    f"intrinsics {self}: center must be the column and row of the principal point"
                )
            center = (finite_number("intrinsics: principal point", place) for place in self.center)
            store("center", tuple(center))

    @property
    def fx(self) -> float:
        """Horizontal focal length."""
        return self.focal

    @property
    def fy(self) -> float:
        """Vertical focal length."""
        return self.focal if self.focal_y is None else self.focal_y

    @property
    def cx(self) -> float:
        """Column of the principal point."""
        return self.width / 2 if self.center is None else self.center[0]

    @property
    def cy(self) -> float:
        """Row of the principal point."""
        return self.height / 2 if self.center is None else self.center[1]

    @classmethod
    def square(cls, resolution: int) -> "Intrinsics":
        """Return the default field of view at another resolution."""
        side = whole_number("resolution", resolution, 1)
        return cls(side, side, 355.56 * side / 256)

    @classmethod
    def given(cls, intrinsics: "Intrinsics | None", resolution: int | None) -> "Intrinsics":
        """Return intrinsics, or `square` of a resolution, by default 256.

        Raises ObjectFolderError if they are of another type, or both are given.
        """
        if intrinsics is None:
            return cls.square(256 if resolution is None else resolution)
        if resolution is not None:
            raise ObjectFolderError(
                f"resolution is {resolution!r}, but intrinsics has a size of its own; give one of them"
            )
        if not isinstance(intrinsics, cls):
            kind = type(intrinsics).__name__
            raise ObjectFolderError(
                f"intrinsics is of type {kind}, expected Intrinsics, as from_matrix gives"
            )
        return intrinsics

    @classmethod
    def from_matrix(cls, matrix: np.ndarray, width: int, height: int) -> "Intrinsics":
        """Return the intrinsics of a calibration matrix K: ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``, pixels.

        If positions are measured from the centre of the upper left pixel, as in OpenCV, add 0.5 to ``cx`` and
        ``cy`` first. Raises ObjectFolderError if the matrix has another shape, skew, or another last row, or
        the size is not positive.
        """
        k = real_array("camera matrix", matrix)
        if k.shape != (3, 3) or not np.isfinite(k).all():
            raise ObjectFolderError(f"camera matrix {k.tolist()}: expected 3 x 3 finite numbers")
        if not np.allclose(k[2], [0, 0, 1]):
            raise ObjectFolderError(f"camera matrix has the last row {k[2].tolist()}, expected [0, 0, 1]")
        if max(abs(k[0, 1]), abs(k[1, 0])) > 1e-6 * abs(k[0, 0]):
            raise ObjectFolderError(
                f"camera matrix has skew ({k[0, 1]:g}, {k[1, 0]:g}): rectify the image first"
            )
        return cls(width, height, float(k[0, 0]), (float(k[0, 2]), float(k[1, 2])), float(k[1, 1]))


def image_intrinsics(images: Mapping[str, np.ndarray]) -> list[Intrinsics]:
    """Return the intrinsics of each image of a file of views, from its ``rgba``, ``focal``, ``center``."""
    height, width = images["rgba"].shape[1:3]
    focal = float(images["focal"])
    return [Intrinsics(width, height, focal, (column, row)) for column, row in images["center"].tolist()]


def sphere_points(count: int, radius: float, rng: np.random.Generator) -> np.ndarray:
    """Return uniformly random points on a sphere; (count, 3)."""
    points = rng.normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def look_at(
    positions: np.ndarray, target: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Return camera-to-world matrices (N, 4, 4) of cameras at positions (N, 3) that see a target, with z up.

    Cameras within 11.5 degrees of the poles have y up. Raises ObjectFolderError if a camera is at the target
    or not finite.
    """
    positions = np.asarray(positions, np.float64).reshape(-1, 3)
    target = np.asarray(target, np.float64)
    backward = positions - target
    distance = np.linalg.norm(backward, axis=1, keepdims=True)
    possible = np.isfinite(positions).all(1) & (distance[:, 0] > 1e-9)
    expected = f", expected a place that is finite and away from the point it looks at, {target.tolist()}"
    refuse_rows("camera", ~possible, positions, expected)
    backward = backward / distance
    right = np.cross(up_directions(backward), backward)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    pose = np.tile(np.eye(4), (len(positions), 1, 1))
    pose[:, :3, :] = np.stack([right, np.cross(backward, right), backward, positions], 2)
    return pose


def up_directions(backward: np.ndarray) -> np.ndarray:
    """Return the directions that are up for cameras of `look_at` with these unit backward axes; (N, 3)."""
    return np.where(np.abs(backward[:, 2:]) >= 0.98, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


def require_rigid(poses: np.ndarray) -> None:
    """Check camera-to-world matrices (N, 4, 4).

    Raises ObjectFolderError if one is no rotation followed by a translation: not finite, scaled, sheared,
    mirrored or transposed.
    """
    rotation = poses[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # what is not a number fails every comparison
        last = np.abs(poses[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(1)
        skew = np.abs(rotation.transpose(0, 2, 1) @ rotation - np.eye(3)).max((1, 2))
        problems = {
            "its last row must be [0, 0, 0, 1] (is it transposed?)": last,
            "its first three columns must be of length 1 and orthogonal": skew,
            "it mirrors: its determinant must be 1": np.abs(np.linalg.det(rotation) - 1),
        }
    for problem, deviation in problems.items():
        wrong = np.flatnonzero(~(deviation <= RIGID_TOLERANCE))
        if len(wrong):
            raise ObjectFolderError(
                f"camera: matrix {wrong[0]} is {poses[wrong[0]].round(4).tolist()}, must be camera to world: "
                f"a rotation and a position; {problem}"
            )


def camera_rays(
    camera_to_world: np.ndarray, intrinsics: Intrinsics, pixels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays through image positions: origins and unit directions, (P, 3) float32 each.

    Positions (P, 2) are column and row; the centre of the upper left pixel is (0.5, 0.5).
    """
    x = (pixels[:, 0] - intrinsics.cx) / intrinsics.fx
    y = (intrinsics.cy - pixels[:, 1]) / intrinsics.fy
    local = np.stack([x, y, -np.ones_like(x)], 1)
    directions = local @ camera_to_world[:3, :3].T
    directions /= np.sqrt(np.einsum("pk,pk->p", directions, directions))[:, None]
    origins = np.broadcast_to(camera_to_world[:3, 3], directions.shape)
    return origins.astype(np.float32), directions.astype(np.float32)


class PixelRays:
    """Rays through the pixels of an image, several times faster than `camera_rays`.

    Directions are not normalized: their component along the optical axis is 1, so that distance is depth. The
    part of the image goes from left to before right, its pixels are numbered row by row.
    """

    def __init__(
        self,
        camera_to_world: np.ndarray,
        intrinsics: Intrinsics,
        left: int,
        top: int,
        right: int,
        bottom: int,
    ):
        self.shape = bottom - top, right - left
        self._first = top, left
        self.origin = camera_to_world[:3, 3].astype(np.float32)  #: (3,), of all rays
        right_axis, up, backward = camera_to_world[:3, :3].T
        backward = backward / np.linalg.norm(backward)
        columns = (np.arange(left, right) - intrinsics.cx) / intrinsics.fx
        rows = (intrinsics.cy - np.arange(top, bottom)) / intrinsics.fy
        # Directions through the upper left corners of pixels, and steps of one pixel.
        self._columns = (columns * right_axis[:, None] - backward[:, None]).astype(np.float32)
        self._rows = (rows * up[:, None]).astype(np.float32)
        self._right = (right_axis / intrinsics.fx).astype(np.float32)[:, None]
        self._down = (-up / intrinsics.fy).astype(np.float32)[:, None]

    def centres(self) -> np.ndarray:
        """Return the directions through the centres of all pixels; (P, 3) float32."""
        half = 0.5 * self._right + 0.5 * self._down
        return (self._rows[:, :, None] + (self._columns + half)[:, None]).reshape(3, -1).T

    def in_strips(self, height: int) -> np.ndarray:
        """Return the numbers of all pixels (P,), column by column in strips of rows.

        Consecutive rays then meet the same triangles. Strips begin at multiples of ``height`` rows of the
        whole image, so that the order of two pixels does not depend on the part.
        """
        rows, columns = self.shape
        above = self._first[0] % height
        strips = -(-(above + rows) // height)
        row = np.arange(-above, strips * height - above).reshape(strips, 1, height)
        pixels = (columns * row + np.arange(columns)[:, None]).ravel()
        return pixels[(pixels >= 0) & (pixels < rows * columns)]

    def by_squares(self, pixels: np.ndarray, side: int) -> np.ndarray:
        """Return other numbers of pixels (K,): ``side**2`` from a multiple of it are a square of pixels.

        Squares begin at multiples of ``side`` rows and columns of the whole image.
        """
        row = pixels // self.shape[1]  # several times faster than divmod
        top, left = (first % side for first in self._first)
        row, column = row + top, pixels - self.shape[1] * row + left
        squares = (self.shape[1] + 2 * side) // side  # in a row
        down, right = row // side, column // side
        return side * (side * (down * squares + right) + row - side * down) + column - side * right

    def through(self, pixels: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the directions through positions within pixels; (K, 3) float32.

        Positions x, y (K,) float32 are measured from a pixel's upper left corner, 0 to 1.
        """
        row = pixels // self.shape[1]
        column = pixels - self.shape[1] * row
        corner = self._rows.take(row, 1) + self._columns.take(column, 1)
        return (corner + (x * self._right + y * self._down)).T


def project(
    points: np.ndarray, camera_to_world: np.ndarray, intrinsics: Intrinsics
) -> tuple[np.ndarray, np.ndarray]:
    """Return image positions (P, 2) and depths (P,) of points; the inverse of `camera_rays`."""
    local = (np.asarray(points) - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    depth = -local[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = intrinsics.cx + intrinsics.fx * local[:, 0] / depth
        y = intrinsics.cy - intrinsics.fy * local[:, 1] / depth
    return np.stack([x, y], 1), depth


def covered_rectangle(
    points: np.ndarray, camera_to_world: np.ndarray, intrinsics: Intrinsics
) -> tuple[int, int, int, int]:
    """Return the rectangle of pixels that the convex hull of points (N, 3), unit frame, may cover.

    Left, top, right, bottom: columns from left to before right, rows from top to before bottom: empty if the
    hull is out of sight, the whole image if a point is behind the camera.
    """
    size = np.array([intrinsics.width, intrinsics.height])
    pixels, depth = project(points, camera_to_world, intrinsics)
    if (depth <= 1e-6).any():
        return 0, 0, intrinsics.width, intrinsics.height
    # One pixel more on each side, since the renderer's projection rounds differently.
    left, top = np.clip(np.floor(pixels.min(0)) - 1, 0, size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(pixels.max(0)) + 1, 0, size).astype(int).tolist()
    return left, top, right, bottom
