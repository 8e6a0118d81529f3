"""Gaussian splats of an object under one light, for viewers of splats."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from objectfolder.base.checks import require_memory, whole_number
from objectfolder.base.disk import new_folder
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.vision.cameras import CAMERA_RADIUS, Intrinsics, look_at, project
from objectfolder.vision.query import Environment, Lights

COUNT, DEGREE, MAX_DEGREE = 100_000, 2, 3
VIEWS, PIXELS = 48, 384  #: pictures from which the colours are taken, and their side
SPREAD = 0.65  #: standard deviation of a splat along the surface, over the distance to its neighbours
FLATNESS = 0.1  #: standard deviation across the surface, over that along it
#: Depth of splats under the surface, in pixels of the views that they are for: viewers blur splats, and many
#: overlap at outlines, which would grow by about as much.
INSET = 1.3
_DEPTHS = 8  # depths that are tried where a wall is thin
OPACITY = 0.95
#: Of views that see a point: least cosine of the angle to its normal, and error of the depth, unit frame.
_MIN_COSINE, _DEPTH_TOLERANCE = 0.15, 0.01
_OVERSAMPLED = 6  # points drawn for each that is kept
_RIDGE = 0.02  # pull of the coefficients of direction to 0, in views
_C0 = 0.28209479177387814  # of the spherical harmonics
_NEIGHBOURS = 4

Report = Callable[[int, int], None]


@dataclass(frozen=True)
class Splats:
    """Gaussians of one object; object frame, metres."""

    points: np.ndarray  #: (N, 3)
    normals: np.ndarray  #: (N, 3), outward
    scales: np.ndarray  #: (N, 3) standard deviations along the own axes, the last along the normal
    turns: np.ndarray  #: (N, 4) quaternions w, x, y, z of the own axes
    opacity: np.ndarray  #: (N,)
    colors: np.ndarray  #: (N, K, 3) spherical harmonics of sRGB less 1/2; K is 1, 4, 9 or 16

    def __len__(self) -> int:
        return len(self.points)

    def to_ply(self) -> bytes:
        """Return the content of a .ply as the authors of 3D Gaussian Splatting write it."""
        names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3))]
        rest = 3 * (self.colors.shape[1] - 1)
        names += [*(f"f_rest_{k}" for k in range(rest)), "opacity"]
        names += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
        logit = np.log(self.opacity / (1 - self.opacity))
        ordered = self.colors[:, 1:].transpose(0, 2, 1).reshape(len(self), -1)  # channel by channel
        parts = [self.points, self.normals, self.colors[:, 0], ordered, logit[:, None]]
        table = np.concatenate([*parts, np.log(self.scales), self.turns], 1).astype("<f4")
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(self)}"]
        lines += [*(f"property float {name}" for name in names), "end_header", ""]
        return "\n".join(lines).encode("ascii") + table.tobytes()


def write_splats(
    file: ObjectFile, out: str | Path, count: int = COUNT, degree: int = DEGREE, lights: Lights = "studio",
    environment: Environment = None, resolution: int = 256, report: Report | None = None,
) -> Path:  # fmt: skip
    """Write ``OUT/<key>/<key>.ply``, which viewers of splats load; see `splats`.

    Raises ObjectFolderError if the folder exists already, or as `splats` does.
    """
    found = splats(file, count, degree, lights, environment, resolution, report)
    content = found.to_ply()
    with new_folder(f"{file.key}: splats", Path(out) / file.key, len(content), "") as new:
        (new / f"{file.key}.ply").write_bytes(content)
    return Path(out) / file.key / f"{file.key}.ply"


def splats(
    file: ObjectFile, count: int = COUNT, degree: int = DEGREE, lights: Lights = "studio",
    environment: Environment = None, resolution: int = 256, report: Report | None = None,
) -> Splats:  # fmt: skip
    """Return flat Gaussians on the stored surface, with colours as the object has them under given lights.

    Points are spread evenly over the surface. Their colours are the least-squares fit of spherical harmonics
    to what views from all sides see of them, so reflections move with the viewer as far as the degree allows.

    Parameters
    ----------
    file : ObjectFile
        With geometry and vision.
    count : int
        Of points, about.
    degree : int
        Of the spherical harmonics, 0 to 3; 0 looks the same from everywhere.
    lights, environment
        As of `ObjectFile.view`.
    resolution : int
        Side of the views for which outlines are right, pixels, of `ObjectFile.view`'s default camera at
        distance 2.5. In larger ones the object is that much too thin, in smaller ones too thick.
    report : function, optional
        Called with the number of views that were drawn, and of all.

    Raises
    ------
    ObjectFolderError
        If the file lacks a part, the degree is not 0 to 3, or there is not enough memory.
    """
    file.require("geometry", "vision")
    count, degree = whole_number("count", count, 100), whole_number("degree", degree)
    if not 0 <= degree <= MAX_DEGREE:
        raise ObjectFolderError(f"degree is {degree}, expected 0 to {MAX_DEGREE}")
    terms = (degree + 1) ** 2
    needed = 8 * count * (terms * (terms + 3) + 3 * _OVERSAMPLED)
    require_memory(f"{count:,} splats of degree {degree}", needed, "ask for fewer")
    points = spread_points(file, count)
    normals = (
        file.surface.grid.normals(torch.from_numpy(points.astype(np.float32))).numpy().astype(np.float64)
    )
    colors = _fit_colors(file, points, normals, degree, lights, environment, report)
    near = cKDTree(points).query(points, _NEIGHBOURS + 1)[0][:, 1:].mean(1)
    along = SPREAD * np.minimum(near, 3 * np.median(near))
    scales = np.stack([along, along, FLATNESS * along], 1)
    pixel = CAMERA_RADIUS / Intrinsics.square(resolution).focal
    places = points - _insets(file, points, normals, INSET * pixel)[:, None] * normals
    size = file.scale
    return Splats(
        places * size, normals, scales * size, _turns(normals), np.full(len(points), OPACITY), colors
    )


def _insets(file: ObjectFile, points: np.ndarray, normals: np.ndarray, most: float) -> np.ndarray:
    """Return how deep under the surface splats are, unit frame: at most to the middle of a wall; (N,)."""
    out = np.zeros(len(points))
    for depth in most * np.arange(1, _DEPTHS + 1) / _DEPTHS:
        places = torch.from_numpy((points - depth * normals).astype(np.float32))
        inside = file.surface.grid.distance(places).numpy() <= -0.8 * depth
        out[inside] = depth
    return out


def spread_points(file: ObjectFile, count: int) -> np.ndarray:
    """Return about so many points, evenly spread over the surface, unit frame; (N, 3)."""
    drawn = file.sample_surface(_OVERSAMPLED * count) / file.scale
    low, high = 0.0, 1.0  # side of cubes, each of which keeps one point
    kept = np.arange(len(drawn))
    for _ in range(12):
        side = (low + high) / 2
        cells = np.floor(drawn / side).astype(np.int64)
        cells -= cells.min(0)
        spans = cells.max(0) + 1
        _, kept = np.unique(
            (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2], return_index=True
        )
        low, high = (side, high) if len(kept) > count else (low, side)
    return drawn[kept]


def _fit_colors(
    file: ObjectFile, points: np.ndarray, normals: np.ndarray, degree: int, lights: Lights,
    environment: Environment, report: Report | None,
) -> np.ndarray:  # fmt: skip
    """Return spherical harmonics of the colours of points, fitted to views; (N, K, 3)."""
    places, seen_by = _around(VIEWS), Intrinsics.square(PIXELS)
    terms = (degree + 1) ** 2
    gram, right = np.zeros((len(points), terms, terms)), np.zeros((len(points), terms, 3))
    for done, place in enumerate(places):
        pose = look_at(place[None])[0]
        view = file.render(
            pose, intrinsics=seen_by, supersample=False, lights=lights, environment=environment
        )
        rows, color, weight = _seen(points, normals, pose, seen_by, view.rgb[0], view.depth[0] / file.scale)
        toward = points[rows] - place
        basis = harmonics(toward / np.linalg.norm(toward, axis=1, keepdims=True), degree)
        gram[rows] += weight[:, None, None] * basis[:, :, None] * basis[:, None]
        right[rows] += weight[:, None, None] * basis[:, :, None] * (color - 0.5)[:, None]
        if report:
            report(done + 1, len(places))
    seen = gram[:, 0, 0] > 0
    if not seen.any():
        raise ObjectFolderError(f"{file.key}: no view shows the stored surface; build the object again")
    ridge = _RIDGE * np.eye(terms)
    ridge[0, 0] = 1e-9
    colors = np.linalg.solve(gram[seen] + ridge, right[seen])
    out = np.empty((len(points), terms, 3))
    out[seen] = colors
    if not seen.all():  # hidden from all sides
        out[~seen] = colors[cKDTree(points[seen]).query(points[~seen])[1]]
    return out


def _seen(
    points: np.ndarray, normals: np.ndarray, pose: np.ndarray, seen_by: Intrinsics, image: np.ndarray,
    depths: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return which points a view shows (R,), their colours (R, 3) and how directly it sees them (R,)."""
    spots, depth = project(points, pose, seen_by)
    ways = pose[:3, 3] - points
    cosine = (ways * normals).sum(1) / np.linalg.norm(ways, axis=1)
    inside = (
        (cosine > _MIN_COSINE)
        & (spots >= 1).all(1)
        & (spots < [seen_by.width - 1, seen_by.height - 1]).all(1)
    )
    rows = np.flatnonzero(inside)
    corner = spots[rows] - 0.5
    first = np.floor(corner).astype(int)
    share = corner - first
    color, whole = np.zeros((len(rows), 3)), np.ones(len(rows), bool)
    for dx in (0, 1):  # bilinear, where all four pixels show the same surface
        for dy in (0, 1):
            x, y = first[:, 0] + dx, first[:, 1] + dy
            part = abs(share[:, 0] - 1 + dx) * abs(share[:, 1] - 1 + dy)
            color += part[:, None] * image[y, x]
            whole &= abs(depths[y, x] - depth[rows]) < _DEPTH_TOLERANCE / cosine[rows]
    return rows[whole], color[whole], cosine[rows][whole]


def harmonics(directions: np.ndarray, degree: int) -> np.ndarray:
    """Return real spherical harmonics of unit vectors (N, 3), in the order and signs of splats; (N, K)."""
    x, y, z = directions.T
    parts = [np.full(len(directions), _C0)]
    if degree > 0:
        parts += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        parts += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z]
        parts += [0.31539156525252005 * (2 * zz - xx - yy), -1.0925484305920792 * x * z]
        parts += [0.5462742152960396 * (xx - yy)]
    if degree > 2:
        parts += [-0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z]
        parts += [-0.4570457994644658 * y * (4 * zz - xx - yy)]
        parts += [0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy)]
        parts += [-0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy)]
        parts += [-0.5900435899266435 * x * (xx - 3 * yy)]
    return np.stack(parts, 1)


def _around(count: int) -> np.ndarray:
    """Return places evenly on a sphere around the object, unit frame; (count, 3). A Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, math.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z**2)
    return CAMERA_RADIUS * np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1)


def _turns(normals: np.ndarray) -> np.ndarray:
    """Return quaternions w, x, y, z that turn the z axis to unit vectors (N, 3); (N, 4)."""
    x, y, z = normals.T
    turns = np.stack([1 + z, -y, x, 0 * x], 1)
    turns[z < -1 + 1e-9] = [0, 1, 0, 0]
    out: np.ndarray = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    return out
