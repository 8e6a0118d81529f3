"""Fit of a material to recordings of taps: one factor of stiffness and a damping model."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, linear_sum_assignment

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material, material, own_material
from objectfolder.sound.ringdown import LN_1000, MIN_TAP_LENGTH, RISE, Ringdown, ringdown, strikes

RATIOS = (0.8, 1.25)  # of heard to computed frequencies that are tried
STEP = 5e-4  # between them
TOLERANCE = 0.01  # relative distance of a heard frequency from its mode
MIN_MATCHES = 3
MODES_PER_KNOT = 4  # of a loss factor over frequency
MAX_KNOTS = 4
ECHO = 0.003  #: unexplained energy; clean rings have a tenth of it, echoes at a tenth of the level as much


@dataclass(frozen=True)
class Match:
    """Heard modes beside the computed ones that they belong to; arrays share (K,)."""

    computed: np.ndarray  #: rows of the computed modes
    heard: np.ndarray  #: rows of the heard modes
    residual: np.ndarray  #: relative frequency errors that are left after the fit
    ratio: float  #: of heard to computed frequencies: square root of the factor of stiffness
    rival: float  #: score of the next best ratio over that of the best; near 1, the match is a guess

    @property
    def stiffness(self) -> float:
        """Factor of Young's modulus."""
        return self.ratio**2


def match_modes(computed: np.ndarray, heard: np.ndarray) -> Match:
    """Match heard frequencies to computed ones up to a common ratio; (K,) and (M,), Hz, ascending.

    For each ratio, heard and computed modes are paired one to one, so that the sum of squared distances, none
    above the tolerance, is the least. The ratio with the most pairs, and the closest, is refined by the
    median of its pairs. Raises ObjectFolderError if fewer than three modes match.
    """
    if not len(computed) or not len(heard):
        raise ObjectFolderError(
            f"nothing to match: the object has {len(computed)} modes, the recordings {len(heard)}; check "
            "that they are of this object, or record other taps"
        )
    far = np.log(heard)[:, None] - np.log(computed)[None]
    ratios = np.exp(np.arange(np.log(RATIOS[0]), np.log(RATIOS[1]), STEP))
    scores = np.array([_pairs(far - shift)[2] for shift in np.log(ratios)])
    best = int(scores.argmax())
    apart = np.abs(np.log(ratios / ratios[best])) > 2 * TOLERANCE
    shift = np.log(ratios[best])
    for _ in range(5):
        rows, columns, _ = _pairs(far - shift)
        if len(rows) < MIN_MATCHES:
            break
        shift = float(np.median(far[rows, columns]))
    if len(rows) < MIN_MATCHES:
        raise ObjectFolderError(
            f"only {len(rows)} of {len(heard)} heard modes are within {TOLERANCE:.0%} of a computed one at "
            f"any stiffness, expected at least {MIN_MATCHES}: check that the recordings are of this object, "
            "and its size and material"
        )
    residual = np.expm1(far[rows, columns] - shift)
    rival = float(scores[apart].max(initial=0) / scores[best])
    return Match(columns, rows, residual, float(np.exp(shift)), rival)


def _pairs(far: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Pair rows and columns one to one; return those within the tolerance, and the score."""
    cost = np.minimum((far / TOLERANCE) ** 2, 1)
    rows, columns = linear_sum_assignment(cost)
    near = cost[rows, columns] < 1
    return rows[near], columns[near], float((1 - cost[rows, columns]).sum())


def fit_loss_factor(heard: Ringdown) -> tuple[tuple[float, float], ...]:
    """Fit a piecewise linear loss factor to heard decay rates, eta = c / (pi f); (Hz, eta) at its knots.

    Logarithms of decay times are fitted with a robust loss: one of a pair of modes may be heard badly. Knots
    divide the modes evenly.
    """
    loss = heard.damping / (np.pi * heard.frequency)
    count = min(MAX_KNOTS, max(1, len(loss) // MODES_PER_KNOT))
    knots = np.unique(np.quantile(heard.frequency, np.linspace(0, 1, count) if count > 1 else 0.5).round(1))
    values = _robust(
        lambda p: np.interp(heard.frequency, knots, np.exp(p)) / loss, np.full(len(knots), np.median(loss))
    )
    return tuple((float(hertz), float(f"{value:.4g}")) for hertz, value in zip(knots, values))


def fit_rayleigh(heard: Ringdown) -> tuple[float, float]:
    """Fit alpha and beta to heard decay rates, c = (alpha + beta w^2) / 2; otherwise as `fit_loss_factor`."""
    square = (2 * np.pi * heard.frequency) ** 2
    start = np.median(heard.damping) * np.array([1.0, 1 / np.median(square)])
    alpha, beta = _robust(lambda p: (np.exp(p[0]) + np.exp(p[1]) * square) / (2 * heard.damping), start)
    return float(f"{alpha:.4g}"), float(f"{beta:.4g}")


def _robust(ratio: Callable[[np.ndarray], np.ndarray], start: np.ndarray) -> np.ndarray:
    """Return positive parameters, given by their logarithms, for which ratios are near 1."""
    return np.exp(least_squares(lambda p: np.log(ratio(p)), np.log(start), loss="soft_l1", f_scale=0.1).x)


@dataclass(frozen=True)
class SoundFit:
    """A material fitted to recordings, and how well it fits."""

    material: dict[str, object]  #: entry of ``params.yaml``: base and the fitted properties
    match: Match
    heard: Ringdown  #: all modes in the recordings
    decay_time: np.ndarray  #: T60 by the fitted law of the matched modes, s; (K,)
    taps: list[int]  #: number of strikes in each recording

    @property
    def frequency_error(self) -> float:
        """Root mean square of the relative frequency errors that are left."""
        return float(np.sqrt(np.mean(self.match.residual**2)))

    @property
    def unexplained(self) -> float:
        """Median fraction of the energy around the matched modes that no decaying exponentials hold.

        Above `ECHO` the decay is not that of the object alone: the fitted T60 is wrong.
        """
        return float(np.median(self.heard.unexplained[self.match.heard]))

    @property
    def left_out(self) -> np.ndarray:
        """Rows of heard modes without a computed one."""
        return np.setdiff1d(np.arange(len(self.heard.frequency)), self.match.heard)


def fit_sound(
    computed: np.ndarray, solid: Material, sounds: Sequence[np.ndarray], rate: float, law: str
) -> SoundFit:
    """Fit stiffness and damping of an object's material to recordings of taps on it.

    Computed natural frequencies (M,), Hz, are those of the solid's material. Recordings (samples,) have one
    rate, Hz, and each one tap or more. The law is "loss_factor" or "rayleigh". Raises ObjectFolderError if
    there is no tap, or fewer than three modes match.
    """
    cut = [strikes(sound, rate) for sound in sounds]
    taps = [tap for found in cut for tap in found]
    if not taps:
        rise = 10 * np.log10(RISE)
        raise ObjectFolderError(
            f"no strike in the recordings: nothing rises {rise:.0f} dB within a millisecond, and rings for "
            f"{MIN_TAP_LENGTH:g} s; record taps louder, or with less noise"
        )
    heard = ringdown(taps, rate, highest=RATIOS[1] * float(computed.max(initial=0)))
    match = match_modes(computed, heard.frequency)
    matched = Ringdown(*(array[match.heard] for array in vars(heard).values()))
    base = material(solid.name)
    fitted: dict[str, object] = {
        "base": solid.name,
        "youngs_modulus": float(f"{solid.youngs_modulus * match.stiffness:.5g}"),
    }
    for own in ("density", "poisson_ratio"):
        if getattr(solid, own) != getattr(base, own):
            fitted[own] = getattr(solid, own)
    if law == "loss_factor":
        fitted["loss_factor"] = [list(knot) for knot in fit_loss_factor(matched)]
    else:
        fitted["alpha"], fitted["beta"] = fit_rayleigh(matched)
    damping = own_material(fitted).damping((2 * np.pi * matched.frequency) ** 2)
    return SoundFit(fitted, match, heard, LN_1000 / damping, [len(found) for found in cut])
