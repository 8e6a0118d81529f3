"""Slide a tactile sensor over an object: poses on the surface, motions, and what is felt and seen there.

`REFINE` and `TRAVERSE` are the contact refinement and the surface traversal of the ObjectFolder Benchmark
(Gao et al., CVPR 2023): from a start, the sensor slides to a goal of which it knows the reading alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, radians

import numpy as np
import torch
from torch.nn.functional import adaptive_avg_pool2d

from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.close_views import camera_distances, close_views
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.fingers import require_pads, sensor_angles

DEPTH = 0.001  #: of all presses, m
STEPS = 15  #: of an episode, at most
CLOSEST = 0.001  #: of the camera to a contact, m
CHUNK = 32  #: contacts pressed at once
SENSES = ("touch", "vision")  #: of which an observation may consist


@dataclass(frozen=True)
class Slide:
    """A way to a goal; lengths in metres, angles in radians."""

    name: str
    distance: tuple[float, float]  #: of starts from their goals, along the surface
    turn: float  #: of starts from their goals about the contact normal, at most
    near: float  #: distance at which a goal is reached
    turned: float  #: angle at which it is reached
    step: float  #: greatest motion along an axis of the image in a step
    step_turn: float  #: greatest turn in a step

    @property
    def steps(self) -> np.ndarray:
        """(3,) greatest motion in a step: right and up in the image, and the turn."""
        return np.array([self.step, self.step, self.step_turn])


#: Contact refinement.
REFINE = Slide("refine", (0.0, 0.003), radians(15), 0.0005, radians(1), 0.001, radians(5))
#: Surface traversal.
TRAVERSE = Slide("traverse", (0.005, 0.015), 0.0, 0.001, np.inf, 0.002, radians(5))
SLIDES = {slide.name: slide for slide in (REFINE, TRAVERSE)}


@dataclass(frozen=True)
class Poses:
    """Poses of a sensor that touches an object without a tilt; object frame."""

    points: np.ndarray  #: (N, 3) contact points, m
    normals: np.ndarray  #: (N, 3) outward unit vectors
    up: np.ndarray  #: (N, 3) unit vectors, up in the image

    @property
    def right(self) -> np.ndarray:
        """(N, 3) unit vectors, right in the view from outside."""
        return np.cross(self.up, self.normals)

    @property
    def angles(self) -> np.ndarray:
        """(N,) rotations about the outward normals as `ObjectFile.touch` takes them, radians."""
        return sensor_angles(self.normals, self.normals, self.up)[0]

    def take(self, rows: np.ndarray) -> "Poses":
        """Select rows."""
        return Poses(self.points[rows], self.normals[rows], self.up[rows])

    def put(self, rows: np.ndarray, others: "Poses") -> "Poses":
        """Replace rows."""
        parts = [np.array(part) for part in (self.points, self.normals, self.up)]
        for part, other in zip(parts, (others.points, others.normals, others.up), strict=True):
            part[rows] = other
        return Poses(*parts)


def transported(vectors: np.ndarray, normals: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Turn tangent vectors (N, 3) as the least rotation turns their normals into others; unit length."""
    share = (vectors * others).sum(1) / np.maximum(1 + (normals * others).sum(1), 1e-6)
    moved = vectors - share[:, None] * (normals + others)
    moved -= (moved * others).sum(1, keepdims=True) * others  # of opposite normals
    return moved / np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), 1e-12)


def random_poses(file: ObjectFile, count: int, rng: np.random.Generator) -> Poses:
    """Draw contacts, uniform by area, with the sensor turned at random."""
    points = file.nearest(file.sample_surface(count, rng))[0]
    normals, drawn = file.contact_normals(points), rng.normal(size=(count, 3))
    up = np.cross(normals, drawn)
    return Poses(points, normals, up / np.linalg.norm(up, axis=1, keepdims=True))


def moved(file: ObjectFile, poses: Poses, motions: np.ndarray) -> Poses:
    """Slide sensors by motions (N, 3): right and up in the view from outside, m, then a turn, radians.

    They go along the tangent plane, then to the nearest point of the surface. A turn is about the outward
    normal, anticlockwise seen from outside.
    """
    points = poses.points + motions[:, :1] * poses.right + motions[:, 1:2] * poses.up
    points = file.nearest(points)[0]
    normals = file.contact_normals(points)
    up = transported(poses.up, poses.normals, normals)
    cos, sin = np.cos(motions[:, 2:]), np.sin(motions[:, 2:])
    return Poses(points, normals, cos * up + sin * np.cross(normals, up))


def offsets(poses: Poses, goals: Poses) -> np.ndarray:
    """Return where goals are for sensors, (N, 3): right and up, m, and the turn to them, radians.

    On a plane these are the `moved` motions that lead there.
    """
    way = goals.points - poses.points
    up = transported(goals.up, goals.normals, poses.normals)
    turn = np.arctan2(-(up * poses.right).sum(1), (up * poses.up).sum(1))
    return np.stack([(way * poses.right).sum(1), (way * poses.up).sum(1), turn], 1)


def errors(poses: Poses, goals: Poses) -> np.ndarray:
    """Return how far sensors are from their goals, (N, 2): distance, m, and angle, radians."""
    distance = np.linalg.norm(goals.points - poses.points, axis=1)
    return np.stack([distance, abs(offsets(poses, goals)[:, 2])], 1)


def limited(motions: np.ndarray, slide: Slide) -> np.ndarray:
    """Shorten motions (N, 3) to a step, in their direction; the turn on its own."""
    length = abs(motions[:, :2]).max(1, keepdims=True)
    way = motions[:, :2] * np.minimum(1, slide.step / np.maximum(length, 1e-12))
    return np.c_[way, motions[:, 2:].clip(-slide.step_turn, slide.step_turn)]


def strayed(
    file: ObjectFile, slide: Slide, goals: Poses, rng: np.random.Generator, near: bool = False
) -> Poses:
    """Slide away from goals in random directions, and turn: starts of episodes.

    ``near`` ones are at any distance down to 0, most of them close to their goals.
    """
    count = len(goals.points)
    low, high = slide.distance
    heading, share = rng.uniform(size=count), rng.uniform(size=count)
    distance, turned = (high * share**2, share**2) if near else (low + (high - low) * share, 1.0)
    parts = ceil(high / slide.step)
    motions = np.zeros((count, 3))
    motions[:, 0], motions[:, 1] = np.cos(2 * np.pi * heading), np.sin(2 * np.pi * heading)
    poses = goals
    for _ in range(parts):
        poses = moved(file, poses, motions * distance[:, None] / parts)
    turns = np.zeros((count, 3))
    turns[:, 2] = turned * rng.uniform(-slide.turn, slide.turn, count)
    return moved(file, poses, turns)


def observe(file: ObjectFile, poses: Poses, senses: Sequence[str], size: tuple[int, int]) -> np.ndarray:
    """Return what sensors feel and see, (N, H, W, 3 for each of the `SENSES`) uint8; the size is (H, W).

    ``touch`` is the tactile image, averaged to the size; ``vision`` the close view of what the gel covers,
    its camera as far away as there is room for.
    """
    found = []
    for rows in np.array_split(np.arange(len(poses.points)), -(-len(poses.points) // CHUNK)):
        some, parts = poses.take(rows), []
        if "touch" in senses:
            images = torch.from_numpy(file.touch(some.points, DEPTH, some.angles)).permute(0, 3, 1, 2)
            pooled = adaptive_avg_pool2d(images.float(), size).round().byte()
            parts.append(pooled.permute(0, 2, 3, 1).numpy())
        if "vision" in senses:
            distances = np.maximum(camera_distances(file, some.points), CLOSEST)
            parts.append(close_views(file, some.points, distances, size, some.angles))
        found.append(np.concatenate(parts, 3))
    return np.concatenate(found)


def require_sliding(file: ObjectFile, senses: Sequence[str]) -> None:
    """Raise ObjectFolderError unless a file answers what a sliding sensor feels and sees."""
    require_pads(file)
    if file.fixed_contact is not None:
        raise ObjectFolderError(
            f"{file.key}: its touch net stores a single press, which cannot slide; build the object with "
            "train_touch.net: geometric"
        )
    if "vision" in senses and "vision" not in file.header:
        raise ObjectFolderError(f"{file.key}: the Object File holds no vision; leave vision out, or build it")


#: Takes the number of a step, rows (n,) of the sensors that go on, and their poses; returns motions (n, 3).
Policy = Callable[[int, np.ndarray, Poses], np.ndarray]


def follow_policy(
    file: ObjectFile, slide: Slide, starts: Poses, goals: Poses, policy: Policy
) -> tuple[Poses, np.ndarray, list[Poses]]:
    """Slide sensors by a policy until they reach their goals, for `STEPS` at most.

    Returns the last poses, whether goals are reached (N,), and all poses by step.
    """
    poses, way = starts, [starts]
    reached = is_reached(slide, poses, goals)
    for step in range(STEPS):
        rows = np.flatnonzero(~reached)
        if not len(rows):
            break
        here = poses.take(rows)
        poses = poses.put(rows, moved(file, here, limited(policy(step, rows, here), slide)))
        reached |= is_reached(slide, poses, goals)
        way.append(poses)
    return poses, reached, way


def is_reached(slide: Slide, poses: Poses, goals: Poses) -> np.ndarray:
    """Return whether sensors are at their goals, (N,)."""
    return np.all(errors(poses, goals) <= [slide.near, slide.turned], axis=1)
