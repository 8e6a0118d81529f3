"""Scores of an Object File's sounds against held-out modes and strikes (supplementary F, Table 2)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.base.metrics import SpectrogramErrors, gain_errors
from objectfolder.sound.gains_net import energy_weights
from objectfolder.sound.query import SoundQueries
from objectfolder.sound.spectrogram import SAMPLE_RATE, spectrogram
from objectfolder.sound.synthesis import gains, is_audible, sinusoid_bank
from objectfolder.stored.surface import ANYWHERE

BATCH = 16  # sounds per spectrogram batch


@dataclass(frozen=True)
class UnitStrikes:
    """Unit impulses at surface points whose true modes are known."""

    rows: np.ndarray  #: (N,) indices of the points
    impulses: np.ndarray  #: (N, 3) N s

    @classmethod
    def random(cls, rows: np.ndarray, count: int, rng: np.random.Generator) -> "UnitStrikes":
        """Draw strikes at random points of ``rows``, in random directions."""
        impulses = rng.normal(size=(count, 3))
        impulses /= np.linalg.norm(impulses, axis=1, keepdims=True)
        return cls(rows[rng.integers(len(rows), size=count)], impulses)

    def __getitem__(self, index: slice) -> "UnitStrikes":
        """Return a slice of the strikes."""
        return UnitStrikes(self.rows[index], self.impulses[index])

    def describe(self, points: np.ndarray) -> list[str]:
        """Label each strike with its point and direction; points (P, 3) are metres."""
        return [
            f"at ({', '.join(f'{x:.1f}' for x in points[row] * 1000)}) mm\n"
            f"towards ({', '.join(f'{x:.2f}' for x in impulse)})"
            for row, impulse in zip(self.rows, self.impulses)
        ]


@dataclass(frozen=True)
class SoundTruth:
    """What an Object File's sounds are compared with."""

    modes: dict[str, np.ndarray]  #: contents of ``modes.npz``
    report: dict[str, Any]  #: contents of ``modal.json``
    strikes: UnitStrikes  #: whose spectrograms are scored
    rng: np.random.Generator  #: of the noise that is a baseline


def evaluate_sound(file: SoundQueries, truth: SoundTruth) -> dict[str, Any]:
    """Score gains at held-out surface points, and spectrograms of strikes; count the modes left out.

    ``uncertain`` says that the truth itself is marked so.

    Raises ObjectFolderError if the Object File was made from other modes.
    """
    modes = truth.modes
    gained = score_gains(file, modes, np.flatnonzero(modes["split"] == 2)) if file.has_modes else {}
    heard = score_spectrograms(file, modes, truth.strikes, truth.rng)
    marked = {"uncertain": True} if truth.report.get("uncertain") else {}
    return gained | heard | count_lost_modes(modes, truth.report) | marked


def score_gains(file: SoundQueries, modes: dict[str, np.ndarray], rows: np.ndarray) -> dict[str, Any]:
    """Score gains at held-out surface points, and frequencies and decay times, which are stored, not learned.

    ``baseline_nearest`` is the ``gain_error`` of the true mode shapes at the nearest training point.

    Raises ObjectFolderError if the Object File was made from other modes.
    """
    damped, damping = modes["damped_frequency"], modes["damping"]
    if len(file.frequencies) != len(damping):
        raise ObjectFolderError(
            f"{file.key}: the Object File holds {len(file.frequencies)} modes, modes.npz {len(damping)}; "
            f"run `objectfolder build {file.key}`"
        )
    if len(damping) == 0:
        return {}
    true_shapes, weights = modes["shapes"][rows].astype(np.float64), energy_weights(damped, damping)

    def errors_of(shapes: np.ndarray) -> dict[str, float]:
        return gain_errors(shapes.astype(np.float64), true_shapes, weights, 1 / damped)

    scores = errors_of(file.mode_shapes(modes["points"][rows] * file.scale, ANYWHERE))
    training = np.flatnonzero(modes["split"] == 0)
    near = training[cKDTree(modes["points"][training]).query(modes["points"][rows])[1]]
    stored = file.tuning()
    return scores | {
        "baseline_nearest": errors_of(modes["shapes"][near])["gain_error"],
        "worst_mode_hz": float(damped[int(scores.pop("worst_mode"))] / (2 * np.pi)),
        "frequency_error": float(np.abs(stored.damped_frequency.numpy() / damped - 1).max()),
        "decay_time_error": float(np.abs(damping / stored.damping.numpy() - 1).max()),
        "points": len(rows),
    }


def score_spectrograms(
    file: SoundQueries, modes: dict[str, np.ndarray], strikes: UnitStrikes, rng: np.random.Generator
) -> dict[str, Any]:
    """Score spectrograms of strikes as defined by `SpectrogramErrors`.

    The baselines are silence, and white Gaussian noise with the energy of each true sound.
    """
    frequency = torch.from_numpy(modes["damped_frequency"])
    heard = int(is_audible(frequency, SAMPLE_RATE).sum())
    counts = {"modes": len(frequency), "modes_heard": heard, "impacts": len(strikes.rows)}
    if heard == 0:
        return counts
    errors, noise_errors = SpectrogramErrors(), SpectrogramErrors()
    for sounds in zip(*(torch.from_numpy(s).split(BATCH) for s in compare_sounds(file, modes, strikes))):
        truth, answer, noise = (spectrogram(s) for s in (*sounds, draw_noise(sounds[0], rng)))
        errors.add(answer, truth)
        noise_errors.add(noise, truth)
    noise_scores = noise_errors.scores()
    return counts | errors.scores() | ({"baseline_noise": noise_scores["psnr"]} if noise_scores else {})


def count_lost_modes(modes: dict[str, np.ndarray], report: dict[str, Any]) -> dict[str, Any]:
    """Count the modes that were found but not solved, and estimate their energy; empty if none were counted.

    ``lost_energy`` is the share of the energy of unit impulses' sounds, with all modes below the frequency to
    which they were counted; see `lost_energy`. The report is ``modal.json``.
    """
    found = report["count_below_max_frequency"]
    if found is None:
        return {}
    stuff = Material(report["material"], **report["material_properties"])
    kept, limit = modes["damped_frequency"], report["max_frequency_hz"]
    lost = lost_energy(modes["shapes"], kept, stuff, found, limit) if report["truncated"] else 0.0
    return {"modes_found": found, "lost_energy": lost}


def draw_noise(sounds: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    """Draw white Gaussian noise with the energy of each sound; (N, samples)."""
    noise = torch.from_numpy(rng.standard_normal(sounds.shape)).to(sounds.dtype)
    # Norms rather than energies: squares of micrometres per newton second underflow.
    return noise * (sounds.double().norm(dim=1) / noise.double().norm(dim=1)).to(sounds.dtype)[:, None]


def compare_sounds(
    file: SoundQueries, modes: dict[str, np.ndarray], strikes: UnitStrikes, sample_rate: int = SAMPLE_RATE
) -> tuple[np.ndarray, np.ndarray]:
    """Return true sounds of strikes and the Object File's; both (N, samples).

    The strikes are ideal impulses, which excite all modes alike.
    """
    tuning = torch.from_numpy(modes["damped_frequency"]), torch.from_numpy(modes["damping"])
    bank = sinusoid_bank(*tuning, sample_rate)
    shapes = torch.from_numpy(modes["shapes"][strikes.rows]).float()
    truth = gains(shapes, torch.from_numpy(strikes.impulses).float()) @ bank
    points = modes["points"][strikes.rows] * file.scale
    answer = file.impact(points, strikes.impulses, sample_rate, contact_time=0.0, tolerance=ANYWHERE)
    return truth.numpy(), answer


def lost_energy(
    shapes: np.ndarray, damped_frequency: np.ndarray, material: Material, found: int, max_frequency: float
) -> float:
    """Estimate the share of the energy of impulses' sounds that modes beyond the kept ones carry.

    The lost modes are taken to lie at equal steps between the last kept one and the frequency (Hz) to which
    ``found`` modes were counted, to move the surface as the upper half of the kept ones do, and to be damped
    as the material. Kept modes have shapes (P, 3, M), kg^-1/2, and damped frequencies (M,), ascending, rad/s.
    """
    kept = len(damped_frequency)
    if found <= kept or kept == 0:
        return 0.0
    low, high = damped_frequency[-1], 2 * np.pi * max_frequency
    angular = np.linspace(low, high, found - kept + 2)[1:-1]
    moved = np.square(shapes, dtype=np.float64).mean((0, 1))
    lost = moved[kept // 2 :].mean() * energy_weights(angular, material.damping(angular**2)).sum()
    heard = moved @ energy_weights(damped_frequency, material.damping(damped_frequency**2))
    return float(lost / (lost + heard))
