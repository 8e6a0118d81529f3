import lzma

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from solids import box

from objectfolder.mesh.gridcodec import PREDICTORS, pack_grid, unpack_grid
from objectfolder.mesh.sdf import distance_grid


def stored(values, predictor):
    """Any grid in a form of one's choice, written as the format's description has it."""
    if predictor == "planes":
        wide, out = values.astype(int), values.copy()
        for x in range(len(values)):
            p = 0 if x == 0 else wide[0] if x == 1 else np.clip(2 * wide[x - 1] - wide[x - 2], -127, 127)
            out[x] = ((wide[x] - p + 128) % 256 - 128).astype(np.int8)
        values = out
    return np.frombuffer(lzma.compress(values.tobytes()), np.uint8)


@settings(max_examples=50)
@given(st.integers(2, 7).flatmap(lambda n: arrays(np.int8, (n, n, n))))
def test_any_grid_comes_back_bit_by_bit(values):
    stream, predictor = pack_grid(values)
    np.testing.assert_array_equal(unpack_grid(stream, len(values), predictor), values)
    for name in PREDICTORS:
        np.testing.assert_array_equal(unpack_grid(stored(values, name), len(values), name), values)


def test_the_shorter_form_is_kept():
    regular, _ = distance_grid(*box((1.0, 0.6, 0.3)), 48)
    x, y, z = np.meshgrid(*[np.arange(64)] * 3, indexing="ij")
    bumps = 0.5 * np.sin(x / 1.7) * np.sin(y / 1.3) * np.sin(z / 1.9)
    rough = 50 * (np.hypot(np.hypot(x - 31.3, y - 30.9), z - 32.2) - 25 + bumps)
    rough = rough.clip(-127, 127).astype(np.int8)
    assert pack_grid(regular)[1] == "none"
    stream, predictor = pack_grid(rough)
    assert predictor == "planes"
    assert len(stream) < 0.9 * len(lzma.compress(rough.tobytes()))


@pytest.mark.parametrize("predictor", PREDICTORS)
def test_a_stream_of_another_size_is_refused_and_never_unpacked_further(predictor):
    bomb = np.frombuffer(lzma.compress(bytes(10**8)), np.uint8)
    assert len(bomb) < 20000
    with pytest.raises(ValueError, match=r"513 values or more in the grid, expected 512"):
        unpack_grid(bomb, 8, predictor)
    with pytest.raises(ValueError, match="expected 512"):
        unpack_grid(np.frombuffer(lzma.compress(bytes(511)), np.uint8), 8, predictor)
