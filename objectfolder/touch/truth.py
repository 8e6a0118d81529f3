"""Ground-truth touches of an object: contacts on its exact surface."""

from collections.abc import Callable, Iterable
from typing import Any

import igl
import numpy as np
import torch

from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.sampling import sample_surface, split_rows
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, require_renderer
from objectfolder.touch.settings import RenderTouchConfig
from objectfolder.touch.simulate import press, touch_images
from objectfolder.touch.tacto_rays import TactoRays

_BATCH = 16
_MEASURED = ("obstructed", "max_penetration", "area", "force")


def draw_contacts(
    vertices: np.ndarray, faces: np.ndarray, config: RenderTouchConfig, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray | None]]:
    """Draw the contact points of the three splits, and their normals if those are the mesh's.

    Takes vertices (V, 3), unit frame, and faces (F, 3), and returns points (N, 3) and unit vectors (N, 3), or
    None, of each split. Vertices are split 80/10/10.
    """
    counts = (config.train, config.val, config.test)
    if config.locations == "vertices":
        split = split_rows(len(vertices), rng)
        # In random order, so that the first few are anywhere.
        rows = [rng.permutation(np.flatnonzero(split == index))[:count] for index, count in enumerate(counts)]
        if config.normals == "contact":
            return [(vertices[chosen], None) for chosen in rows]
        weights = igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_AREA
        mesh = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int64)
        normals = np.asarray(igl.per_vertex_normals(*mesh, weights), np.float64)
        return [(vertices[chosen], normals[chosen]) for chosen in rows]
    sizes = [count or 0 for count in counts]
    points = sample_surface(vertices, faces, sum(sizes), rng)
    return [(part, None) for part in np.split(points, np.cumsum(sizes)[:-1])]


def render_contacts(
    vertices: np.ndarray,
    faces: np.ndarray,
    scale: float,
    points: np.ndarray,
    profile: SensorProfile,
    rng: np.random.Generator,
    renderer: str = "gel",
    depth: float | None = None,
    angle: float | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
    normals: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Press the sensor at points (N, 3) of a closed surface, unit frame; the arrays of ``touch/SPLIT.npz``.

    Rendered is the deformed gel ("gel"), or as TACTO does (`TactoRays`) the object in front of the gel
    ("tacto"). The longest side, ``scale``, and the depth of all contacts are in metres, the angle in radians;
    by default they are uniformly random, in the sensor's range of press depths and over the full circle. The
    sensor comes along unit normals (N, 3), by default those of `objectfolder.touch.contact.contact_normals`.
    ``progress`` wraps the iteration over batches.

    ``images`` (N, H, W, 3) uint8; ``masks`` (N, H, W) bool, where gel and object touch; ``points`` (N, 3) and
    ``depths`` (N,) in metres, ``normals`` (N, 3) and ``angles`` (N,) in radians, object frame; ``obstructed``
    (N,) fraction of the image, ``max_penetration`` (N,) in metres, ``area`` (N,) in m² and ``force`` (N,) in
    newtons, NaN for a rigid gel; see `objectfolder.touch.simulate.Contacts`.
    """
    vertices, faces = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int64)

    def distance(p: np.ndarray) -> np.ndarray:
        # The sign by winding numbers is four times faster than by pseudonormals.
        side = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
        return igl.signed_distance(np.ascontiguousarray(p), vertices, faces, side)[0]

    require_renderer(profile, renderer)
    if normals is None:
        normals = contact_normals(distance, points, NORMAL_RADIUS)
    low, high = profile.press_depth
    depths, angles = rng.uniform(low, high, len(points)), rng.uniform(0, 2 * np.pi, len(points))
    if depth is not None:
        depths[:] = depth
    if angle is not None:
        angles[:] = angle
    caster, optics = RayCaster(vertices, faces), Optics(profile)
    rays = TactoRays(vertices, faces, profile, scale) if renderer == "tacto" else None
    noise = torch.Generator().manual_seed(int(rng.integers(2**63)))
    images = np.empty((len(points), profile.height, profile.width, 3), np.uint8)
    masks = np.empty(images.shape[:3], bool)
    measured = {name: np.empty(len(points)) for name in _MEASURED}
    for start in progress(range(0, len(points), _BATCH)):
        part = slice(start, start + _BATCH)
        contact = points[part] * scale, normals[part], angles[part], depths[part]
        if rays is None:
            clean, contacts = touch_images(caster, *contact, profile, optics, scale)
        else:
            clean, contacts = rays.render(*contact)[0], press(caster, *contact, profile, scale)
        for name, values in measured.items():
            values[part] = getattr(contacts, name)
        masks[part] = contacts.mask
        images[part] = optics.noise(torch.from_numpy(clean), noise).numpy()
    pose = {"points": points * scale, "normals": normals, "depths": depths, "angles": angles}
    return {"images": images, "masks": masks} | pose | measured
