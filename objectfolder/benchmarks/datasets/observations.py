"""Observations of several objects, as one memory-mapped table for all benchmarks.

`objectfolder.benchmarks.datasets.sampling` writes a folder per object: ``vision.npy``, ``audio.npy``,
``touch.npy``, ``queries.npz``, the Object File and, last, ``observations.json``. A folder without it is
incomplete.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.benchmarks.datasets.arrays import map_array, read_rows
from objectfolder.benchmarks.datasets.splits import label_order
from objectfolder.errors import ObjectFolderError
from objectfolder.io import read_json, read_npz
from objectfolder.workspace.layout import MODALITIES

VERSION = 1  #: of how observations are drawn and stored; older ones are not mixed with newer
RECORD = "observations.json"
QUERIES = "queries.npz"
SOURCE = "ObjectFile.safetensors"  #: what was observed; tasks about shape ask it for the surface


def array_path(folder: Path, modality: str) -> Path:
    """Return where a folder holds one modality."""
    return folder / f"{modality}.npy"


def find_folders(paths: Iterable[str | Path]) -> dict[str, Path]:
    """Find folders of complete observations, by key.

    Parameters
    ----------
    paths : iterable of paths
        Such folders, or folders that hold them at any depth.

    Raises
    ------
    ObjectFolderError
        If there are none in a path, or two of one object.
    """
    found: dict[str, Path] = {}
    for path in map(Path, paths):
        folders = sorted(record.parent for record in path.rglob(RECORD))
        if not folders:
            raise ObjectFolderError(
                f"{path} holds no observations: no {RECORD} in it or below; sample objects"
            )
        for folder in folders:
            record = read_json(folder / RECORD)
            key = str(record.get("key")) if isinstance(record, dict) else ""
            if found.setdefault(key, folder) != folder:
                raise ObjectFolderError(
                    f"{key}: both {found[key]} and {folder} hold its observations; give one"
                )
    return found


class Observations:
    """Views, sounds and touches of several objects, read-only and not held in the memory.

    With N observations per object, row r stands for the view, the sound and the touch number ``r % N`` of
    object ``r // N``: one multisensory sample.

    Parameters
    ----------
    folders : mapping
        From keys to folders that `objectfolder.benchmarks.datasets.sampling.sample_observations` wrote.

    Attributes
    ----------
    keys : tuple of str
        Objects in the order of labels; see `objectfolder.benchmarks.datasets.splits.label_order`.
    count : int
        Observations per object, N.
    labels : (K N,) int64 array
        Object of each row, counted from 0.
    records : dict
        By key, what ``observations.json`` says: material, scale, sensor and how the observations were drawn.

    Raises
    ------
    ObjectFolderError
        If a folder is incomplete or damaged, or objects differ in the number or shape of observations.
    """

    def __init__(self, folders: Mapping[str, Path]):
        if not folders:
            raise ObjectFolderError("no objects were given, expected folders of observations of two at least")
        self.keys = label_order(folders)
        self._folders = {key: Path(folders[key]) for key in self.keys}
        self.records: dict[str, dict[str, Any]] = {
            key: _record(key, folder) for key, folder in self._folders.items()
        }
        self.count = int(self.records[self.keys[0]]["count"])
        for modality in MODALITIES:
            _check_alike(modality, self.records)
        self.labels = np.repeat(np.arange(len(self.keys), dtype=np.int64), self.count)
        self._arrays = {
            modality: [
                _open(key, folder, modality, self.records[key]) for key, folder in self._folders.items()
            ]
            for modality in MODALITIES
        }

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def digest(self) -> str:
        """SHA-256 of all records, which hold digests of all arrays; hexadecimal."""
        records = [self.records[key] for key in self.keys]
        return hashlib.sha256(json.dumps(records, sort_keys=True).encode()).hexdigest()

    def shape(self, modality: str) -> tuple[int, ...]:
        """Shape of one observation."""
        return self._of(modality)[0].shape[1:]

    def read(self, modality: str, rows: np.ndarray) -> np.ndarray:
        """Read some rows.

        Parameters
        ----------
        modality : {"vision", "audio", "touch"}
        rows : (B,) int array
            In any order, also twice.

        Returns
        -------
        (B, H, W, 3) uint8 array
            Of vision (sRGB on white) and touch.
        (B, 32000) float32 array
            Of audio: two seconds at 16 kHz, absolute scale.

        Raises
        ------
        ObjectFolderError
            If there is no such modality.
        IndexError
            If there is no such row.
        """
        return read_rows(self._of(modality), rows)

    def queries(self, key: str) -> dict[str, np.ndarray]:
        """What an object was asked: see `objectfolder.benchmarks.datasets.sampling.draw_queries`."""
        return read_npz(self._folders[key] / QUERIES)

    def object_file(self, key: str) -> Path:
        """Return the Object File that was observed."""
        return self._folders[key] / SOURCE

    def _of(self, modality: str) -> list[np.ndarray]:
        if modality not in self._arrays:
            raise ObjectFolderError(
                f"modality {modality!r} is unknown, expected one of {', '.join(self._arrays)}"
            )
        return self._arrays[modality]


def _record(key: str, folder: Path) -> dict[str, Any]:
    if not (folder / RECORD).is_file():
        raise ObjectFolderError(
            f"{key}: {folder} holds no complete observations ({RECORD} is missing); sample the object again"
        )
    record = read_json(folder / RECORD)
    known = record.get("version") if isinstance(record, dict) else None
    if known != VERSION:
        raise ObjectFolderError(
            f"{key}: {folder / RECORD} is of version {known}, expected {VERSION}; sample the object again"
        )
    if record.get("key") != key:
        raise ObjectFolderError(
            f"{folder} holds observations of {record.get('key')}, expected those of {key}"
        )
    return record


def _check_alike(modality: str, records: Mapping[str, dict[str, Any]]) -> None:
    shapes = {key: record["arrays"][modality]["shape"] for key, record in records.items()}
    (first, expected), *others = shapes.items()
    for key, shape in others:
        if shape != expected:
            raise ObjectFolderError(
                f"{key}: its observations of {modality} have shape {shape}, those of {first} {expected}; "
                "expected the same of all objects: sample them alike"
            )


def _open(key: str, folder: Path, modality: str, record: dict[str, Any]) -> np.ndarray:
    path, shape = array_path(folder, modality), tuple(record["arrays"][modality]["shape"])
    array = map_array(key, path, "sample the object again")
    if array.shape != shape:
        raise ObjectFolderError(
            f"{key}: {path} has shape {array.shape}, expected {shape}; sample the object again"
        )
    return array
