"""Safe stand-ins for the NumPy objects of a released file, so that NumPy itself unpickles nothing.

Pickles name the functions that rebuild their objects. torch's restricted reader looks these names up in an
allow list, which maps them to the functions below; these accept only plain numbers of a stated shape.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

_KINDS = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")
_ORDERS = ("<", ">", "=", "|")


class StoredDtype:
    """Numeric type as pickled: a type code, then a state, of which only the byte order is used."""

    def __init__(self, code: Any, align: Any = False, copy: Any = True):
        code = _text(code)
        if code not in _KINDS:
            raise ValueError(f"an array of NumPy type {code!r}; expected numbers")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        order = _text(state[1])
        if order not in _ORDERS or any(part is not None for part in state[2:5]):
            raise ValueError(f"a NumPy type with state {state!r}; expected plain numbers")
        self.dtype = self.dtype.newbyteorder("=" if order == "|" else order)


class StoredArray:
    """Array as pickled: constructed empty, then filled from its state."""

    value: np.ndarray

    def __init__(self) -> None:
        self.value = np.empty(0)

    def __setstate__(self, state: Any) -> None:
        _, shape, stored, columns_first, data = state
        if not isinstance(stored, StoredDtype) or not isinstance(data, bytes | bytearray):
            raise ValueError("an array that is not numeric")
        shape = tuple(shape)
        if not all(isinstance(n, int) and n >= 0 for n in shape):
            raise ValueError(f"an array of shape {shape!r}")
        if math.prod(shape) * stored.dtype.itemsize != len(data):
            raise ValueError(f"an array of shape {shape} in {len(data)} bytes")
        flat = np.frombuffer(bytes(data), stored.dtype)
        self.value = flat.reshape(shape, order="F" if columns_first else "C")


def _reconstruct(kind: Any, shape: Any, code: Any) -> StoredArray:
    return StoredArray()


def _scalar(stored: Any, data: Any) -> int | float | bool:
    if not isinstance(stored, StoredDtype) or not isinstance(data, bytes):
        raise ValueError("a NumPy scalar that is not a number")
    return np.frombuffer(data, stored.dtype, 1)[0].item()


def _text(value: Any) -> str:
    return value.decode("latin1") if isinstance(value, bytes) else str(value)


#: Names allowed in a released file in addition to torch's: those of NumPy before and since version 2.
STAND_INS: list[Callable[..., Any] | tuple[Callable[..., Any], str]] = [
    (StoredArray, "numpy.ndarray"),
    (StoredDtype, "numpy.dtype"),
    *((_reconstruct, f"numpy.{core}.multiarray._reconstruct") for core in ("core", "_core")),
    *((_scalar, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")),
]
