"""Pictures of a MuJoCo scene by ray casting: no OpenGL, no window, the same bytes everywhere."""

from typing import Any

import mujoco
import numpy as np
import trimesh

from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.srgb import decode, encode

SKY = 0.93  #: grey of the background
LIGHT = np.array([0.35, -0.5, 0.8]) / np.linalg.norm([0.35, -0.5, 0.8])  #: direction to it, world frame
AMBIENT = 0.35
THUMBNAIL = 256  #: side of `draw_look`, pixels
DIRECTION = np.array([1.3, -2.2, 1.35]) / np.linalg.norm([1.3, -2.2, 1.35])  #: from an object to its camera
_LAMP = np.array([-0.4, 0.6, 1.0]) / np.linalg.norm([-0.4, 0.6, 1.0])  # right, up, towards the camera
_FIELD = 20.0  # vertical field of view, degrees
_SAMPLES = 3  # rays along each side of a pixel
_GREY = 0.7  # of what has no texture, sRGB
DEFAULT_COLOUR = np.array([0.5, 0.5, 0.5, 1], np.float32)  #: of a geom without a colour of its own, in MuJoCo


def view_frame(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the orientation (3, 3) of a camera at ``eye`` that looks at ``target``, z up.

    Columns are image right, image up and backwards, world frame, as ``cam_xmat`` of MuJoCo.
    """
    forward = np.subtract(target, eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), -forward], 1)


def view_rays(frame: np.ndarray, fov: float, height: int, width: int) -> np.ndarray:
    """Return the directions of a camera's rays, one per pixel, row by row: (height * width, 3), of length 1.

    ``frame`` is as of `view_frame`; ``fov`` is the vertical field of view, degrees.
    """
    right, up, back = np.asarray(frame, np.float64).T
    step = 2 * np.tan(np.radians(fov) / 2) / height  # of a pixel, at distance 1
    y, x = step * ((height - 1) / 2 - np.arange(height)), step * (np.arange(width) - (width - 1) / 2)
    rays = -back + y[:, None, None] * up + x[None, :, None] * right
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return rays.reshape(-1, 3)


def draw_model(
    model: mujoco.MjModel, data: mujoco.MjData, eye: np.ndarray, rays: np.ndarray, height: int, width: int
) -> np.ndarray:
    """Draw geoms in their colours under one light; (height, width, 3) uint8.

    ``data`` has current positions (``mj_forward``); ``eye`` is in the world frame, m; `view_rays` makes rays.
    """
    geom, _, normal = cast_rays(model, data, eye, rays)
    hit = geom >= 0
    lit = AMBIENT + (1 - AMBIENT) * np.clip(normal[hit] @ LIGHT, 0, 1)
    colours = np.full((len(rays), 3), SKY)
    colours[hit] = geom_colours(model)[geom[hit]] * lit[:, None]
    return np.rint(255 * colours).astype(np.uint8).reshape(height, width, 3)


def cast_rays(
    model: mujoco.MjModel, data: mujoco.MjData, eye: np.ndarray, rays: np.ndarray, groups: Any = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the geoms that rays (N, 3) meet, -1 for none, the distances, m, and the normals (N, 3).

    ``groups`` are six flags, uint8, of the groups of geoms that are seen; default: all.
    """
    count = len(rays)
    geom, distance, normal = np.zeros(count, np.int32), np.zeros(count), np.zeros(3 * count)
    directions, start = np.ascontiguousarray(rays).ravel(), np.asarray(eye, float)
    far = mujoco.mjMAXVAL
    mujoco.mj_multiRay(model, data, start, directions, groups, True, -1, geom, distance, normal, count, far)
    return geom, distance, normal.reshape(-1, 3)


def geom_colours(model: mujoco.MjModel) -> np.ndarray:
    """Return the colours of geoms, (G, 3): their own, or that of their material where they have none."""
    colours = model.geom_rgba[:, :3].copy()
    materials = (model.geom_matid >= 0) & (model.geom_rgba == DEFAULT_COLOUR).all(1)
    colours[materials] = model.mat_rgba[model.geom_matid[materials], :3]
    return colours


def draw_look(look: trimesh.Trimesh, side: int = THUMBNAIL) -> np.ndarray:
    """Draw a textured mesh, such as `objectfolder.sim.visual.visual_mesh` returns; (side, side, 3) uint8.

    It is seen from obliquely above, before white, under one light.
    """
    texture = getattr(getattr(look.visual, "material", None), "image", None)
    caster = RayCaster(look.vertices, look.faces)
    centre, radius = look.bounds.mean(0), np.linalg.norm(look.extents) / 2
    eye = centre + DIRECTION * radius / np.sin(np.radians(_FIELD) / 2)
    frame = view_frame(eye, centre)
    count = side * _SAMPLES
    rays = view_rays(frame, _FIELD, count, count)
    hit, _, face, weights = caster.intersect(eye, rays)
    corners = look.faces[face]
    normals = np.einsum("nk,nkd->nd", weights, look.vertex_normals[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-9)[:, None]
    colours = np.full((len(hit), 3), _GREY)
    if texture is not None:
        texels = np.asarray(texture.convert("RGB"))
        uv = np.asarray(getattr(look.visual, "uv", None))  # a textured mesh has them
        places = np.einsum("nk,nkd->nd", weights, uv[corners]) * [1, -1] + [0, 1]
        column, row = (places % 1 * texels.shape[1::-1]).astype(int).T
        colours = texels[row.clip(0, len(texels) - 1), column.clip(0, texels.shape[1] - 1)] / 255
    lit = AMBIENT + (1 - AMBIENT) * np.clip(normals @ (frame @ _LAMP), 0, 1)
    image = np.ones((count * count, 3))
    image[hit] = encode(decode(colours) * lit[:, None])
    image = image.reshape(side, _SAMPLES, side, _SAMPLES, 3).mean((1, 3))
    return np.rint(255 * image).astype(np.uint8)
