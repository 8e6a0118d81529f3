"""Sample close views of points on objects, each beside the touch at the same point.

One folder per object holds ``view.npy``, ``touch.npy`` and finally ``record.json``, which marks it as
complete.
"""

from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.arrays import write_npy
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_json
from objectfolder.base.locks import exclusive
from objectfolder.benchmarks.datasets import samples
from objectfolder.benchmarks.datasets.observations import CLOSE_UP_ARRAYS, CLOSE_UP_RECORD
from objectfolder.objectfile.close_views import camera_distances, close_views
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.code_digests import code_digest

DEPTH = 0.001  #: of all presses, metres
NEAREST = 0.01  #: of the camera to the point, metres
CHUNK = 50  #: contacts pressed at once
SMALLEST = 11  #: side of an image, pixels: the window of SSIM


def close_up_request(file: ObjectFile, count: int, size: tuple[int, int], seed: int) -> dict[str, Any]:
    """Return what `sample_close_ups` depends on.

    Raises ObjectFolderError if the object cannot be seen and touched at any point and depth, or images are
    too small or larger than the sensor's.
    """
    samples.require_parts(file, ("geometry", "vision", "touch"), "close views and touches")
    if file.fixed_contact is not None:
        raise ObjectFolderError(
            f"{file.key}: its touch net stores one depth of press; leave the object out, or rebuild it"
        )
    largest = (file.sensor_profile.height, file.sensor_profile.width)
    if min(size) < SMALLEST or any(side > limit for side, limit in zip(size, largest, strict=True)):
        raise ObjectFolderError(
            f"{file.key}: encode.touch is {list(size)}, expected at least {SMALLEST} pixels a side, the "
            f"window of SSIM, and at most those of the sensor, {list(largest)}"
        )
    return {
        "code": code_digest(sample_close_ups),
        "key": file.key,
        "object_sha256": samples.object_digest(file),
        "count": count,
        "size": list(size),
        "seed": seed,
    }


def has_close_ups(request: dict[str, Any], folder: Path) -> bool:
    """Return whether a folder holds all images of a `close_up_request`."""
    return samples.is_complete(folder / CLOSE_UP_RECORD, request, CLOSE_UP_ARRAYS)


def sample_close_ups(file: ObjectFile, count: int, size: tuple[int, int], seed: int, folder: Path) -> None:
    """See and press an object at random points of its surface, where a camera has room, unless it was done.

    The images have a height and a width, at most the sensor's. The folder is created. Raises
    ObjectFolderError if the surface hides nearly everywhere, or as `close_up_request`.
    """
    request = close_up_request(file, count, size, seed)
    with exclusive(folder):  # of two benchmarks that start together, one samples
        if has_close_ups(request, folder):
            return
        points, distances = open_points(file, count, seed)
        (folder / CLOSE_UP_RECORD).unlink(missing_ok=True)
        parts = np.array_split(points, -(-count // CHUNK))
        touches = [samples.averaged_images(file.touch(part, DEPTH), size) for part in parts]
        write_npy(samples.array_path(folder, "view"), close_views(file, points, distances, size))
        write_npy(samples.array_path(folder, "touch"), np.concatenate(touches))
        write_json(folder / CLOSE_UP_RECORD, request)


def open_points(file: ObjectFile, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw points of the surface with room for a camera, and its distances: (N, 3) and (N,), metres."""
    drawn = file.sample_surface(4 * count, seed)
    distances = camera_distances(file, drawn)
    chosen = np.flatnonzero(distances >= NEAREST)[:count]
    if len(chosen) < count:
        raise ObjectFolderError(
            f"{file.key}: {len(chosen)} of {len(drawn)} random points leave {100 * NEAREST:g} cm for a "
            f"camera, expected {count}: leave the object out"
        )
    return drawn[chosen], distances[chosen]
