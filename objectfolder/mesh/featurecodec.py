"""Features of a surface that are stored beside its distance grid, and their encoding.

The stream holds differences of ascending numbers, byte by byte, compressed.
"""

import lzma
from dataclasses import dataclass

import numpy as np

STEPS = 255  #: of a stored place along a grid edge or in a cell
MARGIN = 0.25  #: voxels by which a stored point may lie outside its cell
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6, "lc": 0, "pb": 0}]
_MEMORY = 2**28  # memory limit of the decompressor, bytes
_EDGE, _CELL = 4 + 1, 4 + 3  # bytes


@dataclass(frozen=True)
class Features:
    """Places that are stored beside a grid with R samples a side.

    Samples are numbered ``(x R + y) R + z``; a cell has the number of its lowest sample.
    """

    edges: np.ndarray  #: (E,) int64, ascending: 3 times the lower sample, plus the axis
    places: np.ndarray  #: (E,) uint8, crossing from the lower sample (0) to the upper one (255)
    cells: np.ndarray  #: (C,) int64, ascending
    points: np.ndarray  #: (C, 3) uint8, from `MARGIN` below the cell (0) to `MARGIN` above it (255)

    def __len__(self) -> int:
        return len(self.edges) + len(self.cells)

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> "Features | None":
        """Return the features stored in ``sdf.npz``, if there are any."""
        if "edges" not in arrays:
            return None
        found = cls(arrays["edges"], arrays["places"], arrays["cells"], arrays["points"])
        return found if len(found) else None


def pack_features(features: Features) -> np.ndarray:
    """Compress features to a stream, (bytes,) uint8."""
    columns = [
        *_differences(features.edges),
        features.places,
        *_differences(features.cells),
        *features.points.T,
    ]
    raw = np.concatenate(columns).astype(np.uint8).tobytes()
    return np.frombuffer(lzma.compress(raw, filters=_FILTERS), np.uint8)


def unpack_features(stream: np.ndarray, edges: int, cells: int, count: int) -> Features:
    """Return the features that `pack_features` compressed.

    Parameters
    ----------
    stream : (bytes,) uint8 array
    edges, cells : int
        How many it holds.
    count : int
        Samples of the grid along each side.

    Raises
    ------
    ValueError
        If the stream holds another number of bytes, or places that are not in order or outside the grid.
    lzma.LZMAError
        If the stream is damaged.
    """
    size = _EDGE * edges + _CELL * cells
    raw = lzma.LZMADecompressor(memlimit=_MEMORY).decompress(stream.tobytes(), size + 1)
    if len(raw) != size:
        raise ValueError(f"{len(raw)} bytes or more of features, expected {size}")
    split = np.frombuffer(raw, np.uint8)
    first, second = split[: _EDGE * edges].reshape(_EDGE, edges), split[_EDGE * edges :].reshape(_CELL, cells)
    found = Features(_summed(first[:4]), first[4], _summed(second[:4]), second[4:].T.copy())
    for numbers, end in ((found.edges, 3 * count**3), (found.cells, count**3)):
        if len(numbers) and ((np.diff(numbers) <= 0).any() or numbers[-1] >= end):
            raise ValueError("features are out of order, or outside the grid")
    return found


def _differences(numbers: np.ndarray) -> np.ndarray:
    """Return the bytes (4, N) of the differences of ascending numbers, lowest first."""
    steps = np.diff(numbers, prepend=0)
    return np.stack([(steps >> shift) & 255 for shift in (0, 8, 16, 24)])


def _summed(parts: np.ndarray) -> np.ndarray:
    """Invert `_differences`; (N,) int64."""
    steps = sum(part.astype(np.int64) << shift for part, shift in zip(parts, (0, 8, 16, 24)))
    return np.cumsum(steps)
