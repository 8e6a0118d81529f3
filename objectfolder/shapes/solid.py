"""Charted surface patches, welded into a closed solid and converted to a textured mesh."""

from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.atlas import Atlas


@dataclass(frozen=True)
class Patch:
    """Triangles of one chart."""

    vertices: np.ndarray  #: (V, 3) m
    faces: np.ndarray  #: (F, 3) counter-clockwise seen from outside
    xy: np.ndarray  #: (V, 2) coordinates in the chart, m
    chart: int  #: index of the chart in the atlas


def weld_patches(patches: Sequence[Patch], atlas: Atlas) -> manifold3d.Manifold:
    """Join patches along their common borders into a closed solid that carries texture coordinates.

    Manifold keeps the coordinates as vertex properties and interpolates them where a Boolean operation cuts
    a triangle, so that charts stay exact.
    """
    positions = np.concatenate([p.vertices for p in patches])
    uv = np.concatenate([atlas.uv(p.chart, p.xy) for p in patches])
    starts = np.cumsum([0, *(len(p.vertices) for p in patches)])
    faces = np.concatenate([p.faces + start for p, start in zip(patches, starts)])

    first, group = group_coincident(positions)
    twin = first[group]
    copies = np.flatnonzero(twin != np.arange(len(twin)))
    mesh = manifold3d.Mesh64(
        vert_properties=np.hstack([positions[twin], uv]),
        tri_verts=faces.astype(np.uint64),
        merge_from_vert=copies.astype(np.uint64),
        merge_to_vert=twin[copies].astype(np.uint64),
        face_id=np.arange(len(faces), dtype=np.uint64),  # distinct, so that flat regions keep their even mesh
    )
    solid = manifold3d.Manifold(mesh)
    assert solid.status() == manifold3d.Error.NoError, solid.status()
    return solid


def group_coincident(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group coincident positions (V, 3): first member of each group (G,), and group of each (V,)."""
    # An irregular factor, so that round dimensions do not fall on the border between two grains.
    grain = 1.234567e-7 * np.ptp(positions, axis=0).max()
    _, first, group = np.unique(np.round(positions / grain), axis=0, return_index=True, return_inverse=True)
    return first, group.ravel()


def bake_mesh(
    solid: manifold3d.Manifold, atlas: Atlas, roughness: float, metallic: float = 0.0
) -> TexturedMesh:
    """Bake the atlas and return the textured mesh of a solid from `weld_patches`."""
    mesh = solid.to_mesh64()
    properties = np.asarray(mesh.vert_properties, np.float64)
    return TexturedMesh(
        vertices=properties[:, :3].copy(), faces=np.asarray(mesh.tri_verts, np.int64),
        uv=properties[:, 3:].copy(), texture=atlas.bake(), roughness=roughness, metallic=metallic,
    )  # fmt: skip
