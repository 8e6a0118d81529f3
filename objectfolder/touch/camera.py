"""The sensor's pinhole camera and the undeformed gel that it sees."""

import numpy as np

from objectfolder.touch.profiles import SensorProfile


def ray_directions(profile: SensorProfile) -> np.ndarray:
    """Directions of the pixel rays; (H, W, 3), camera frame, float64.

    Every x is 1, so that a distance along a ray is a depth along the optical axis. Row 0 is the top of the
    image (+z), column 0 its left (+y).
    """
    vertical, horizontal = profile.half_extent
    z = (1 - (np.arange(profile.height) + 0.5) * 2 / profile.height) * vertical
    y = (1 - (np.arange(profile.width) + 0.5) * 2 / profile.width) * horizontal
    return np.stack([np.ones((profile.height, profile.width)), *np.broadcast_arrays(y, z[:, None])], axis=-1)


def gel_depth(profile: SensorProfile) -> np.ndarray:
    """Depth of the undeformed gel surface along each pixel ray; (H, W), metres, float64.

    The surface is x = g - κ (y² + z²) / 2, with g = `camera_to_gel` and κ = `gel_curvature`. On the ray
    t (1, a, b) this is a quadratic equation in t.
    """
    directions = ray_directions(profile)
    slope = directions[..., 1] ** 2 + directions[..., 2] ** 2
    root = np.sqrt(1 + 2 * profile.gel_curvature * slope * profile.camera_to_gel)
    return 2 * profile.camera_to_gel / (1 + root)
