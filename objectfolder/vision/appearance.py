"""Base colour and shading normal of a mesh at nearby points."""

import igl
import numpy as np
import trimesh

from objectfolder.mesh import srgb
from objectfolder.mesh.normals import area_vectors, unit_vectors
from objectfolder.vision.scene import Scene


def appearance_at(scene: Scene, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return base colours and shading normals at the mesh's nearest points to points (N, 3), unit frame.

    Colours (N, 3) are linear; normals (N, 3), of unit length, oriented like the mesh's faces; float32.
    """
    mesh = scene.mesh
    vertices, faces = mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64)
    _, face, nearest = igl.point_mesh_squared_distance(np.asarray(points, np.float64), vertices, faces)[:3]
    corners = faces[np.asarray(face).ravel()]
    triangles = vertices[corners]
    weights = trimesh.triangles.points_to_barycentric(triangles, nearest, method="cross")
    weights = np.nan_to_num(weights, nan=1 / 3)[..., None]
    if mesh.texture is not None and mesh.uv is not None:
        color = _texels(mesh.texture, (mesh.uv[corners] * weights).sum(1))
    else:
        color = (scene.vertex_colors[corners] * weights).sum(1)
    if mesh.normals is None:
        normals = unit_vectors(area_vectors(vertices, corners))
    else:
        normals = unit_vectors((mesh.normals[corners] * weights).sum(1))
    return color.astype(np.float32), normals.astype(np.float32)


def _texels(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Look up a repeating sRGB texture bilinearly; linear colours, uv from the lower left corner."""
    height, width = texture.shape[:2]
    linear = srgb.decode(np.arange(256) / 255)
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    right, down = (x - column)[:, None], (y - row)[:, None]

    def at(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return linear[texture[j % height, i % width]]

    upper = at(column, row) * (1 - right) + at(column + 1, row) * right
    lower = at(column, row + 1) * (1 - right) + at(column + 1, row + 1) * right
    return upper * (1 - down) + lower * down
