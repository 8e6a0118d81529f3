"""External camera: the Object File's rendering before a ray-cast table and gripper, without OpenGL."""

import numpy as np
import torch

from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import rotation
from objectfolder.sim.gripper import boxes, hand_axes
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.vision.color import on_white

CAMERA = np.array([0.34, -0.42, 0.30])  #: position of the camera, world frame, m
TARGET = np.array([0.0, 0.0, 0.05])  #: point at the image centre
FIELD = 0.34  #: width of the field of view at that distance, m
TOWARDS_LIGHT = np.array([0.5, -0.4, 0.77])  #: unit vector, world frame
AMBIENT = 0.25
TABLE = (0.45, 0.47, 0.5)  #: linear RGB


class ExternalCamera:
    """A fixed camera beside the table; its pictures are squares of ``resolution`` pixels a side."""

    def __init__(self, resolution: int):
        distance = float(np.linalg.norm(CAMERA - TARGET))
        self.intrinsics = Intrinsics(resolution, resolution, resolution * distance / FIELD)
        self.pose = look_at(CAMERA[None], TARGET)[0]
        middle = np.arange(resolution) + 0.5 - resolution / 2
        x, y = np.meshgrid(middle, -middle)
        rays = np.stack([x, y, np.full_like(x, -self.intrinsics.focal)], -1) / self.intrinsics.focal
        #: directions of pixels, world frame, of length 1 along the optical axis; (H W, 3)
        self._rays = rays.reshape(-1, 3) @ self.pose[:3, :3].T

    def picture(self, file: ObjectFile, place: np.ndarray, hand: np.ndarray, width: float) -> np.ndarray:
        """Draw the object, the table and the gripper; (H, W, 3) uint8, sRGB.

        Takes position and quaternion of the object (7,), the pose of the gripper (4,), world frame, and the
        opening of its jaws, m.
        """
        world = rotation(place[3:])
        camera = np.eye(4)
        camera[:3, :3] = world.T @ self.pose[:3, :3]
        camera[:3, 3] = world.T @ (CAMERA - place[:3]) / file.scale
        light = world.T @ TOWARDS_LIGHT
        seen = file.render(camera[None], light[None], intrinsics=self.intrinsics)
        color, depth = self._scene(hand, width)
        side = self.intrinsics.width
        behind = np.concatenate([color, np.isfinite(depth)[:, None]], 1).reshape(side, side, 4)
        front = (seen.depth[0] < depth.reshape(side, side))[..., None]
        rgba = np.where(front, seen.rgba[0] + (1 - seen.rgba[0, ..., 3:]) * behind, behind)
        shown = on_white(torch.from_numpy(rgba.astype(np.float32)))
        return np.round(shown.numpy() * 255).astype(np.uint8)

    def _scene(self, hand: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
        """Render table and gripper: colours (P, 3) and depths (P,)."""
        with np.errstate(divide="ignore"):
            depth = -CAMERA[2] / self._rays[:, 2]
        depth = np.where(depth > 0, depth, np.inf)
        lit = AMBIENT + (1 - AMBIENT) * TOWARDS_LIGHT[2]
        color = np.where(np.isfinite(depth)[:, None], lit * np.array(TABLE), 0.0)
        axes = hand_axes(hand[None])[0]
        origin, rays, light = (v @ axes for v in (CAMERA - hand[:3], self._rays, TOWARDS_LIGHT))
        for box in boxes():
            center = box.center + np.array([box.jaw * width / 2, 0.0, 0.0])
            distance, normals = box_hits(origin - center, rays, box.size)
            nearer = distance < depth
            shade = AMBIENT + (1 - AMBIENT) * np.maximum(normals[nearer] @ light, 0)
            color[nearer], depth[nearer] = shade[:, None] * np.array(box.color), distance[nearer]
        return color, depth


def box_hits(origin: np.ndarray, rays: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Intersect rays (P, 3) with a box of half sides (3,) at the origin, by the slab method.

    The rays' origin (3,) is outside the box. Returns distances (P,) in lengths of the rays, infinite for
    misses, and normals (P, 3) of the sides that the rays enter.
    """
    sign = np.where(rays < 0, -1.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = ((-sign * size * side - origin) / rays for side in (1, -1))
    near, far = np.nan_to_num(near, nan=-np.inf), np.nan_to_num(far, nan=np.inf)
    entry, side = near.max(1), near.argmax(1)
    hit = (entry <= far.min(1)) & (entry > 0)
    normals = np.zeros_like(rays)
    index = np.arange(len(rays))
    normals[index, side] = -sign[index, side]
    return np.where(hit, entry, np.inf), normals
