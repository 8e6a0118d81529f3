"""Images of meshes, ray cast without OpenGL."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from objectfolder.base.figures import tile
from objectfolder.mesh.raycast import RayCaster
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at

SIDE = 128  #: pixels of a picture
CAMERA = np.array([1.5, -1.5, 1.35])  #: unit frame


def render_shaded(vertices: np.ndarray, faces: np.ndarray, side: int = SIDE) -> np.ndarray:
    """Draw a mesh, (V, 3) in the unit frame and (F, 3), with a light at the camera; (side, side, 3) uint8.

    An empty mesh gives a white image.
    """
    picture = np.full((side * side, 3), 255, np.uint8)
    if len(faces):
        across = np.arange(side) + 0.5
        pixels = np.stack(np.meshgrid(across, across), -1).reshape(-1, 2)
        origins, directions = camera_rays(look_at(CAMERA)[0], Intrinsics.square(side), pixels)
        ray, _, face, _ = RayCaster(vertices, faces).intersect(origins, directions)
        a, b, c = (vertices[faces[face, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        facing = np.abs((normals * directions[ray]).sum(1))
        picture[ray] = (np.outer(0.2 + 0.75 * facing, (150, 190, 225))).astype(np.uint8)
    return picture.reshape(side, side, 3)


def sheet(views: np.ndarray, meshes: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]]) -> np.ndarray:
    """Lay out rows of a view and its meshes, equally many for each; (H', W', 3) uint8."""
    pictures = [
        picture
        for view, shapes in zip(views, meshes)
        for picture in (
            np.asarray(Image.fromarray(view).resize((SIDE, SIDE))),
            *(render_shaded(vertices, faces) for vertices, faces in shapes),
        )
    ]
    return tile(np.stack(pictures), columns=1 + len(meshes[0]))
