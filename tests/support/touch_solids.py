"""Solids to press on, in metres."""

import trimesh

from objectfolder.mesh.raycast import RayCaster


def caster(*meshes):
    mesh = trimesh.util.concatenate(meshes)
    return RayCaster(mesh.vertices, mesh.faces)


def slab(low, high, side=0.08):
    """A plate from z = low to z = high."""
    mesh = trimesh.creation.box((side, side, high - low))
    mesh.apply_translation((0.0003, 0.0007, (low + high) / 2))
    return mesh
