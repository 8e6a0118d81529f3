"""Simulate grasps of an object: camera images, touches of both fingers, outcomes (supplementary I.4)."""

import hashlib
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.arrays import write_npz
from objectfolder.base.disk import enough_space, refuse_links
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import atomic_stream, write_json
from objectfolder.base.locks import exclusive
from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets import samples
from objectfolder.benchmarks.datasets.grasps import ARRAYS, FORMAT, OPTIONAL, RECORD
from objectfolder.benchmarks.datasets.settings import GraspDataConfig
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import fingers
from objectfolder.sim.body import RigidBody, rotation, turn_poses
from objectfolder.sim.camera import ExternalCamera
from objectfolder.sim.grasp_scene import GraspScene, Outcomes, Physics, lowest_hand
from objectfolder.sim.gripper import PAD, hand_axes
from objectfolder.sim.hulls import hulls_digest
from objectfolder.workspace.code_digests import code_digest

POSES = "poses.npz"  #: poses and contacts, sufficient to repeat each grasp
FORCES = (1.0, 40.0)  #: of each jaw, N, log-uniform
PLACES = 0.03  #: largest offset of objects from the origin along x and y, m
INSIDE = 0.8  #: shrinkage of the object's silhouette over which hands come down
SHIFT, TURN, STRENGTH = 0.001, np.radians(1.0), 0.03  #: perturbations: standard deviations, m, rad, fraction
BATCH = 32  #: grasps simulated together; the unit of progress
ATTEMPTS = 20000  #: consecutive colliding poses before an object is given up
EMPTY = 10  #: consecutive batches without contact of both pads before it is
STRAY = 0.03  #: of the true surface's bounds from the stored surface's, at most, fraction of the size

Report = Callable[[int, int], None]
Surface = tuple[np.ndarray, np.ndarray]  #: vertices (V, 3), unit frame, and faces (F, 3)


@dataclass(frozen=True)
class Attempts:
    """N grasps to simulate; world frame."""

    objects: np.ndarray  #: (N, 7)
    hands: np.ndarray  #: (N, 4)
    forces: np.ndarray  #: (N,)

    def take(self, rows: np.ndarray) -> "Attempts":
        """Select rows."""
        return Attempts(self.objects[rows], self.hands[rows], self.forces[rows])


def collect_grasps(
    file: ObjectFile,
    body: RigidBody,
    wanted: GraspDataConfig,
    seed: int,
    folder: str | Path,
    surface: Surface | None = None,
    threads: int = 1,
    report: Report = lambda done, total: None,
) -> None:
    """Simulate random grasps of an object, and write images, touches and outcomes.

    Positions, orientations and forces are random. Poses in which the open gripper collides with the object
    are skipped, and grasps without contact of both pads do not count; the record reports their numbers. An
    interrupted call resumes. The bytes do not depend on the number of threads.

    Raises ObjectFolderError if the object does not fit the gripper or cannot be grasped, the Object File
    lacks vision or touch or its touch net does not answer pads, the gel of its sensor is rigid, or the
    surface is of another object.

    The folder gets ``record.json`` and the arrays of `objectfolder.benchmarks.datasets.grasps.ARRAYS`. The
    source's closed surface adds the array ``explicit``; it is None for a touch net that knows one press alone
    (`ObjectFile.fixed_contact`). ``report`` is called with the numbers of collected and of wanted grasps.
    """
    folder = Path(folder)
    request = grasp_request(file, body, wanted, seed, surface)
    with exclusive(folder):  # of two benchmarks that start together, one simulates
        if is_collected(request, folder):
            return
        samples.require_parts(file, ("geometry", "vision", "touch"), "grasps")
        fingers.require_pads(file)
        if file.fixed_contact is None and file.sensor_profile.gel == "rigid":
            raise ObjectFolderError(
                f"{file.key}: the gel of sensor {file.sensor!r} is rigid and bears no force, which gives the "
                "press depth of grasps; rebuild the object with a sensor with gel: soft"
            )
        scene = GraspScene(body, Physics(timestep=wanted.timestep), threads)
        truth = None if surface is None else _truth(file, surface)
        rests = scene.rests(numpy_generator(seed, file.key, "rests"))
        progress = folder / ".progress" / hashlib.sha256(repr(request).encode()).hexdigest()[:16]
        refuse_links(progress, folder)
        (folder / RECORD).unlink(missing_ok=True)
        camera = ExternalCamera(wanted.image)
        paths: list[Path] = []
        counts = dict.fromkeys(("drawn", "free", "touched"), 0)
        needed = 2 * wanted.grasps * wanted.bytes(explicit=truth is not None)  # batches, then arrays
        with enough_space(f"{file.key}: grasps", folder, needed, ", or collect fewer or smaller ones"):
            while counts["touched"] < wanted.grasps:
                path = progress / f"{len(paths):05d}.npz"
                if not path.is_file():
                    rng = numpy_generator(seed, file.key, "grasps", str(len(paths)))
                    tried = label_grasps(scene, rests, wanted.perturbations, rng)
                    write_npz(path, **_observe(file, body, camera, wanted.touch, truth, *tried))
                with np.load(path, allow_pickle=False) as stored:
                    counts = {name: count + int(stored[name]) for name, count in counts.items()}
                paths.append(path)
                report(min(counts["touched"], wanted.grasps), wanted.grasps)
            digest = _write(folder, paths, wanted.grasps)
            success = np.concatenate(list(_parts(paths, "success")))[: wanted.grasps]
            record = request | {"digest": digest, "attempts": counts, "success_rate": float(success.mean())}
            write_json(folder / RECORD, record | {"mass": body.mass})
        shutil.rmtree(folder / ".progress")


def is_collected(request: dict[str, Any], folder: Path) -> bool:
    """Return whether a folder holds all grasps of a `grasp_request`."""
    names = [name for name in ARRAYS if name != OPTIONAL or request["surface_sha256"]]
    return samples.is_complete(folder / RECORD, request, names)


def draw_attempts(
    scene: GraspScene, rests: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[Attempts, int]:
    """Draw grasps with collision-free start poses; also return the number of poses drawn.

    The object has one of its resting poses, turned about the vertical and moved. The hand comes down over a
    random point of its silhouette, to any height, from any direction; the force is log-uniform in `FORCES`.

    Raises ObjectFolderError if `ATTEMPTS` consecutive poses collide.
    """
    found: list[Attempts] = []
    drawn, since, points = 0, 0, scene.body.points
    while sum(len(part.forces) for part in found) < count:
        n = 4 * count
        rest = rests[rng.integers(len(rests), size=n)]
        places = rng.uniform(-PLACES, PLACES, (n, 2))
        objects = turn_poses(rest, rng.uniform(-np.pi, np.pi, n), places)
        body = np.stack([_place(points, pose) for pose in objects])
        over = body[np.arange(n), rng.integers(len(points), size=n), :2]
        hands = np.empty((n, 4))
        hands[:, :2] = places + INSIDE * rng.random((n, 1)) * (over - places)
        hands[:, 2] = rng.uniform(lowest_hand(), np.maximum(body[:, :, 2].max(1), lowest_hand() + SHIFT))
        hands[:, 3] = rng.uniform(-np.pi / 2, np.pi / 2, n)
        weakest, strongest = np.log(FORCES)
        forces = np.exp(rng.uniform(weakest, strongest, n))
        free = np.flatnonzero(scene.free(objects, hands))
        drawn, since = drawn + n, 0 if len(free) else since + n
        found.append(Attempts(objects, hands, forces).take(free))
        if since > ATTEMPTS:
            raise ObjectFolderError(
                f"{scene.body.key}: the open gripper fits over it in none of {since} random poses; it may be "
                "too wide as it lies: build it at a smaller scale, or take another object"
            )
    joined = Attempts(*(np.concatenate(parts) for parts in zip(*(vars(part).values() for part in found))))
    return joined.take(np.arange(count)), drawn


def label_grasps(
    scene: GraspScene, rests: np.ndarray, perturbations: int, rng: np.random.Generator
) -> tuple[Outcomes, dict[str, np.ndarray]]:
    """Simulate batches of grasps until both pads touch the object in some; label those.

    Returns the outcomes, and beside them initial object poses (``start``), maximum force of each jaw
    (``limits``), success rate over the perturbations (``soft``), and the numbers of ``drawn``, ``free`` and
    ``touched`` poses. Raises ObjectFolderError if no collision-free pose is found, or no batch of `EMPTY` has
    contact of both pads.
    """
    drawn = free_poses = 0
    for _ in range(EMPTY):
        attempts, poses = draw_attempts(scene, rests, BATCH, rng)
        closed = scene.close(attempts.objects, attempts.hands, attempts.forces)
        rows = np.flatnonzero(closed.touched.all(1))
        drawn, free_poses = drawn + poses, free_poses + BATCH
        if len(rows):
            break
    else:
        raise ObjectFolderError(
            f"{scene.body.key}: both pads touch it in none of {free_poses} grasps; pads reach down to "
            f"{1000 * (lowest_hand() - PAD[2]):.0f} mm over the table, so it may be too small or too flat: "
            "take another object, or build it larger"
        )
    grasps, attempts = scene.lift(closed.take(rows)), attempts.take(rows)
    successes, trials = grasps.success.astype(int), np.ones(len(rows), int)
    for changed in _perturb(attempts, perturbations, rng):
        free = np.flatnonzero(scene.free(changed.objects, changed.hands))
        successes[free] += scene.grasp(*vars(changed.take(free)).values()).success
        trials[free] += 1
    return grasps, {
        "start": attempts.objects,
        "limits": attempts.forces,
        "soft": (successes / trials).astype(np.float32),
        "drawn": np.array(drawn),
        "free": np.array(free_poses),
        "touched": np.array(len(rows)),
    }


def _perturb(attempts: Attempts, count: int, rng: np.random.Generator) -> Iterator[Attempts]:
    n = len(attempts.forces)
    for _ in range(count):
        shift = np.c_[rng.normal(0, SHIFT, (n, 3)), rng.normal(0, TURN, n)]
        hands = attempts.hands + shift
        hands[:, 2] = np.maximum(hands[:, 2], lowest_hand())
        yield Attempts(attempts.objects, hands, attempts.forces * np.exp(rng.normal(0, STRENGTH, n)))


def _observe(
    file: ObjectFile,
    body: RigidBody,
    camera: ExternalCamera,
    touch: tuple[int, int],
    truth: fingers.TrueSurface | None,
    grasps: Outcomes,
    more: dict[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Compute all arrays of a batch."""
    pressed = fingers.pad_presses(grasps.objects, grasps.hands, grasps.contacts)
    depths = fingers.press_depths(file, pressed, grasps.forces.ravel())
    middle = grasps.contacts.mean(1) - np.stack([_place(body.centre, pose) for pose in grasps.objects])
    pictures = zip(grasps.objects, grasps.hands, grasps.width)
    arrays = {
        "success": grasps.success,
        "width": grasps.width.astype(np.float32),
        "offset": np.einsum("nij,ni->nj", hand_axes(grasps.hands), middle).astype(np.float32),
        "force": grasps.forces.mean(1).astype(np.float32),
        "image": np.stack([camera.picture(file, *given) for given in pictures]),
        "touch": _images(fingers.tactile_images, file, pressed, depths, touch),
        "objects": grasps.objects,
        "hands": grasps.hands,
        "contacts": grasps.contacts,
        "depths": depths.reshape(-1, 2),
    }
    if truth is not None:
        arrays[OPTIONAL] = _images(fingers.TrueSurface.tactile_images, truth, pressed, depths, touch)
    return arrays | more


def _images(
    ask: Callable[[Any, fingers.Presses, np.ndarray], np.ndarray],
    source: Any,
    pressed: fingers.Presses,
    depths: np.ndarray,
    size: tuple[int, int],
) -> np.ndarray:
    """Compute tactile images of both fingers at the stored size; (N, 2, h, w, 3) uint8."""
    return samples.averaged_images(ask(source, pressed, depths), size).reshape(-1, 2, *size, 3)


def _write(folder: Path, paths: list[Path], count: int) -> str:
    """Concatenate batches array by array; return the SHA-256 of the arrays."""
    digest = hashlib.sha256()
    with np.load(paths[0], allow_pickle=False) as first:
        rows = {name: first[name][:1] for name in first.files if first[name].ndim}
    for name in ARRAYS:
        if name not in rows:
            samples.array_path(folder, name).unlink(missing_ok=True)
            continue
        example, left = rows[name], count
        header = {"descr": example.dtype.str, "fortran_order": False, "shape": (count, *example.shape[1:])}
        with atomic_stream(samples.array_path(folder, name)) as stream:
            np.lib.format.write_array_header_1_0(stream, header)
            for part in _parts(paths, name):
                content = part[:left].tobytes()
                left -= min(left, len(part))
                digest.update(content)
                stream.write(content)
    others = [name for name in rows if name not in ARRAYS]
    write_npz(folder / POSES, **{name: np.concatenate(list(_parts(paths, name)))[:count] for name in others})
    return digest.hexdigest()


def _parts(paths: list[Path], name: str) -> Iterator[np.ndarray]:
    for path in paths:
        with np.load(path, allow_pickle=False) as stored:
            yield stored[name]


def grasp_request(
    file: ObjectFile, body: RigidBody, wanted: GraspDataConfig, seed: int, surface: Surface | None
) -> dict[str, Any]:
    """Identify the grasps that `collect_grasps` writes; hashes the Object File and the surface."""
    return {
        "format": FORMAT,
        "code": code_digest(collect_grasps),
        "key": file.key,
        "material": file.material,
        "scale": file.scale,
        "object_sha256": samples.object_digest(file),
        "hulls_sha256": hulls_digest(body.hulls),
        "friction": body.friction,
        "count": wanted.grasps,
        "wanted": {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(wanted).items()},
        "surface_sha256": None if surface is None else _digest(surface),
        "seed": seed,
    }


def _digest(surface: Surface) -> str:
    content = b"".join(np.ascontiguousarray(array).tobytes() for array in surface)
    return hashlib.sha256(content).hexdigest()


def _truth(file: ObjectFile, surface: Surface) -> fingers.TrueSurface:
    if file.fixed_contact is not None:
        raise ObjectFolderError(
            f"{file.key}: its touch net stores a single press, with which the true surface cannot be "
            "compared; collect without the surface"
        )
    vertices, faces = surface
    bounds, known = np.stack([vertices.min(0), vertices.max(0)]), file.bounds / file.scale
    if np.abs(bounds - known).max() > STRAY:
        raise ObjectFolderError(
            f"{file.key}: the true surface reaches from {bounds[0].round(3).tolist()} to "
            f"{bounds[1].round(3).tolist()} of the object's size, the Object File from "
            f"{known[0].round(3).tolist()} to {known[1].round(3).tolist()}: it is of another object or build"
        )
    return fingers.TrueSurface(vertices * file.scale, faces, file.sensor_profile, file.sensor_background)


def _place(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Transform points (..., 3) of an object by a pose (7,)."""
    return points @ rotation(pose[3:]).T + pose[:3]
