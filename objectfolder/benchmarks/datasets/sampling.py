"""Sample an object: random views, impact sounds and touches of its Object File (supplementary I.1)."""

import hashlib
import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from objectfolder.base.arrays import write_npy, write_npz
from objectfolder.base.disk import enough_space
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import atomic_stream, write_json
from objectfolder.base.locks import exclusive
from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets.observations import QUERIES, RECORD, RELIEF, SOURCE, UNTOUCHED, VERSION
from objectfolder.benchmarks.datasets.samples import (
    array_path,
    has_uncertain_sound,
    object_digest,
    read_stored,
    require_parts,
)
from objectfolder.benchmarks.datasets.settings import ObserveConfig
from objectfolder.benchmarks.datasets.splits import TEN, check_count
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.query_files import sample_depths, sample_strikes, sample_views
from objectfolder.sound.spectrogram import DURATION, SAMPLE_RATE
from objectfolder.stored.header import PARTS
from objectfolder.touch.contact import sensor_frames
from objectfolder.workspace.code_digests import code_digest
from objectfolder.workspace.layout import MODALITIES

FORCES = (0.1, 1.0)  #: range of impulses, N s
#: Relief of the ground under a touch: side of the square that is looked at, metres.
SPAN = 0.0095
RAYS = 9  #: along each side
ABOVE = 0.004  #: where rays start, metres above the point
BELOW = 0.003  #: and where they end below it: gel of no sensor reaches further
_DTYPES: dict[str, np.dtype[Any]] = dict(zip(MODALITIES, map(np.dtype, ("uint8", "float32", "uint8"))))

log = logging.getLogger(__name__)

#: Query arrays by name: (N, 3) or (N,) float64.
Queries = dict[str, np.ndarray]


def sample_observations(
    file: ObjectFile,
    wanted: ObserveConfig,
    seed: int,
    folder: str | Path,
    report: Callable[[str, int], None] = lambda modality, done: None,
) -> None:
    """Sample views, impact sounds and touches of an object and write them to a folder.

    An interrupted call resumes at the modality it was writing. A complete folder is left alone. Observations
    of another Object File, seed or settings are replaced; with another depth, touches alone.

    Raises ObjectFolderError as `observation_request`, or if a query fails, or the disk is full.

    The first n observations do not depend on their number. The folder, of this object alone, receives
    ``vision.npy``, ``audio.npy`` and ``touch.npy``, each with a ``.json`` that identifies it;
    ``queries.npz``, see `draw_queries`; ``relief.npy``, the `surface_relief` under each touch;
    ``untouched.npy``, which touches miss; the Object File; and finally ``observations.json``. ``report`` is
    called with a modality and the number of its observations written so far.
    """
    folder, request = Path(folder), observation_request(file, wanted, seed)
    with exclusive(folder):  # of two benchmarks that start together, one samples
        if not is_sampled(request, folder):
            _sample(file, wanted, request, folder, report)


def _sample(
    file: ObjectFile,
    wanted: ObserveConfig,
    request: dict[str, Any],
    folder: Path,
    report: Callable[[str, int], None],
) -> None:
    count, resolution = wanted.observations, wanted.resolution
    arrays = {modality: _find_written(folder, modality, request) for modality in MODALITIES}
    (folder / RECORD).unlink(missing_ok=True)
    queries = draw_queries(file, count, request["seed"], wanted.depth)
    one = ask(file, {name: rows[:1] for name, rows in queries.items()}, "touch", resolution)[0]
    shapes = {
        "vision": (count, resolution, resolution, 3),
        "audio": (count, round(SAMPLE_RATE * DURATION)),
        "touch": (count, *one.shape[1:]),
    }
    missing = [modality for modality, array in arrays.items() if array is None]
    needed = sum(math.prod(shapes[modality]) * _DTYPES[modality].itemsize for modality in missing)
    hint = ", or sample fewer or smaller observations; complete modalities are kept"
    with enough_space(f"{file.key}: observations", folder, needed, hint):
        write_npz(folder / QUERIES, **queries)
        write_npy(folder / RELIEF, surface_relief(file.surface, queries["touch_point"], file.scale))
        file.save(folder / SOURCE)
        for modality in missing:
            (folder / f"{modality}.json").unlink(missing_ok=True)  # else it vouches for the new array, too
            array = _write(file, queries, modality, shapes[modality], folder, report)
            record = {"request": _part_of(request, modality), "array": array}
            write_json(folder / f"{modality}.json", record)
            arrays[modality] = array
        write_npy(folder / UNTOUCHED, _find_untouched(file, folder))
        write_json(folder / RECORD, request | {"arrays": arrays})


def _find_untouched(file: ObjectFile, folder: Path) -> np.ndarray:
    """Return which written touches show the bare gel; (N,) bool."""
    touches = np.load(array_path(folder, "touch"), mmap_mode="r", allow_pickle=False)
    if file.fixed_contact is not None:  # a net of pictures alone always draws a contact
        return np.zeros(len(touches), bool)
    bare: np.ndarray = (touches == file.sensor_background).all((1, 2, 3))
    return bare


def observation_request(file: ObjectFile, wanted: ObserveConfig, seed: int) -> dict[str, Any]:
    """Identify the observations that `sample_observations` writes; hashes the Object File.

    A sound that is marked uncertain is so here, too. Raises ObjectFolderError if the number of observations
    is not a multiple of ten, the Object File lacks a part, or its sensor is not pressed to the depth.
    """
    check_count(wanted.observations)
    if wanted.resolution < 1:
        side = wanted.resolution
        raise ObjectFolderError(f"{file.key}: views of {side} pixels, expected a positive number")
    require_parts(file, PARTS, "benchmarks")
    marked: dict[str, Any] = {"uncertain": True} if has_uncertain_sound(file) else {}
    if wanted.depth is not None:
        check_depth(file, wanted.depth)
        marked["depth"] = wanted.depth
    return marked | {
        "version": VERSION,
        "code": code_digest(sample_observations),
        "key": file.key,
        "material": file.material,
        "scale": file.scale,
        "sensor": file.sensor,
        "object_sha256": object_digest(file),
        "count": wanted.observations,
        "resolution": wanted.resolution,
        "sample_rate": SAMPLE_RATE,
        "seed": seed,
    }


def check_depth(file: ObjectFile, depth: float) -> None:
    """Raise ObjectFolderError if the sensor of an Object File is not pressed to ``observe.depth``, m."""
    fixed = file.fixed_contact
    low, high = file.press_range() if fixed is None else (fixed.depth, fixed.depth)
    if not low <= depth <= high:
        expected = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        raise ObjectFolderError(
            f"{file.key}: observe.depth is {depth:g} m, but its sensor {file.sensor} is pressed {expected} m "
            "deep; change observe.depth, or set it to null for random depths"
        )


def is_sampled(request: dict[str, Any], folder: Path) -> bool:
    """Return whether a folder holds all observations of an `observation_request`."""
    if not all((folder / name).is_file() for name in (QUERIES, RELIEF, UNTOUCHED, SOURCE)):
        return False
    arrays = {modality: _find_written(folder, modality, request) for modality in MODALITIES}
    return all(arrays.values()) and read_stored(folder / RECORD) == request | {"arrays": arrays}


def draw_queries(file: ObjectFile, count: int, seed: int, depth: float | None = None) -> Queries:
    """Draw the queries of an object, in independent tens, so that they do not depend on the count.

    ``vision_camera`` and ``vision_light`` (N, 3), unit frame: uniform on the spheres of the paper's data
    (supplementary C). ``audio_point`` (N, 3), metres, uniform by area, and ``audio_force`` (N, 3), N s, in
    uniform directions into the object with log-uniform length in `FORCES`. ``touch_point`` (N, 3), metres,
    uniform by area, and ``touch_depth`` (N,), metres, uniform over the file's ``press_range``, or the single
    depth of a net of kind ``image``, or that given.
    """
    tens = [_draw_ten(file, seed, ten) for ten in range(count // TEN)]
    queries = {name: np.concatenate([rows[name] for rows in tens]) for name in tens[0]}
    return queries if depth is None else queries | {"touch_depth": np.full(count, depth)}


def _draw_ten(file: ObjectFile, seed: int, ten: int) -> Queries:
    def rng(purpose: str) -> np.random.Generator:
        return numpy_generator(seed, file.key, "observations", purpose, str(ten))

    def drawn(purpose: str) -> int:
        return int(rng(purpose).integers(2**63))

    views = sample_views(TEN, drawn("vision"))
    strikes = sample_strikes(file, TEN, drawn("audio"), directions="random")
    weakest, strongest = np.log(FORCES)
    impulse = np.exp(rng("force").uniform(weakest, strongest, TEN))
    return {
        "vision_camera": views[:, :3],
        "vision_light": views[:, 3:],
        "audio_point": strikes[:, :3],
        "audio_force": strikes[:, 3:] * impulse[:, None],
        "touch_point": file.sample_surface(TEN, drawn("touch")),
        "touch_depth": sample_depths(file, TEN, drawn("depth")),
    }


def ask(file: ObjectFile, queries: Queries, modality: str, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Answer any number of rows of `draw_queries` in one modality; views have ``resolution`` pixels a side.

    Returns observations (N, ...), as `objectfolder.benchmarks.datasets.observations.Observations` describes
    them, and which are empty, (N,) bool: no pixel of the object, silence, or no contact.
    """
    if modality == "vision":
        views = file.render(queries["vision_camera"], queries["vision_light"], resolution)
        return np.round(views.rgb * 255).astype(np.uint8), ~np.any(views.alpha, axis=(1, 2))
    if modality == "audio":
        strikes = queries["audio_point"], queries["audio_force"]
        # Ideal impulses, as in the paper.
        sounds = file.impact(*strikes, SAMPLE_RATE, DURATION, "displacement", contact_time=0.0)
        return sounds, ~np.any(sounds, axis=1)
    points, depth = queries["touch_point"], queries["touch_depth"]
    if file.fixed_contact is not None:
        return file.touch(points, depth), np.zeros(len(points), bool)
    felt = file.press(points, depth)
    return felt.images, ~np.any(felt.mask, axis=(1, 2))


def _part_of(request: dict[str, Any], modality: str) -> dict[str, Any]:
    """Return what of a request one modality depends on: on the depth of presses touches alone."""
    return {name: value for name, value in request.items() if name != "depth" or modality == "touch"}


def _find_written(folder: Path, modality: str, request: dict[str, Any]) -> dict[str, Any] | None:
    """Return the metadata of a complete array of this request; None if there is none."""
    path, stored = array_path(folder, modality), read_stored(folder / f"{modality}.json")
    if stored.get("request") != _part_of(request, modality) or not path.is_file():
        return None
    array: dict[str, Any] = stored["array"]
    return array if path.stat().st_size == array["bytes"] else None


def _write(
    file: ObjectFile,
    queries: Queries,
    modality: str,
    shape: tuple[int, ...],
    folder: Path,
    report: Callable[[str, int], None],
) -> dict[str, Any]:
    """Write the observations of one modality, ten at a time; return their metadata."""
    path, dtype, digest, empty = array_path(folder, modality), _DTYPES[modality], hashlib.sha256(), 0
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    with atomic_stream(path) as stream:
        np.lib.format.write_array_header_1_0(stream, header)
        for start in range(0, shape[0], TEN):
            rows = {name: values[start : start + TEN] for name, values in queries.items()}
            block = f"{file.key}: {modality} observations {start} to {start + TEN - 1}"
            try:
                answers, nothing = ask(file, rows, modality, shape[1])
            except ObjectFolderError as error:
                raise ObjectFolderError(f"{block}: {error}") from error
            if answers.shape != (TEN, *shape[1:]) or answers.dtype != dtype:
                raise ObjectFolderError(
                    f"{block}: answers are {answers.dtype} {answers.shape}, expected {dtype} {shape[1:]} each"
                )
            if not np.isfinite(answers).all():
                raise ObjectFolderError(f"{block}: values are not finite; rebuild the object")
            content = answers.tobytes()
            digest.update(content)
            stream.write(content)
            empty += int(nothing.sum())
            report(modality, start + TEN)
    if empty:
        log.warning("%s: %d of %d observations of %s are empty", file.key, empty, shape[0], modality)
    size = path.stat().st_size
    return {"shape": list(shape), "sha256": digest.hexdigest(), "bytes": size, "empty": empty}


def surface_relief(surface: Isosurface, points: np.ndarray, scale: float) -> np.ndarray:
    """Return the root mean square height of the surface around points, above its mean plane there; (N,), m.

    It is that of the first surface that rays along the inward normal meet, in a square of side `SPAN`: zero
    on flat ground, however inclined. The surface is in the unit frame; the points (N, 3) on it are in metres,
    as is the scale, the object's longest side.
    """
    place = np.asarray(points, np.float64) / scale
    normals = surface.grid.normals(torch.from_numpy(place.astype(np.float32))).numpy()
    frames = sensor_frames(normals.astype(np.float64), np.zeros(len(place)))
    across = np.linspace(-SPAN / 2, SPAN / 2, RAYS)
    square = np.stack(np.meshgrid(across, across), -1).reshape(-1, 2)
    starts = ABOVE * -frames[:, None, :, 0] + np.einsum("kc,nxc->nkx", square, frames[:, :, 1:])
    origins = (place[:, None] + starts / scale).reshape(-1, 3)
    inward = np.repeat(frames[:, :, 0], len(square), 0)
    distance, _ = surface.caster.first_hit(origins.astype(np.float32), inward.astype(np.float32))
    height = np.maximum(ABOVE - scale * distance.astype(np.float64), -BELOW).reshape(len(place), -1)
    plane = np.column_stack([np.ones(len(square)), square])
    height -= height @ np.linalg.pinv(plane).T @ plane.T
    return np.sqrt((height**2).mean(1))
