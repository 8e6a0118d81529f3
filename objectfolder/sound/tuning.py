"""Modes of an object of another material or size, derived from the stored modes."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch

from objectfolder.base.checks import finite_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.sound.fem.similarity import similarity

HEARING_HZ = (20.0, 20000.0)
SIZES = (1e-12, 1e6)  #: longest sides, metres; those of objectfile.schema.json


@dataclass(frozen=True)
class Tuning:
    """Modes of an object, and their known gaps and errors."""

    modes: torch.Tensor  #: (M,) int, rows of the stored modes
    damped_frequency: torch.Tensor  #: (M,) angular, rad/s
    damping: torch.Tensor  #: (M,) decay rates, 1/s
    shape_factor: float = 1.0  #: multiplies the stored mode shapes
    complete_hz: tuple[float, float] = (0.0, math.inf)  #: band without missing modes
    #: Bounds on the ratio of true to given natural frequencies; not 1 if Poisson's ratio differs.
    frequency_bounds: tuple[float, float] = (1.0, 1.0)
    notes: tuple[str, ...] = ()  #: gaps and approximations, for people

    @property
    def frequencies(self) -> torch.Tensor:
        """Damped frequencies, Hz; (M,)."""
        return self.damped_frequency / (2 * math.pi)


def stored_modes(
    damped_frequency: torch.Tensor, damping: torch.Tensor, band_hz: tuple[float, float] = (0.0, math.inf)
) -> Tuning:
    """Return the stored modes unchanged; see `retune` for the arguments."""
    notes = tuple(_missing_above(band_hz[1]))
    return Tuning(torch.arange(len(damping)), damped_frequency, damping, complete_hz=band_hz, notes=notes)


def retune(
    damped_frequency: torch.Tensor,
    damping: torch.Tensor,
    band_hz: tuple[float, float],
    stored: tuple[Material, float],
    wanted: tuple[Material, float],
) -> Tuning:
    """Compute the modes of an object of another material or size.

    Modes that leave the range of hearing, 20 Hz to 20 kHz or to the end of the solved band if it is higher,
    or become overdamped are dropped, as in a solve. A softer or larger object has audible modes that lay
    above the solved band and are missing.

    Damped frequencies (M,), rad/s, and decay rates (M,), 1/s, are those of the stored modes, which are
    complete in a band of natural frequencies. An object is a material and its longest side in metres; those
    of the wanted one may be tensors with gradients. Raises ObjectFolderError if the size is outside `SIZES`,
    or the material so extreme that numbers overflow.
    """
    (old, _), (new, new_scale) = stored, wanted
    low, high = SIZES
    if not low <= finite_number("scale", new_scale) <= high:
        raise ObjectFolderError(
            f"scale is {new_scale!r}, expected the object's longest side in metres, {low:g} to {high:g}"
        )
    try:
        factor, shape_factor = similarity(stored, wanted)
    except (OverflowError, ZeroDivisionError):
        factor = shape_factor = math.inf
    if not (0 < factor < math.inf and shape_factor < math.inf):
        raise ObjectFolderError(
            f"{new} of {new_scale:g} m: its modes are beyond the range of numbers; check its properties"
        )
    w, c = damped_frequency.double(), damping.double()
    eigenvalues = (w * w + c * c) * factor
    c = new.damping(eigenvalues)
    low, high = ((2 * math.pi * hertz) ** 2 for hertz in (HEARING_HZ[0], max(HEARING_HZ[1], band_hz[1])))
    kept = torch.nonzero((eigenvalues > c * c) & (eigenvalues > low) & (eigenvalues < high))[:, 0]
    complete = (band_hz[0] * factor**0.5, band_hz[1] * factor**0.5)
    bounds = _poisson_bounds(old.poisson_ratio, new.poisson_ratio)
    notes = tuple(_notes(complete, old, new, bounds))
    w = (eigenvalues - c * c)[kept].sqrt()
    return Tuning(kept, w, c[kept], shape_factor, complete, bounds, notes)


def _poisson_bounds(old: float, new: float) -> tuple[float, float]:
    """Bound the factor by which natural frequencies change when only Poisson's ratio does.

    The elasticity tensor has eigenvalues E / (1 + nu) and E / (1 - 2 nu). The strain energy of any motion
    changes by a factor between theirs, and so, by Rayleigh's principle, does every eigenvalue.
    """
    shear, bulk = (1 + old) / (1 + new), (1 - 2 * old) / (1 - 2 * new)
    return math.sqrt(min(shear, bulk)), math.sqrt(max(shear, bulk))


def _notes(
    complete: tuple[float, float], old: Material, new: Material, bounds: tuple[float, float]
) -> Iterator[str]:
    """Describe the gaps and approximations of retuned modes."""
    low = HEARING_HZ[0]
    if old.poisson_ratio != new.poisson_ratio:
        yield (
            f"approximate: the modes were solved for {old.name} with Poisson ratio {old.poisson_ratio:g}, "
            f"{new.name} has {new.poisson_ratio:g}; true frequencies are {bounds[0]:.3f} to {bounds[1]:.3f} "
            f"times these; build the object with material {new.name} to solve it exactly"
        )
    yield from _missing_above(complete[1])
    if complete[0] > low * (1 + 1e-6):
        yield (
            f"incomplete: modes from {low:.0f} to {complete[0]:.0f} Hz were below the band that was solved "
            "and are not stored; build the object with this material and scale to hear them"
        )


def _missing_above(top: float) -> Iterator[str]:
    """Describe the gap between the end of the solved band and that of hearing, Hz."""
    high = HEARING_HZ[1]
    # The solved band may end at 20 kHz itself; do not report rounding, of single precision, as a gap.
    if top < high * (1 - 1e-6):
        yield (
            f"incomplete: modes from {top:.0f} to {high:.0f} Hz were above the band that was solved and are "
            "not stored; build the object with this material and scale, and modal.max_modes and "
            "modal.max_frequency high enough, to hear them"
        )
