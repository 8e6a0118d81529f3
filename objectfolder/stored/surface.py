"""The surface of an object in metres: the one place where queries enter and leave the unit frame."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from objectfolder.base.checks import finite_number, refuse_rows
from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sampling import sample_surface

FARTHEST = 1e6  #: object sizes; further points have no nearest one in double precision
#: Tolerance of scores: where the stored surface lost a part, the nearest place answers, and the error counts.
ANYWHERE = 1.0
TOLERANCE = 0.02  #: points further than this from the surface (fraction of the size) are refused
#: Voxels. Edges and thin parts of the stored surface are off by up to one: contact points nearer to it stay
#: where they are. Snapping them would move the whole image, also where the surface is right.
UNMOVED = 1.0


@dataclass(frozen=True)
class ObjectSurface:
    """Stored surface of an object. All points are in the object frame, metres."""

    read: Callable[[], Isosurface]  #: returns the stored surface, unit frame
    scale: float  #: longest side, metres
    stored: bool = True  #: whether the file holds a surface
    #: (2, 3) lowest and highest coordinates that the net was trained on; of points without a stored surface.
    box: np.ndarray | None = None

    def resized(self, scale: float | None) -> "ObjectSurface":
        """Return the surface of the same shape with another longest side, if one is given."""
        if scale is None:
            return self
        box = None if self.box is None else self.box * (scale / self.scale)
        return replace(self, scale=scale, box=box)

    def to_unit(self, points: np.ndarray) -> np.ndarray:
        """Return points in the unit frame."""
        return points / self.scale

    def bounds(self) -> np.ndarray:
        """Return lowest and highest coordinates; (2, 3)."""
        return self.read().bounds * self.scale

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw points uniformly by area; (count, 3)."""
        surface = self.read()
        return sample_surface(surface.vertices, surface.faces, count, rng) * self.scale

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the nearest surface points (N, 3), and their distances (N,)."""
        if not len(points):
            return points, np.zeros(0)
        nearest, distance = self.read().nearest(self._places(points))
        return nearest * self.scale, distance * self.scale

    def snap(self, points: np.ndarray, tolerance: float, slack: float = 0.0) -> np.ndarray:
        """Move points (N, 3) to the surface; without a stored one they stay, and have to be in the box.

        The tolerance is the greatest distance from the surface or the box, fraction of the size; points
        nearer to the surface than ``slack`` voxels stay where they are. Raises ObjectFolderError if a point
        is further away than the tolerance.
        """
        closest = self.closest_unit_points(points, tolerance, slack)
        return closest * self.scale if self.stored else points

    def closest_unit_points(self, points: np.ndarray, tolerance: float, slack: float = 0.0) -> np.ndarray:
        """Return what `snap` does, but in the unit frame; (N, 3)."""
        places = self._places(points)
        if (most := finite_number("tolerance", tolerance)) < 0:
            raise ObjectFolderError(f"tolerance is {tolerance!r}, expected a fraction of the size")
        if len(points) == 0 or not self.stored:
            self._require_in_box(points, most)
            return places
        surface = self.read()
        snapped, distance = surface.nearest(places)
        far = np.flatnonzero(distance > most)
        if len(far):
            raise ObjectFolderError(
                f"{len(far)} of {len(points)} points are off the surface, the first is row {far[0]} at "
                f"{points[far[0]].round(6).tolist()} m, {distance[far[0]] * self.scale:.3g} m away; expected "
                f"at most {most * self.scale:.3g} m, {most:g} of the size. Points are in metres from the "
                "centre of the bounding box; ObjectFile.nearest moves them to the surface"
            )
        near = distance < slack * surface.grid.spacing
        return np.where(near[:, None], places, snapped)

    def _require_in_box(self, points: np.ndarray, tolerance: float) -> None:
        """Raise ObjectFolderError if a point is outside the box by more than a fraction of its size."""
        if self.box is None:
            return
        low, high = self.box
        slack = tolerance * (high - low).max()
        far = np.flatnonzero(((points < low - slack) | (points > high + slack)).any(1))
        if len(far):
            raise ObjectFolderError(
                f"points: row {far[0]} at {points[far[0]].round(6).tolist()} m is outside the net's bounds, "
                f"{low.tolist()} to {high.tolist()} m, by more than {slack:.3g} m; points are in the "
                "released file's coordinates, metres"
            )

    def _places(self, points: np.ndarray) -> np.ndarray:
        """Return points in the unit frame, if they are near enough to have a nearest one."""
        most = FARTHEST * self.scale
        limits = f", expected coordinates of at most {most:g} m, {FARTHEST:g} times the object's size"
        refuse_rows("points", (np.abs(points) > most).any(1), points, limits)
        return points / self.scale
