"""Ground-truth views with Mitsuba 3; its scalar variant needs no system library and is deterministic."""

import math
from typing import Any

import drjit
import mitsuba as mi
import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.textured import PLAIN
from objectfolder.vision.cameras import Intrinsics, covered_rectangle, project
from objectfolder.vision.scene import BOUNCES, LIGHT_INTENSITY, SPECULAR, Scene

SCALAR = "scalar_rgb"
# Depth from which a camera sees. Rays start there, so that a nearer start rounds all of them differently.
NEAR_PLANE, MIN_NEAR_PLANE = 1e-2, 1e-3
MIN_LLVM = (19,)  # 14 to 16 cannot compile the kernels and abort


class MitsubaRenderer:
    """Path tracing with one thread.

    The box filter makes the result independent of the thread count; multijittered samples gain 4 to 6 dB at
    equal count. Mitsuba's variant is ``scalar_rgb``, ``llvm_ad_rgb`` (needs an LLVM library) or
    ``cuda_ad_rgb`` (a GPU). Raises ImportError if the variant cannot run here.
    """

    def __init__(self, scene: Scene, variant: str = SCALAR):
        self._variant = variant
        self._choose_variant()
        self.version = f"mitsuba {mi.__version__} {variant}"
        self._vertices = scene.mesh.vertices
        look = {"roughness": scene.roughness, "metallic": scene.metallic, "specular": SPECULAR}
        principled = {"type": "principled", "base_color": _base_color(scene)} | look
        bsdf = mi.load_dict({"type": "twosided", "bsdf": principled})
        elements = {
            "type": "scene",
            # A path of two vertices is direct light.
            "integrator": {"type": "path", "max_depth": 2 + BOUNCES, "hide_emitters": True},
            "object": _shape(scene, bsdf),
            "light": {"type": "point", "position": [0.0, 0.0, 1.0], "intensity": LIGHT_INTENSITY},
        }
        if scene.ambient:
            elements["room"] = {"type": "constant", "radiance": scene.ambient}
        self._scene = mi.load_dict(elements)
        self._parameters = mi.traverse(self._scene)

    def _choose_variant(self) -> None:
        mi.set_variant(self._variant)
        if self._variant.startswith("llvm") and drjit.detail.llvm_version() < MIN_LLVM:
            found = ".".join(map(str, drjit.detail.llvm_version()))
            raise ImportError(
                f"LLVM {found} found, which crashes Dr.Jit: set DRJIT_LIBLLVM_PATH to a newer version"
            )
        mi.set_log_level(mi.LogLevel.Error)
        drjit.set_thread_count(1)

    def render(
        self, camera_to_world: np.ndarray, light: np.ndarray, intrinsics: Intrinsics, samples: int, seed: int
    ) -> np.ndarray:
        """Render one view; see `objectfolder.vision.renderers.registry.Renderer`."""
        if intrinsics.fx != intrinsics.fy:
            raise ObjectFolderError(
                f"mitsuba's pixels are square, but focal lengths are {intrinsics.fx:g}, {intrinsics.fy:g}: "
                "make them equal, or use the renderer cycles or raster"
            )
        image = np.zeros((intrinsics.height, intrinsics.width, 4), np.float32)
        left, top, right, bottom = 0, 0, intrinsics.width, intrinsics.height
        if self._variant == SCALAR:
            # Render only where the object may be, which saves a quarter of the time. The other variants would
            # recompile their kernel for each size.
            left, top, right, bottom = covered_rectangle(self._vertices, camera_to_world, intrinsics)
        if left == right or top == bottom:
            return image
        self._choose_variant()
        _, depth = project(self._vertices, camera_to_world, intrinsics)
        # Mitsuba's camera looks along +z with +x to the left.
        to_world = camera_to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])
        film = {"type": "hdrfilm", "width": intrinsics.width, "height": intrinsics.height}
        film |= {"crop_offset_x": left, "crop_width": right - left}
        film |= {"crop_offset_y": top, "crop_height": bottom - top}
        film |= {"rfilter": {"type": "box"}, "pixel_format": "rgba", "component_format": "float32"}
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": 2 * math.degrees(math.atan(intrinsics.width / 2 / intrinsics.fx)),
                "fov_axis": "x",
                "principal_point_offset_x": 0.5 - intrinsics.cx / intrinsics.width,
                "principal_point_offset_y": 0.5 - intrinsics.cy / intrinsics.height,
                "near_clip": NEAR_PLANE if depth.min() > NEAR_PLANE else MIN_NEAR_PLANE,
                "to_world": mi.ScalarTransform4f(to_world.tolist()),
                "film": film,
                "sampler": {"type": "multijitter", "sample_count": samples},
            }
        )
        point = mi.ScalarPoint3f if self._variant == SCALAR else mi.Point3f
        self._parameters["light.position"] = point(*map(float, light))
        self._parameters.update()
        rendered = mi.render(self._scene, sensor=sensor, seed=mi.UInt32(seed), spp=samples)
        image[top:bottom, left:right] = np.array(rendered)
        return image


def _base_color(scene: Scene) -> dict[str, Any]:
    if scene.base_color == "texture":
        bitmap = mi.Bitmap(np.array(scene.mesh.texture))
        return {"type": "bitmap", "bitmap": bitmap, "filter_type": "bilinear"}
    if scene.base_color == "vertices":
        return {"type": "mesh_attribute", "name": "vertex_color"}
    return {"type": "rgb", "value": PLAIN}


def _shape(scene: Scene, bsdf: "mi.BSDF") -> "mi.Mesh":
    mesh = scene.mesh
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    properties["face_normals"] = mesh.normals is None
    uv = mesh.uv
    held = {"has_vertex_normals": mesh.normals is not None, "has_vertex_texcoords": uv is not None}
    shape = mi.Mesh("object", len(mesh.vertices), len(mesh.faces), props=properties, **held)
    if scene.base_color == "vertices":
        shape.add_attribute("vertex_color", 3, scene.vertex_colors.ravel().tolist())
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    if mesh.normals is not None:
        parameters["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
    if uv is not None:
        # Mitsuba's images start at the top, texture coordinates at the bottom.
        from_top = uv * np.array([1, -1]) + np.array([0, 1])
        parameters["vertex_texcoords"] = from_top.astype(np.float32).ravel()
    parameters.update()
    return shape
