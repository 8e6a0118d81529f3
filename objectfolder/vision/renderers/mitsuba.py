"""Ground-truth views with Mitsuba 3 (scalar variant: needs no system library, same bytes every time)."""

import math

import drjit
import mitsuba as mi
import numpy as np

from objectfolder.mesh import srgb
from objectfolder.mesh.textured import DEFAULT_ROUGHNESS, TexturedMesh
from objectfolder.vision.cameras import Intrinsics

VARIANT = "scalar_rgb"
MIN_ROUGHNESS = 0.05  # a mirror would show a point light as nothing
MAX_DEPTH = 4  # path length: direct light and two bounces


class MitsubaRenderer:
    """One textured object lit by one point light, in the unit frame.

    The light's intensity is pi, so a white Lambertian surface that faces it at distance 1 has radiance 1.

    Parameters
    ----------
    mesh : TexturedMesh
        Unit frame.
    """

    def __init__(self, mesh: TexturedMesh):
        mi.set_variant(VARIANT)
        mi.set_log_level(mi.LogLevel.Error)
        drjit.set_thread_count(1)
        roughness = DEFAULT_ROUGHNESS if mesh.roughness is None else mesh.roughness
        bsdf = mi.load_dict(
            {
                "type": "twosided",
                "bsdf": {
                    "type": "principled",
                    "base_color": _base_color(mesh),
                    "roughness": max(float(roughness), MIN_ROUGHNESS),
                    "metallic": mesh.metallic or 0.0,
                    "specular": 0.5,
                },
            }
        )
        self._scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": MAX_DEPTH, "hide_emitters": True},
                "object": _shape(mesh, bsdf),
                "light": {"type": "point", "position": [0.0, 0.0, 1.0], "intensity": math.pi},
            }
        )
        self._parameters = mi.traverse(self._scene)

    def render(
        self, camera_to_world: np.ndarray, light: np.ndarray, intrinsics: Intrinsics, samples: int, seed: int
    ) -> np.ndarray:
        """Render one view.

        The box filter keeps the result the same for any thread count; multijittered samples are worth
        4 to 6 dB at equal count.

        Parameters
        ----------
        camera_to_world : (4, 4) array
        light : (3,) array
        samples : int
            Per pixel.

        Returns
        -------
        (H, W, 4) float32, linear, premultiplied by alpha
        """
        # Mitsuba's camera looks along +z with +x to the left.
        to_world = camera_to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": 2 * math.degrees(math.atan(intrinsics.width / 2 / intrinsics.focal)),
                "fov_axis": "x",
                "to_world": mi.ScalarTransform4f(to_world.tolist()),
                "film": {
                    "type": "hdrfilm",
                    "width": intrinsics.width,
                    "height": intrinsics.height,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgba",
                    "component_format": "float32",
                },
                "sampler": {"type": "multijitter", "sample_count": samples},
            }
        )
        self._parameters["light.position"] = mi.ScalarPoint3f(*map(float, light))
        self._parameters.update()
        return np.array(mi.render(self._scene, sensor=sensor, seed=mi.UInt32(seed), spp=samples))


def _base_color(mesh: TexturedMesh) -> dict:
    if mesh.texture is not None and mesh.uv is not None:
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.array(mesh.texture)), "filter_type": "bilinear"}
    if mesh.vertex_colors is not None:
        return {"type": "mesh_attribute", "name": "vertex_color"}
    return {"type": "rgb", "value": 0.6}


def _shape(mesh: TexturedMesh, bsdf: "mi.BSDF") -> "mi.Mesh":
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    properties["face_normals"] = True
    uv = mesh.uv
    shape = mi.Mesh(
        "object",
        len(mesh.vertices),
        len(mesh.faces),
        has_vertex_normals=False,
        has_vertex_texcoords=uv is not None,
        props=properties,
    )
    if mesh.vertex_colors is not None:
        linear = srgb.decode(mesh.vertex_colors / 255.0)
        shape.add_attribute("vertex_color", 3, linear.astype(np.float32).ravel().tolist())
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    if uv is not None:
        # Mitsuba's images start at the top, texture coordinates at the bottom.
        parameters["vertex_texcoords"] = (
            (uv * np.array([1, -1]) + np.array([0, 1])).astype(np.float32).ravel()
        )
    parameters.update()
    return shape
