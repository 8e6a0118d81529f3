"""Previews with OpenGL (pyrender): no shadows, no indirect light, and radiance above 1 is cut off."""

import atexit
import os
from functools import cache

import numpy as np
from PIL import Image

from objectfolder.mesh.normals import area_vectors, unit_vectors
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.scene import LIGHT_INTENSITY, Scene

# By default pyrender opens a window; it also uses a name that numpy 2 has dropped.
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
vars(np).setdefault("infty", np.inf)

import pyrender  # noqa: E402
from OpenGL.error import Error as OpenGLError  # noqa: E402

GAMMA = 2.2  # of pyrender's shader
MAX_SIDE = 4  #: samples per side of a pixel
MIN_NEAR_PLANE = 1e-3  #: of the plane before which nothing is drawn


@cache
def canvas() -> "pyrender.OffscreenRenderer":
    """Return the canvas shared by all renderers: deleting one ends OpenGL for the others.

    Raises ImportError if OpenGL cannot draw here without a window.
    """
    try:
        offscreen = pyrender.OffscreenRenderer(1, 1)
    except (OpenGLError, RuntimeError, ValueError) as error:
        raise ImportError(f"OpenGL does not start: {error}") from error
    atexit.register(offscreen.delete)
    return offscreen


class RasterRenderer:
    """Preview renderer: direct light on every surface that faces the light, without shadows.

    Raises ImportError if OpenGL cannot draw here without a window.
    """

    def __init__(self, scene: Scene):
        self.version = f"pyrender {pyrender.__version__}"
        self._scene = pyrender.Scene(bg_color=np.zeros(4), ambient_light=np.full(3, scene.ambient))
        self._scene.add(pyrender.Mesh([_primitive(scene)]))
        self._light = self._scene.add(pyrender.PointLight(intensity=LIGHT_INTENSITY))
        self._canvas = canvas()

    def render(
        self, camera_to_world: np.ndarray, light: np.ndarray, intrinsics: Intrinsics, samples: int, seed: int
    ) -> np.ndarray:
        """Render one view; see `objectfolder.vision.renderers.registry.Renderer`.

        Samples lie on a regular grid, at most `MAX_SIDE` a side; the seed is not used.
        """
        side = min(max(round(samples**0.5), 1), MAX_SIDE)
        height, width = side * intrinsics.height, side * intrinsics.width
        fx, fy, cx, cy = (side * x for x in (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy))
        # Of the ball that holds the unit frame: wider planes would leave depths from afar no resolution.
        depth = float(camera_to_world[:3, 3] @ camera_to_world[:3, 2])
        near, far = max(depth - 1, MIN_NEAR_PLANE), max(depth + 1, 2 * MIN_NEAR_PLANE)
        camera = pyrender.IntrinsicsCamera(fx, fy, cx, cy, near, far)
        node = self._scene.add(camera, pose=np.asarray(camera_to_world, np.float64))
        pose = np.eye(4)
        pose[:3, 3] = light
        self._scene.set_pose(self._light, pose)
        self._canvas.viewport_width, self._canvas.viewport_height = width, height
        drawn, _ = self._canvas.render(self._scene, pyrender.RenderFlags.RGBA)
        self._scene.remove_node(node)
        encoded = drawn.astype(np.float32) / 255
        alpha = encoded[..., 3:]
        # The canvas averages encoded colours with the black background, that is, multiplies by alpha.
        linear = alpha * (encoded[..., :3] / np.maximum(alpha, 1 / 255)) ** GAMMA
        fine = np.concatenate([linear, alpha], 2)
        return fine.reshape(intrinsics.height, side, intrinsics.width, side, 4).mean((1, 3))


def _primitive(scene: Scene) -> "pyrender.Primitive":
    """Return the mesh with separate vertices per face, to allow flat shading."""
    mesh = scene.mesh
    if mesh.normals is None:
        normals = unit_vectors(area_vectors(mesh.vertices, mesh.faces)).repeat(3, 0)
    else:
        normals = mesh.normals[mesh.faces].reshape(-1, 3)
    look = {"metallicFactor": scene.metallic, "roughnessFactor": scene.roughness}
    material = pyrender.MetallicRoughnessMaterial(doubleSided=True, **look)
    uv, colors = None, None
    if scene.base_color == "texture":
        assert mesh.uv is not None
        assert mesh.texture is not None
        uv, texture = mesh.uv[mesh.faces].reshape(-1, 2), Image.fromarray(mesh.texture)
        material.baseColorTexture = pyrender.Texture(source=texture, source_channels="RGB")
    else:
        colors = scene.vertex_colors[mesh.faces].reshape(-1, 3)
    corners = {"positions": mesh.vertices[mesh.faces].reshape(-1, 3), "normals": normals}
    corners |= {"texcoord_0": uv, "color_0": colors}
    return pyrender.Primitive(**corners, mode=pyrender.GLTF.TRIANGLES, material=material)
