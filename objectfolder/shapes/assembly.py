"""Assembly of painted parts: charts and texture of the resulting surface."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import manifold3d
import numpy as np
from scipy.spatial import cKDTree

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.normals import area_vectors
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.mesh.topology import components, half_edges
from objectfolder.shapes.atlas import MARGIN, Chart, Paint, pack_charts
from objectfolder.shapes.finish import finish
from objectfolder.shapes.parameters import Order
from objectfolder.shapes.texture import rgb

#: Weights of a part's axes, so that all facets at 45 degrees go to the same chart.
PREFERENCE = np.array([1.0, 1.04, 1.08])
LONGEST = 0.08  #: edge length limit, approximate, in sizes of the object: sounds are excited at vertices
LATE_WOOD = np.array([0.78, 0.68, 0.58])  #: factor from the colour of dyed wood to its late wood
BORDER_SAMPLES = 4  #: points per border edge of a chart, from which its surface is extrapolated


@dataclass(frozen=True)
class Look:
    """Finish of an object; parts may vary in piece, grain direction and colour."""

    finish: str
    size: float  #: longest side of the object, m
    color: str | None = None
    accent: str | None = None
    seed: int = 0

    @classmethod
    def of(cls, order: Order, size: float, **changed: str | None) -> "Look":
        """Return the finish that was ordered, but for what is changed."""
        asked = {name: getattr(order, name) for name in ("finish", "color", "accent", "seed")}
        return cls(size=size, **asked | changed)

    def paint(self, axis: Sequence[float] | np.ndarray | None = None, piece: int = 0) -> Paint:
        """Return the paint of one piece, its grain along ``axis``."""
        direction = None if axis is None else [float(x) for x in axis]
        return finish(self.finish, self.size, self.color, self.accent, self.seed + piece, direction).paint

    def dye(self, color: str | None) -> "Look":
        """Return the same finish in another colour; wood gets a darker shade as late wood."""
        late = None
        if self.finish == "wood" and color is not None:
            late = "".join(f"{round(255 * c):02x}" for c in LATE_WOOD * rgb(color))
        return replace(self, color=color, accent=late)


@dataclass(frozen=True)
class PaintedPart:
    """Solid in its final position, with the paint of its surface."""

    solid: manifold3d.Manifold
    paint: Paint
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))  #: columns: projection axes of its charts

    @classmethod
    def of(cls, solid: manifold3d.Manifold, paint: Paint, axes: np.ndarray | None = None) -> "PaintedPart":
        """Return a part whose surface stays identifiable after Boolean operations."""
        return cls(solid.as_original(), paint, np.eye(3) if axes is None else axes)


def frame(along: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return orthonormal axes (3, 3) as columns, the first along a vector."""
    first = np.asarray(along, np.float64) / np.linalg.norm(along)
    second = np.cross([0.0, 0.0, 1.0] if abs(first[2]) < 0.9 else [1.0, 0.0, 0.0], first)
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], 1)


def union(parts: Sequence[PaintedPart]) -> manifold3d.Manifold:
    """Unite all parts."""
    return manifold3d.Manifold.batch_boolean([part.solid for part in parts], manifold3d.OpType.Add)


def assemble(
    solid: manifold3d.Manifold | Sequence[manifold3d.Manifold], parts: Sequence[PaintedPart], look: Look,
    texture_size: int,
) -> TexturedMesh:  # fmt: skip
    """Chart, paint and bake the surface of a solid made from parts by Boolean operations.

    A chart is a connected piece of one part's surface, projected along the part's axis that it faces.
    ``parts`` are all operands, cutting tools included; several solids stay closed pieces of their own, as in
    most models of furniture. The finish of ``look`` sets roughness and metallic. Raises `ObjectFolderError`
    if ``texture_size``, texels, is too small for the charts.
    """
    # Boolean operations leave long edges where flats meet: divide them.
    solids = [solid] if isinstance(solid, manifold3d.Manifold) else solid
    meshes = [one.refine_to_length(LONGEST * look.size).to_mesh64() for one in solids]
    vertices = np.concatenate([np.asarray(mesh.vert_properties, np.float64) for mesh in meshes])
    first = np.cumsum([0, *(len(mesh.vert_properties) for mesh in meshes)])
    faces = np.concatenate([np.asarray(mesh.tri_verts, np.int64) + k for mesh, k in zip(meshes, first)])
    owner = np.concatenate([_owners(mesh, parts) for mesh in meshes])
    axes = np.stack([part.axes for part in parts])

    local = np.einsum("fi,fij->fj", area_vectors(vertices, faces), axes[owner])
    axis = np.argmax(np.abs(local) * PREFERENCE, axis=1)
    side = 2 * axis + (np.take_along_axis(local, axis[:, None], 1)[:, 0] < 0)
    label = _connected(faces, owner * 6 + side)

    charts, maps, pieces = [], [], []
    for k in range(label.max() + 1):
        mine = np.flatnonzero(label == k)
        view = _view(axes[owner[mine[0]]], side[mine[0]])
        used, index = np.unique(faces[mine], return_inverse=True)
        seen = vertices[used] @ view
        if np.ptp(seen[:, 1]) > np.ptp(seen[:, 0]):  # rotate tall charts: the atlas packs low charts better
            view = view @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
            seen = vertices[used] @ view
        low = seen.min(0)
        charts.append(_chart(seen - low, index.reshape(-1, 3), view, low, parts[owner[mine[0]]].paint))
        maps.append((seen - low)[:, :2])
        pieces.append((used, mine, index.reshape(-1, 3)))
    least = math.ceil((2 * MARGIN + 4) * math.sqrt(len(charts)))
    if texture_size < least:
        raise ObjectFolderError(
            f"texture_size={texture_size!r}: expected at least {least} texels, which the {len(charts)} "
            "charts of this object need; make the texture larger"
        )
    atlas = pack_charts(charts, texture_size)

    starts = np.cumsum([0, *(len(used) for used, _, _ in pieces)])
    split = np.empty_like(faces)
    for start, (_, mine, index) in zip(starts, pieces):
        split[mine] = index + start
    gloss = finish(look.finish, look.size)
    return TexturedMesh(
        vertices=vertices[np.concatenate([used for used, _, _ in pieces])], faces=split,
        uv=np.concatenate([atlas.uv(k, xy) for k, xy in enumerate(maps)]), texture=atlas.bake(),
        roughness=gloss.roughness, metallic=gloss.metallic,
    )  # fmt: skip


def _owners(mesh: manifold3d.Mesh64, parts: Sequence[PaintedPart]) -> np.ndarray:
    """Return the index of the part (F,) to whose surface each face belongs."""
    identity = {part.solid.original_id(): k for k, part in enumerate(parts)}
    starts = np.asarray(mesh.run_index, np.int64) // 3
    lengths = starts[1:] - starts[:-1]
    return np.repeat([identity[int(i)] for i in mesh.run_original_id], lengths)


def _connected(faces: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """Label (F,) connected regions of faces of one kind, in the order of their first faces."""
    order = np.lexsort(np.sort(half_edges(faces), axis=1).T)
    one, other = order.reshape(-1, 2).T % len(faces)  # a closed surface: edges come in pairs
    same = kind[one] == kind[other]
    label = components(one[same], other[same], len(faces))[1]
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


def _view(axes: np.ndarray, side: int) -> np.ndarray:
    """Return right, up and viewer axes, as columns (3, 3), for a side of a part."""
    k, backward = divmod(int(side), 2)
    right, up, toward = axes[:, (k + 1) % 3], axes[:, (k + 2) % 3], axes[:, k]
    return np.stack([up, right, -toward] if backward else [right, up, toward], 1)


def _chart(seen: np.ndarray, faces: np.ndarray, view: np.ndarray, low: np.ndarray, paint: Paint) -> Chart:
    """Build the chart of a relief projected along z; `seen` (V, 3) is in the view frame, from 0."""
    above = seen[:, 2].max() + 0.1 * float(np.ptp(seen, axis=0).max())
    edges = half_edges(faces)
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    start, stop = seen[edges[first[count == 1]].T]
    border = np.concatenate([start + t * (stop - start) for t in np.arange(BORDER_SAMPLES) / BORDER_SAMPLES])

    def locate(xy: np.ndarray) -> np.ndarray:
        rays = np.column_stack([xy, np.full(len(xy), above)])
        distance, face = RayCaster(seen, faces).first_hit(rays, np.broadcast_to([0.0, 0.0, -1.0], rays.shape))
        height = above - distance.astype(np.float64)
        off = face < 0
        # Beyond the border, extrapolate at the level of its nearest point.
        height[off] = border[cKDTree(border[:, :2]).query(xy[off])[1], 2]
        return (np.column_stack([xy, height]) + low) @ view.T

    return Chart((float(np.ptp(seen[:, 0])), float(np.ptp(seen[:, 1]))), locate, paint)
