"""Far fields of modes: stored in few bytes, and heard at a place."""

import lzma
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from objectfolder.sound.radiation.harmonics import degrees, outgoing, real_harmonics

MAX_ORDER = 31  #: of spherical harmonics; a field of more detail keeps its power, but not the detail
#: Codes up to a greatest one, and the greatest order, from fine to coarse.
_STEPS = ((127, 31), (63, 31), (31, 31), (31, 23), (15, 23), (15, 15), (15, 11), (15, 7), (7, 5), (7, 3))
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6, "lc": 0, "pb": 0}]
_MEMORY = 1 << 26  # bytes that unpacking may use


@dataclass(frozen=True)
class FarField:
    """Spherical harmonics (`objectfolder.sound.radiation.harmonics`) of the sound of each mode."""

    orders: np.ndarray  #: (M,) int, highest degree of each mode
    coefficients: np.ndarray  #: (M, H) complex, 0 beyond the order; per unit of modal acceleration
    radius: float  #: of the ball about the origin that holds the surface, metres

    def pressure(self, wavenumbers: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return the pressure per unit of modal acceleration at places outside the ball; (N, M) complex128.

        Phasors of exp(-i w t), Pa / (m kg^1/2 / s^2), as of waves that leave the ball at once: the phase of
        the path from the ball to the place is left out. Wavenumbers (M,) are in 1/m, places (N, 3) in metres.
        """
        distance = np.linalg.norm(places, axis=1)
        order = int(np.sqrt(self.coefficients.shape[1])) - 1
        harmonics = real_harmonics(places / distance[:, None], order)
        waves = outgoing(order, distance[:, None] * wavenumbers)
        sums = np.empty((order + 1, len(places), 2 * len(wavenumbers)))
        for degree, out in enumerate(sums):
            part = slice(degree**2, (degree + 1) ** 2)
            np.matmul(harmonics[:, part], self._columns[part], out=out)
        found = (waves * sums.view(np.complex128)).sum(0)
        return found * np.exp(1j * wavenumbers * self.radius) / distance[:, None]

    @cached_property
    def _columns(self) -> np.ndarray:
        """Coefficients, (H, 2 M): real numbers, so that harmonics need not become complex."""
        return np.ascontiguousarray(self.coefficients.T, np.complex128).view(np.float64)

    def of(self, modes: np.ndarray) -> "FarField":
        """Return the field of some of the modes."""
        return FarField(self.orders[modes], self.coefficients[modes], self.radius)

    def truncate(self, order: int) -> "FarField":
        """Return the field with degrees up to an order, at equal power."""
        kept = self.coefficients[:, : (order + 1) ** 2]
        power, left = ((abs(each) ** 2).sum(1) for each in (self.coefficients, kept))
        gain = np.sqrt(np.divide(power, left, out=np.ones_like(power), where=left > 0))
        return FarField(np.minimum(self.orders, order), kept * gain[:, None], self.radius)


def pack_far_field(field: FarField, limit: int) -> dict[str, np.ndarray]:
    """Store a far field in at most about so many bytes.

    As ``orders`` (M,) uint8, ``steps`` (M,) float32, and ``coefficients``, an xz stream of int8: of each mode
    the real parts of its harmonics, then the imaginary ones, over the mode's step.
    """
    for codes, order in _STEPS:
        less = field.truncate(order) if order < field.orders.max(initial=0) else field
        packed = _packed(less, codes)
        if len(packed["coefficients"]) + 5 * len(field.orders) <= limit:
            break
    return packed


def unpack_far_field(tensors: dict[str, np.ndarray], radius: float) -> FarField:
    """Return what `pack_far_field` stored.

    Raises ValueError if sizes do not fit, lzma.LZMAError if the stream is not one.
    """
    orders, steps = tensors["orders"].astype(np.int64), tensors["steps"].astype(np.float64)
    if orders.ndim != 1 or steps.shape != orders.shape or orders.max(initial=0) > MAX_ORDER:
        raise ValueError(f"orders of shape {orders.shape} and steps of shape {steps.shape}")
    sizes = (orders + 1) ** 2
    total = 2 * int(sizes.sum())
    unpacker = lzma.LZMADecompressor(memlimit=_MEMORY)
    raw = unpacker.decompress(tensors["coefficients"].tobytes(), total + 1)
    if len(raw) != total:
        raise ValueError(f"{len(raw)} coefficients, expected {total}")
    codes, start = np.frombuffer(raw, np.int8), 0
    out = np.zeros((len(orders), int(sizes.max(initial=1))), np.complex128)
    for row, size, step in zip(out, sizes, steps):
        real, imaginary = codes[start : start + 2 * size].reshape(2, size)
        row[:size] = step * (real + 1j * imaginary)
        start += 2 * size
    return FarField(orders, out, radius)


def _packed(field: FarField, codes: int) -> dict[str, np.ndarray]:
    values = field.coefficients
    largest = np.maximum(abs(values.real).max(1, initial=0), abs(values.imag).max(1, initial=0))
    steps = np.where(largest > 0, largest / codes, 1).astype(np.float32)
    rounded = np.rint(np.stack([values.real, values.imag]) / steps[:, None]).astype(np.int8)
    of_degree = degrees(int(np.sqrt(values.shape[1])) - 1)
    kept = [rounded[:, mode, of_degree <= order].tobytes() for mode, order in enumerate(field.orders)]
    stream = lzma.compress(b"".join(kept), filters=_FILTERS)
    coefficients = np.frombuffer(stream, np.uint8)
    return {"orders": field.orders.astype(np.uint8), "steps": steps, "coefficients": coefficients}
