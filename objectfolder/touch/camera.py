"""The sensor's pinhole camera and the undeformed gel that it sees."""

from functools import lru_cache

import numpy as np

from objectfolder.touch.profiles import SensorProfile


def ray_directions(profile: SensorProfile) -> np.ndarray:
    """Return the directions of the pixel rays; (H, W, 3), camera frame, float64.

    Every x is 1, so that distance along a ray is depth along the optical axis. Row 0 is the top of the
    image (+z), column 0 its left (+y).
    """
    vertical, horizontal = profile.half_extent
    z = (1 - (np.arange(profile.height) + 0.5) * 2 / profile.height) * vertical
    y = (1 - (np.arange(profile.width) + 0.5) * 2 / profile.width) * horizontal
    return np.stack([np.ones((profile.height, profile.width)), *np.broadcast_arrays(y, z[:, None])], axis=-1)


def gel_sag(profile: SensorProfile, radius: np.ndarray) -> np.ndarray:
    """How far the undeformed gel recedes from its apex at a distance from the optical axis, metres."""
    dome = profile.gel_dome_radius
    return profile.gel_curvature * dome * (dome - np.sqrt(dome**2 - radius**2))


def gel_depth(profile: SensorProfile, directions: np.ndarray | None = None) -> np.ndarray:
    """Return the depth of the undeformed gel along rays with x = 1, metres; by default of the pixels, (H, W).

    The surface is the cap of a spheroid about the optical axis, as TACTO models its gels (Wang et al. 2022):
    x = g - κ R (R - sqrt(R² - y² - z²)), with g = `camera_to_gel`, κ = `gel_curvature` at the apex and R =
    `gel_dome_radius`; κ R = 1 is a sphere, κ = 0 a plane. On the ray t (1, a, b) the sag g - t is the smaller
    root of a quadratic equation, in a form that also holds for a plane.
    """
    directions = ray_directions(profile) if directions is None else directions
    slope = directions[..., 1] ** 2 + directions[..., 2] ** 2
    apex, radius = profile.camera_to_gel, profile.gel_dome_radius
    stretch = profile.gel_curvature * radius
    root = np.sqrt(radius**2 + (2 * radius * stretch - apex) * apex * slope)
    return apex - stretch * slope * apex**2 / (radius + stretch * slope * apex + root)


def gel_normals(displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
    """Return unit normals of the deformed gel, towards the camera; (N, H, W, 3) float32, camera frame.

    Displacements (N, H, W) are metres towards the camera along the pixel rays.
    """
    _, y, z = np.moveaxis(ray_directions(profile).astype(np.float32), -1, 0)
    depth = gel_depth(profile).astype(np.float32) - np.asarray(displacement, np.float32)
    pitch = [-2 * half / n for half, n in zip(profile.half_extent, (profile.height, profile.width))]
    along_z, along_y = np.gradient(depth, *pitch, axis=(1, 2))
    # Normal of the surface depth(y, z) * (1, y, z), where y and z are the slopes of the rays.
    normals = np.stack([-(depth + y * along_y + z * along_z), along_y, along_z], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals.astype(np.float32)


@lru_cache(maxsize=64)
def pixel_area(profile: SensorProfile) -> np.ndarray:
    """Return the area of undeformed gel per pixel, projected along the optical axis; (H, W), m², float64.

    The array is cached and read-only.
    """
    directions, depth = ray_directions(profile), gel_depth(profile)
    vertical, horizontal = profile.half_extent
    pitch = 2 * vertical / profile.height, 2 * horizontal / profile.width
    (y_row, y_column), (z_row, z_column) = (
        np.gradient(directions[..., axis] * depth, *pitch) for axis in (1, 2)
    )
    area = np.abs(y_row * z_column - y_column * z_row) * pitch[0] * pitch[1]
    area.setflags(write=False)
    return area
