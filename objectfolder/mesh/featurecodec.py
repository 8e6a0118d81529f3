"""Features of a surface that are stored beside its distance grid, and their encoding.

The stream holds differences of ascending numbers, byte by byte, compressed.
"""

import lzma
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

STEPS = 255  #: of a stored place along a grid edge or in a cell
MARGIN = 0.25  #: voxels by which a stored point may lie outside its cell
REACH = 1.0  #: voxels along each axis by which a moved vertex may lie off the middle of its edge
ORIGIN = 127  #: stored offset of a moved vertex in the middle of its edge
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6, "lc": 0, "pb": 0}]
_MEMORY = 2**28  # memory limit of the decompressor, bytes
COUNTED = {"edges": 4 + 1, "cells": 4 + 3, "sheets": 4, "moved": 4 + 3}  #: lists, and bytes of an entry


@dataclass(frozen=True)
class Features:
    """Places that are stored beside a grid with R samples a side.

    Samples are numbered ``(x R + y) R + z``; a cell has the number of its lowest sample, a grid edge 3 times
    that of its lower sample, plus the axis.
    """

    edges: np.ndarray  #: (E,) int64, ascending
    places: np.ndarray  #: (E,) uint8, crossing from the lower sample (0) to the upper one (255)
    cells: np.ndarray  #: (C,) int64, ascending
    points: np.ndarray  #: (C, 3) uint8, from `MARGIN` below the cell (0) to `MARGIN` above it (255)
    sheets: np.ndarray  #: (S,) int64, ascending: samples that count as inside, in walls under a voxel
    moved: np.ndarray  #: (M,) int64, ascending: edges from those to samples outside
    offsets: np.ndarray  #: (M, 3) uint8, of their vertices from the edges' middles: +-`REACH` for 0 and 254

    def __len__(self) -> int:
        return sum(self.counts.values())

    @property
    def counts(self) -> dict[str, int]:
        """Length of each list."""
        return {name: len(getattr(self, name)) for name in COUNTED}

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> "Features | None":
        """Return the features stored in ``sdf.npz``, if there are any."""
        if "edges" not in arrays:
            return None
        found = cls(**{field.name: arrays[field.name] for field in fields(cls)})
        return found if len(found) else None


def pack_features(features: Features) -> np.ndarray:
    """Compress features to a stream, (bytes,) uint8."""
    columns = [
        *_differences(features.edges),
        features.places,
        *_differences(features.cells),
        *features.points.T,
        *_differences(features.sheets),
        *_differences(features.moved),
        *features.offsets.T,
    ]
    raw = np.concatenate(columns).astype(np.uint8).tobytes()
    return np.frombuffer(lzma.compress(raw, filters=_FILTERS), np.uint8)


def unpack_features(stream: np.ndarray, counts: Mapping[str, int], samples: int) -> Features:
    """Return the features that `pack_features` compressed.

    Their grid has so many samples along each side. ``counts`` says how many it holds, see
    `Features.counts`; those left out are 0. Raises ``ValueError`` if the stream holds another number of
    bytes, or places that are not in order or outside the grid, and ``lzma.LZMAError`` if it is damaged.
    """
    sizes = [width * counts.get(name, 0) for name, width in COUNTED.items()]
    raw = lzma.LZMADecompressor(memlimit=_MEMORY).decompress(stream.tobytes(), sum(sizes) + 1)
    if len(raw) != sum(sizes):
        raise ValueError(f"{len(raw)} bytes or more of features, expected {sum(sizes)}")
    parts = np.split(np.frombuffer(raw, np.uint8), np.cumsum(sizes)[:-1])
    edges, cells, sheets, moved = (part.reshape(width, -1) for part, width in zip(parts, COUNTED.values()))
    found = Features(
        _sum_differences(edges[:4]),
        edges[4],
        _sum_differences(cells[:4]),
        cells[4:].T.copy(),
        _sum_differences(sheets),
        _sum_differences(moved[:4]),
        moved[4:].T.copy(),
    )
    for numbers, end in (
        (found.edges, 3 * samples**3),
        (found.cells, samples**3),
        (found.sheets, samples**3),
        (found.moved, 3 * samples**3),
    ):
        if len(numbers) and ((np.diff(numbers) <= 0).any() or numbers[-1] >= end):
            raise ValueError("features are out of order, or outside the grid")
    place = np.stack(np.unravel_index(found.sheets, (samples,) * 3))
    if ((place == 0) | (place == samples - 1)).any():
        raise ValueError("walls under a voxel leave the grid")
    return found


def _differences(numbers: np.ndarray) -> np.ndarray:
    """Return the bytes (4, N) of the differences of ascending numbers, lowest first."""
    steps = np.diff(numbers, prepend=0)
    return np.stack([(steps >> shift) & 255 for shift in (0, 8, 16, 24)])


def _sum_differences(parts: np.ndarray) -> np.ndarray:
    """Invert `_differences`; (N,) int64."""
    steps = sum(part.astype(np.int64) << shift for part, shift in zip(parts, (0, 8, 16, 24)))
    return np.cumsum(steps)
