"""Closing and simplifying the stored surface."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import trimesh

from objectfolder.base.errors import ObjectFolderError


def close_holes(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Close each hole with a fan of triangles; return the mesh itself if it has none.

    Marching cubes may omit a triangle where a grid sample is exactly zero.
    """
    faces = np.asarray(mesh.faces, np.int64)
    edges, count = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), len(mesh.vertices)
    # Edges whose reverse is in no other face.
    single = np.setdiff1d(edges @ [count, 1], edges @ [1, count], assume_unique=True)
    if not len(single):
        return mesh
    after = {b: a for a, b in (divmod(edge, count) for edge in single.tolist())}
    added = []
    while after:
        loop = [next(iter(after))]
        while (vertex := after.pop(loop[-1], loop[0])) != loop[0]:
            loop.append(vertex)
        added += [(loop[0], b, c) for b, c in pairwise(loop[1:])]
    return trimesh.Trimesh(mesh.vertices, np.concatenate([faces, added]), process=False)


def simplify(mesh: trimesh.Trimesh, tolerance: float) -> tuple[trimesh.Trimesh, ...]:
    """Split a mesh into connected closed surfaces, displaced by at most ``tolerance``, of few triangles.

    Surfaces with a negative volume are cavities. There are none if the mesh is not closed. Raises
    ObjectFolderError if manifold3d is not installed.
    """
    try:
        from manifold3d import Manifold, Mesh64
    except ImportError as error:
        raise missing_library("manifold3d") from error
    closed = close_holes(mesh)
    solid = Manifold(Mesh64(np.asarray(closed.vertices), np.asarray(closed.faces, np.uint64)))
    if solid.is_empty():
        return ()
    shells = (shell.to_mesh64() for shell in solid.simplify(tolerance).decompose())
    return tuple(
        trimesh.Trimesh(shell.vert_properties[:, :3], shell.tri_verts.astype(np.int64), process=False)
        for shell in shells
    )


def merge_meshes(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Concatenate meshes into one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts)]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


def missing_library(library: str) -> ObjectFolderError:
    """Return the error for a library of the extra ``rl`` that is not installed."""
    return ObjectFolderError(
        f"{library} is not installed; this needs the extra rl (`objectfolder doctor` says how to install it)"
    )
