"""Observations of several objects as one memory-mapped table.

`objectfolder.benchmarks.datasets.sampling` writes one folder per object: ``vision.npy``, ``audio.npy``,
``touch.npy``, ``queries.npz``, ``relief.npy``, ``untouched.npy``, the Object File, and finally
``observations.json``, which marks the folder as complete.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.arrays import read_npz
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import read_json
from objectfolder.benchmarks.datasets.samples import (
    Samples,
    array_path,
    gather_rows,
    map_array,
    read_sample_record,
    read_stored,
)
from objectfolder.benchmarks.datasets.splits import label_order
from objectfolder.workspace.layout import MODALITIES

VERSION = 1  #: of the sampling procedure and the format; other versions are refused
RECORD = "observations.json"
QUERIES = "queries.npz"
RELIEF = "relief.npy"  #: of the surface under each touch
UNTOUCHED = "untouched.npy"  #: whether each touch misses the object
CLOSE_UP_RECORD = "record.json"
CLOSE_UP_ARRAYS = ("view", "touch")
_AGAIN = "sample the object again"
SOURCE = "ObjectFile.safetensors"  #: the observed Object File; reconstruction reads its surface


def find_folders(paths: Iterable[str | Path]) -> dict[str, Path]:
    """Find complete observations in folders, at any depth; return their folders by object key.

    Raises ObjectFolderError if a path contains none, or two folders hold observations of the same object.
    """
    found: dict[str, Path] = {}
    for path in map(Path, paths):
        folders = sorted(record.parent for record in path.rglob(RECORD))
        if not folders:
            raise ObjectFolderError(
                f"{path} contains no observations: no {RECORD} in it or below; run `objectfolder bench` first"
            )
        for folder in folders:
            record = read_json(folder / RECORD)
            key = str(record.get("key")) if isinstance(record, dict) else ""
            if found.setdefault(key, folder) != folder:
                raise ObjectFolderError(
                    f"{key}: both {found[key]} and {folder} hold its observations; pass only one"
                )
    return found


class Observations(Samples):
    """Views, sounds and touches of several objects; see `Samples`.

    Row r holds the view, the sound and the touch of one multisensory sample. ``vision`` is (B, H, W, 3)
    uint8, sRGB on white; ``audio`` (B, 32000) float32, two seconds at 16 kHz at absolute scale; ``touch``
    (B, H, W, 3) uint8.

    Of folders by key, as `objectfolder.benchmarks.datasets.sampling.sample_observations` writes them. Raises
    ObjectFolderError if one is incomplete or damaged, or objects differ in number or shape of observations.
    """

    def __init__(self, folders: Mapping[str, Path]):
        if not folders:
            raise ObjectFolderError("no objects given, expected observation folders of at least two objects")
        self._folders = {key: Path(folders[key]) for key in label_order(folders)}
        records = {
            key: read_sample_record(key, folder / RECORD, "observations", "version", VERSION, _AGAIN)
            for key, folder in self._folders.items()
        }
        super().__init__(
            records,
            {name: [self._open(key, name, record) for key, record in records.items()] for name in MODALITIES},
        )

    def _open(self, key: str, modality: str, record: dict[str, Any]) -> np.ndarray:
        path, shape = array_path(self._folders[key], modality), tuple(record["arrays"][modality]["shape"])
        array = map_array(key, path, _AGAIN)
        if array.shape != shape:
            raise ObjectFolderError(f"{key}: {path} has shape {array.shape}, expected {shape}; {_AGAIN}")
        return array

    def queries(self, key: str) -> dict[str, np.ndarray]:
        """Return an object's queries; see `objectfolder.benchmarks.datasets.sampling.draw_queries`."""
        return read_npz(self._folders[key] / QUERIES)

    def relief(self, rows: np.ndarray) -> np.ndarray:
        """Return `objectfolder.benchmarks.datasets.sampling.surface_relief` under touches; (B,) float64, m.

        Raises ObjectFolderError if it is missing, as in observations of earlier versions.
        """
        return self._beside(RELIEF, rows)

    def untouched(self, rows: np.ndarray) -> np.ndarray:
        """Return which touches of rows are presses that miss: pictures of the bare gel; (B,) bool."""
        return self._beside(UNTOUCHED, rows)

    def _beside(self, name: str, rows: np.ndarray) -> np.ndarray:
        whole = [map_array(key, at / name, _AGAIN) for key, at in self._folders.items()]
        return gather_rows(whole, rows)

    def object_file(self, key: str) -> Path:
        """Return the path of the observed Object File."""
        return self._folders[key] / SOURCE


def certain_observations(folders: Mapping[str, Path]) -> Observations:
    """Return `Observations` for a task that uses sound: without objects whose sound is marked uncertain.

    They are named in ``uncertain``. Raises ObjectFolderError as that, or if no object is left.
    """
    records = {key: read_stored(Path(folders[key]) / RECORD) for key in label_order(folders)}
    marked = [key for key, record in records.items() if record.get("uncertain")]
    if marked and len(marked) == len(folders):
        raise ObjectFolderError(
            f"{', '.join(marked)}: the sound of all objects is marked uncertain, and tasks that use sound "
            "leave such objects out; accept it by `modal.allow_uncertain: true` (docs/modal.md#accuracy)"
        )
    samples = Observations({key: folder for key, folder in folders.items() if key not in marked})
    samples.uncertain = tuple(marked)
    return samples


class CloseUps(Samples):
    """Close views and touches of several objects; (B, H, W, 3) uint8 each. See `Samples`.

    Row r shows and presses one random point of the surface. The view is of what the gel covers: its camera
    stands on the contact normal, along which the gel comes, its up is that of the sensor, and both images
    have the same pixels.

    Of folders by key, as `sample_close_ups` writes them. Raises ObjectFolderError if one is incomplete or
    damaged, or objects differ in number or shape of images.
    """

    def __init__(self, folders: Mapping[str, Path]):
        paths = {key: Path(folders[key]) for key in label_order(folders)}
        again = "delete the folder, and run the command again"
        super().__init__(
            {key: read_json(path / CLOSE_UP_RECORD) for key, path in paths.items()},
            {
                name: [map_array(key, array_path(path, name), again) for key, path in paths.items()]
                for name in CLOSE_UP_ARRAYS
            },
            again,
        )
