"""Simulated grasps of several objects as one memory-mapped table: camera images, touches and outcomes.

The stage ``grasp_data`` writes one folder per object: the arrays in `ARRAYS`, with N rows each, and finally
``record.json``, which marks the folder as complete.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.samples import Samples, array_path, map_array, read_sample_record
from objectfolder.benchmarks.datasets.splits import label_order

FORMAT = "objectfolder grasps 1"  #: of the sampling procedure and the files; others are refused
RECORD = "record.json"
#: Type and row shape of each array; None for sizes chosen by the writer.
ARRAYS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "success": ("bool", ()),  #: whether the grasp held
    "soft": ("float32", ()),  #: success rate over the grasp and its slightly perturbed repetitions
    "width": ("float32", ()),  #: opening of the closed jaws, m
    "offset": ("float32", (3,)),  #: contact midpoint from the centre of mass; closing, lateral, up; m
    "force": ("float32", ()),  #: of the jaws, N
    "image": ("uint8", (None, None, 3)),  #: of the external camera
    "touch": ("uint8", (2, None, None, 3)),  #: left and right finger, from the Object File
    "explicit": ("uint8", (2, None, None, 3)),  #: of the same contacts, simulated on the source mesh
}
OPTIONAL = "explicit"  #: absent without ground truth
NUMBERS = ("soft", "width", "offset", "force")
AGAIN = "collect its grasps again"


class Grasps(Samples):
    """Grasps of several objects; images are memory-mapped. See `Samples`, and `ARRAYS` for the arrays.

    Of folders by key, with ``record.json`` and the arrays. Raises ObjectFolderError if one is incomplete or
    damaged, or objects differ in number or shape of grasps.
    """

    def __init__(self, folders: Mapping[str, Path]):
        if not folders:
            raise ObjectFolderError("no objects given, expected grasp folders of at least two objects")
        paths = {key: Path(folders[key]) for key in label_order(folders)}
        records = {key: _record(key, path / RECORD) for key, path in paths.items()}
        without = [key for key, path in paths.items() if not array_path(path, OPTIONAL).is_file()]
        if without and len(without) < len(paths):
            raise ObjectFolderError(
                f"{', '.join(without)}: no explicit touches ({array_path(Path(), OPTIONAL)}), unlike others; "
                "collect them for all objects or for none"
            )
        self.has_explicit = not without  #: whether touches were also simulated from the ground truth
        arrays = {
            name: [_open(key, path, name, records[key]["count"]) for key, path in paths.items()]
            for name in ARRAYS
            if name != OPTIONAL or self.has_explicit
        }
        super().__init__(records, arrays, "collect the grasps of all objects with the same settings")
        if self.has_explicit and self.shape("explicit") != self.shape("touch"):
            raise ObjectFolderError(
                f"{self.keys[0]}: explicit touches have shape {self.shape('explicit')}, expected that of "
                f"touches, {self.shape('touch')}; {AGAIN}"
            )
        self.success = np.concatenate(arrays["success"])  #: (K N,) bool, outcome of each grasp


def _record(key: str, path: Path) -> dict[str, Any]:
    record = read_sample_record(key, path, "grasps", "format", FORMAT, AGAIN)
    lacking = [
        name
        for name, kind in (("count", int), ("digest", str))
        if not isinstance(record.get(name), kind) or not record[name]
    ]
    if lacking:
        raise ObjectFolderError(f"{key}: {path} lacks {' and '.join(lacking)}; {AGAIN}")
    return record


def _open(key: str, folder: Path, name: str, count: int) -> np.ndarray:
    path, (dtype, row) = array_path(folder, name), ARRAYS[name]
    array = map_array(key, path, AGAIN)
    fits = len(array.shape) == 1 + len(row) and all(
        has == wanted or wanted is None for has, wanted in zip(array.shape, (count, *row))
    )
    if array.dtype != dtype or not fits:
        expected = ", ".join("any" if side is None else str(side) for side in (count, *row))
        raise ObjectFolderError(
            f"{key}: {path} holds {array.dtype} of shape {array.shape}, expected {dtype} of ({expected}); "
            f"{AGAIN}"
        )
    if name in NUMBERS and not np.isfinite(array).all():
        raise ObjectFolderError(f"{key}: {path} holds values that are not finite; {AGAIN}")
    return array
