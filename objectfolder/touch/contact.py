"""Geometry of a contact: normal, pose of the sensor, and heightmap of the object in the gel."""

from collections.abc import Callable
from functools import cache, lru_cache

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.raycast import RayCaster
from objectfolder.touch.arrays import Array, array_library
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.gel import GAP
from objectfolder.touch.profiles import SensorProfile

#: Up direction of the image at angle 0. It is perpendicular to no face of a usual object.
UP = np.array([1.0, 2.0, 4.0]) / np.sqrt(21.0)

#: Radius of `contact_normals` in the unit frame: two voxels of a 192^3 distance grid, inside its narrow band.
NORMAL_RADIUS = 0.01

#: A contact is free if material past the base reaches less far than this, as a fraction of the thickness; a
#: retreat along the normal turns perspective rays a little.
FREE_OVERLAP = 0.05

#: Directions along which no usual mesh has an edge; three, because one ray can still graze an edge.
PROBES = np.array([[0.7561, 0.3217, -0.5700], [-0.4129, 0.8836, 0.2205], [-0.2917, -0.6353, 0.7150]])


_POINT_BATCH = 256  # points whose surroundings are looked at together, to bound memory


@cache
def probe_directions(count: int = 64) -> np.ndarray:
    """Return an even number of quasi-uniform unit directions; (count, 3), with Σ u uᵀ = count/3 · I.

    A Fibonacci half sphere and its mirror image, balanced to a tight frame. The symmetry under u -> -u
    cancels even functions; the tight frame makes linear functions exact.
    """
    k = np.arange(count // 2)
    height = (k + 0.5) / len(k)
    azimuth = k * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    u = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), height], axis=1)
    for _ in range(30):  # converges to rounding
        values, vectors = np.linalg.eigh(u.T @ u)
        u = u @ (vectors / np.sqrt(values)) @ vectors.T
        u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.concatenate([u, -u])


def contact_normals(distance: Callable[[Array], Array], points: Array, radius: float) -> Array:
    """Return outward contact normals from the signed distance around points; (N, 3) float64 unit vectors.

    n ∝ Σ_k d(p + r u_k) u_k over the fixed directions of `probe_directions`: the gradient of the distance,
    averaged over a sphere. This *defines* the contact normal. Unlike face and vertex normals, it does not
    depend on the triangulation at edges and corners. It is the same for an exact distance and for one sampled
    on a grid, so that ground truth and query agree. It is exact on planes; on curved surfaces and edges the
    64 directions limit its accuracy to about a degree.

    The distance (M, 3) -> (M,) is negative inside; points (N, 3) and the radius of the sphere, the smallest
    feature that affects the normal, are in its units. Points may be a float64 tensor, through which gradients
    flow. Raises ObjectFolderError if the distance has no gradient around a point.
    """
    u: Array = probe_directions()
    if isinstance(points, torch.Tensor):
        u = torch.from_numpy(u)
    else:
        points = np.asarray(points, np.float64)
    points = points.reshape(-1, 3)
    gradients = []
    for start in range(0, max(len(points), 1), _POINT_BATCH):
        samples = points[start : start + _POINT_BATCH, None] + radius * u
        d = distance(samples.reshape(-1, 3)).reshape(len(samples), len(u))
        # Sum in a fixed order; that of a matrix product depends on the number of points.
        gradients.append((d[..., None] * u).sum(axis=1))
    library = array_library(gradients[0])
    gradient = library.concatenate(gradients)
    length = library.sqrt((gradient * gradient).sum(axis=1))
    lost = np.flatnonzero(~np.asarray(length > 1e-9 * radius))
    if lost.size:
        raise ObjectFolderError(
            f"no contact normal at {points[lost[0]]} ({lost.size} of {len(points)} points): the surface "
            f"faces opposite ways alike within {radius:g} of it; press elsewhere, or use a smaller radius"
        )
    return gradient / length[:, None]


def sensor_frames(normals: Array, angles: Array) -> Array:
    """Return the axes x, y, z of the sensor in the object frame, in columns; (N, 3, 3) float64.

    x = -n points into the object; z, up in the image, is the fixed direction `UP` projected onto the tangent
    plane, then turned by the angle about the outward normal (right-hand rule: anticlockwise, seen from
    outside). Continuous in the normal except at n = ±`UP`. Unit normals (N, 3) and angles (N,), radians, are
    both arrays or both tensors, through which gradients flow.
    """
    library = array_library(normals)
    as_array = torch.as_tensor if library is torch else np.asarray
    given = normals, angles, UP, np.array([0.0, 1.0, 0.0])
    n: Array
    on = {"device": normals.device} if library is torch else {}
    n, angles, up, side = (as_array(v, dtype=library.float64, **on) for v in given)
    n = n.reshape(-1, 3)
    angles = library.broadcast_to(angles, (len(n),))
    z = up - (n * up).sum(axis=1, keepdims=True) * n
    # Where the projection vanishes, any fixed direction that is not parallel will do.
    other = side - n[:, 1:2] * n
    z = library.where(_length(z) > 1e-9, z, other)
    z = z / _length(z)
    y = library.linalg.cross(n, z)
    cos, sin = library.cos(angles)[:, None], library.sin(angles)[:, None]
    return library.stack([-n, cos * y - sin * z, cos * z + sin * y], 2)


def lean_normals(normals: Array, angles: Array, tilt: Array, azimuth: Array) -> Array:
    """Return the outward axes of sensors that lean from the contact normals; (N, 3).

    Unit normals (N, 3) and angles (N,) are those of `sensor_frames`; the lean is by ``tilt`` (N,), in a
    direction `azimuth` (N,) from image up towards image right; radians, arrays or tensors.
    """
    library, frames = array_library(normals), sensor_frames(normals, angles)
    up, right = library.cos(azimuth)[:, None], library.sin(azimuth)[:, None]
    direction = up * frames[:, :, 2] - right * frames[:, :, 1]
    return library.cos(tilt)[:, None] * normals + library.sin(tilt)[:, None] * direction


def _length(vectors: Array) -> Array:
    return array_library(vectors).sqrt((vectors * vectors).sum(axis=1, keepdims=True))


def heightmaps(
    caster: RayCaster,
    points: np.ndarray,
    normals: np.ndarray,
    angles: np.ndarray,
    depths: np.ndarray,
    profile: SensorProfile,
    scale: float = 1.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far an object is past the undeformed gel along the camera's rays, and what it obstructs.

    The gel's apex is pressed ``depth`` beyond the contact point, along -n. Heights are those of the first
    surface beyond the elastomer's rigid base, `elastomer_thickness` behind the gel's surface. A real sensor
    would collide with material on the camera's side of the base; such pixels are reported as obstructed.
    Material wholly on that side, such as the opposite wall of a cup, is ignored otherwise. Material across
    the base meets the sensor's body before the gel is pressed in: the sensor stops short, by as much as it
    reaches past the base. Where no retreat along n frees the sensor, the gel is not touched at all.

    Points (N, 3), metres, unit outward normals (N, 3), angles (N,), radians, see `sensor_frames`, and press
    depths (N,), metres from 0 to `max_indentation`, are of the object frame; ``scale`` is metres per unit of
    the caster, a closed surface with triangles anticlockwise from outside. Heights (N, H, W) float32, metres,
    go from -`objectfolder.touch.gel.GAP` times `elastomer_thickness`, also for any wider gap, to
    `max_indentation`. Obstructed (N,) is the fraction of the pixels with material nearer to the camera than
    the base, in the pose asked for. The last, (N,), is how far each sensor stops short of that pose, metres.
    Raises ObjectFolderError if a value is not finite, or a depth out of its range.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    normals = np.asarray(normals, np.float64).reshape(-1, 3)
    angles = np.broadcast_to(np.asarray(angles, np.float64), len(points))
    depths = np.broadcast_to(np.asarray(depths, np.float64), len(points))
    _check_contacts(points, normals, angles, depths, profile)
    return framed_heightmaps(caster, points, sensor_frames(normals, angles), depths, profile, scale)


def framed_heightmaps(
    caster: RayCaster,
    points: np.ndarray,
    frames: np.ndarray,
    depths: np.ndarray,
    profile: SensorProfile,
    scale: float = 1.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what `heightmaps` does, of sensors with the axes of `sensor_frames`; nothing is checked."""
    normals = -frames[:, :, 0]
    cameras = ((points + normals * (profile.camera_to_gel - depths)[:, None]) / scale).astype(np.float32)
    rays, gel = _pixels(profile, scale)
    gap = np.float32(GAP * profile.elastomer_thickness)
    limit, base = gel + gap, gel - np.float32(profile.elastomer_thickness)
    enclosed = _enclosed(caster, cameras)

    height = np.empty((len(points), profile.height, profile.width), np.float32)
    obstructed, retreat = np.empty(len(points)), np.zeros(len(points))
    for i, (frame, camera) in enumerate(zip(frames, cameras)):  # one image at a time bounds the memory
        directions, inside = rays @ frame.T.astype(np.float32), bool(enclosed[i])
        distance, blocked, overlap = _first_surface(caster, camera, directions, base, limit, inside)
        obstructed[i] = blocked / len(rays)
        if 0 < overlap < profile.camera_to_gel:
            retreat[i] = overlap
            camera = camera + (normals[i] * (overlap / scale)).astype(np.float32)
            inside = bool(_enclosed(caster, camera[None])[0])
            distance, _, overlap = _first_surface(caster, camera, directions, base, limit, inside)
        if overlap > FREE_OVERLAP * profile.elastomer_thickness:
            distance = limit
        (gel - distance).clip(-gap, profile.max_indentation, out=height[i].reshape(-1))
    return height, obstructed, retreat


def _first_surface(
    caster: RayCaster,
    camera: np.ndarray,
    directions: np.ndarray,
    base: np.ndarray,
    limit: np.ndarray,
    enclosed: bool,
) -> tuple[np.ndarray, int, float]:
    """Return the depths (M,) of the first surface beyond the base, and how the object blocks the sensor.

    The last two are the number of blocked pixels, and how far material across the base reaches past it
    towards the camera, metres.
    """
    if enclosed:
        blocked, distance = np.arange(len(directions)), np.empty_like(base)
    else:
        distance = caster.depths(camera, directions, limit)
        blocked = np.flatnonzero(distance < base)
    if not blocked.size:
        return distance, 0, 0.0
    begin, onward = base[blocked], directions[blocked]
    start = camera + begin[:, None] * onward
    rest, across = caster.first_crossing(start, onward)
    distance[blocked] = np.where(across, 0, begin + rest)
    if not across.any():
        return distance, blocked.size, 0.0
    back, _ = caster.first_crossing(start[across], -onward[across])
    return distance, blocked.size, float(back.max())


@lru_cache(maxsize=16)  # of sensors and objects
def _pixels(profile: SensorProfile, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays (M, 3) of the pixels, scaled so that distance is depth in metres, and gel depths (M,).

    Float32; directions in caster units, camera frame.
    """
    rays = (ray_directions(profile).reshape(-1, 3) / scale).astype(np.float32)
    return rays, gel_depth(profile).ravel().astype(np.float32)


def _check_contacts(
    points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray, profile: SensorProfile
) -> None:
    for name, array in {"point": points, "normal": normals, "angle": angles[:, None]}.items():
        rows = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if rows.size:
            given = f"contact {rows[0]}: {name} {array[rows[0]].tolist()}"
            raise ObjectFolderError(f"{given} must be finite ({rows.size} of {len(array)} are not)")
    rows = np.flatnonzero(~((depths >= 0) & (depths <= profile.max_indentation)))
    if rows.size:
        raise ObjectFolderError(
            f"contact {rows[0]}: press depth {depths[rows[0]]:g} m must be from 0 to "
            f"{profile.max_indentation:g} m, the maximal indentation of sensor {profile.name!r}"
        )


def _enclosed(caster: RayCaster, points: np.ndarray) -> np.ndarray:
    """Return whether the closed surface encloses points (N, 3) in caster units, by majority of three rays."""
    directions = np.tile(PROBES, (len(points), 1))
    _, leaving = caster.first_crossing(points.repeat(len(PROBES), axis=0), directions)
    return leaving.reshape(-1, len(PROBES)).sum(axis=1) >= 2
