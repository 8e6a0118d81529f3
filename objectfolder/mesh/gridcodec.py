"""Encoding of the distance grid: quantisation to int8, and lossless compression.

LZMA compresses either the grid itself (better for designed objects) or its prediction residuals (better for
scans); the shorter stream is kept.
"""

import lzma

import numpy as np

BOUND = 0.52  #: the grid spans [-BOUND, BOUND]^3 of the unit frame
BAND_VOXELS = 2.5  #: distances are clipped to this many voxels
LEAST_BAND = 0.0102  #: or to this, unit frame, if it is more: contact normals reach 0.01
#: Prediction subtracted before compression: none, or linear extrapolation of the two preceding x planes.
PREDICTORS = ("none", "planes")

_MEMORY = 2**28  # memory limit of the decompressor, bytes
# Residuals have no text-like context (lc) or alignment (pb).
_FILTERS: dict[str, dict[str, int]] = {"none": {}, "planes": {"lc": 0, "pb": 0}}
EFFORT = 6  #: preset of LZMA


def quantise(distance: np.ndarray, band: float) -> np.ndarray:
    """Quantise signed distances to int8; 127 is the band."""
    return np.clip(np.rint(distance * (127 / band)), -127, 127).astype(np.int8)


def band_width(resolution: int) -> float:
    """Return the distance at which a grid of this resolution is clipped."""
    return max(BAND_VOXELS * 2 * BOUND / (resolution - 1), LEAST_BAND)


def enclosing_box(marked: np.ndarray) -> list[slice]:
    """Return the box of a grid's marked samples and one beyond on each side; all if none is."""
    sides = []
    for axis, count in enumerate(marked.shape):
        found = np.flatnonzero(marked.any(tuple({0, 1, 2} - {axis})))
        first, last = (int(found[0]), int(found[-1])) if len(found) else (0, count - 1)
        sides.append(slice(max(first - 1, 0), min(last + 2, count)))
    return sides


def pack_grid(values: np.ndarray, effort: int = EFFORT) -> tuple[np.ndarray, str]:
    """Compress a grid (R, R, R) int8, -127 to 127; return the stream, uint8, and its predictor.

    An ``effort`` of 0, for what is not stored, takes a tenth of the time.
    """
    forms = {"none": values, "planes": _residuals(values)}
    streams = {
        name: lzma.compress(
            form.tobytes(), filters=[{"id": lzma.FILTER_LZMA2, "preset": effort, **_FILTERS[name]}]
        )
        for name, form in forms.items()
    }
    shortest = min(PREDICTORS, key=lambda name: len(streams[name]))
    return np.frombuffer(streams[shortest], np.uint8), shortest


def unpack_grid(stream: np.ndarray, resolution: int, predictor: str) -> np.ndarray:
    """Return the (R, R, R) int8 grid that `pack_grid` compressed.

    Raises ``ValueError`` if the stream holds another number of values, of which at most one too many is
    unpacked, and ``lzma.LZMAError`` if it is damaged.
    """
    size = resolution**3
    raw = lzma.LZMADecompressor(memlimit=_MEMORY).decompress(stream.tobytes(), size + 1)
    if len(raw) != size:
        raise ValueError(f"{len(raw)} values or more in the grid, expected {size}")
    values = np.frombuffer(raw, np.int8).reshape((resolution,) * 3)
    return values if predictor == "none" else _restore(values)


def _residuals(values: np.ndarray) -> np.ndarray:
    """Subtract the prediction from the values, modulo 256."""
    wide = values.astype(np.int16)
    predicted = np.zeros_like(wide)
    predicted[1] = wide[0]
    predicted[2:] = (2 * wide[1:-1] - wide[:-2]).clip(-127, 127)
    return (wide - predicted).astype(np.int8)


def _restore(residuals: np.ndarray) -> np.ndarray:
    """Inverse of `_residuals`."""
    values = np.empty_like(residuals)
    before = last = np.zeros(residuals.shape[1:], np.int16)
    for i, residual in enumerate(residuals):
        predicted = last if i < 2 else (2 * last - before).clip(-127, 127)
        values[i] = (predicted + residual).astype(np.int8)
        before, last = last, values[i].astype(np.int16)
    return values
