"""Close views: what a camera sees of the spot that a tactile sensor covers."""

import numpy as np

from objectfolder.objectfile.file import ObjectFile
from objectfolder.touch.contact import sensor_frames
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.environment import gather_lamps
from objectfolder.vision.lighting import DistantLight
from objectfolder.vision.query import LitCameras, view_images

FARTHEST = 0.1  #: of the camera from the point, metres
CLEAR = 0.9  #: of the way along the contact normal to the next surface, at most
SLANT = (0.7, 0.5)  #: of the light, up and to the left in the view, relative to the normal
LIFT = 1e-3  #: unit frame, above the surface, where free ways are measured from


def camera_distances(file: ObjectFile, points: np.ndarray) -> np.ndarray:
    """Return how far from points (N, 3) a camera has room along the normal, at most `FARTHEST`; metres."""
    place = (points / file.scale).astype(np.float32)
    normals = file.contact_normals(points).astype(np.float32)
    free, _ = file.surface.caster.first_hit(place + LIFT * normals, normals)
    return np.minimum(CLEAR * file.scale * free.astype(np.float64), FARTHEST)


def close_views(
    file: ObjectFile,
    points: np.ndarray,
    distances: np.ndarray,
    size: tuple[int, int],
    angles: float | np.ndarray = 0.0,
) -> np.ndarray:
    """Look at points (N, 3), from distances (N,) along their contact normals, at what the sensor covers.

    Both are in metres; angles (N,) are those of the sensor, radians. Returns (N, H, W, 3) uint8; the size is
    (H, W).
    """
    profile = file.sensor_profile
    place = (points / file.scale).astype(np.float32)
    frames = sensor_frames(file.contact_normals(points), np.broadcast_to(angles, len(points)))
    inward, left, up = np.moveaxis(frames, 2, 0)
    poses = np.tile(np.eye(4), (len(points), 1, 1))
    poses[:, :3, :3] = np.stack([-left, up, -inward], 2)
    poses[:, :3, 3] = place - (distances / file.scale)[:, None] * inward
    lights = -inward + SLANT[0] * up + SLANT[1] * left
    # Half the height and half the width that the gel covers, metres.
    tall, wide = np.multiply(profile.half_extent, profile.camera_to_gel)
    height, width = size
    drawer, views = file.vision_sense.drawer(False), []
    for pose, light, distance in zip(poses, lights, distances, strict=True):
        focal_x, focal_y = width / 2 * distance / wide, height / 2 * distance / tall
        lens = Intrinsics(width, height, focal_x, focal_y=focal_y)
        cameras = LitCameras.checked(pose, None, gather_lamps([DistantLight(light)], None), lens)
        views.append(view_images(drawer, cameras)[0])  # `view` warns of cameras that are so near
    return np.round(np.stack(views) * 255).astype(np.uint8)
