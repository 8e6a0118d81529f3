"""Scores of an Object File against held-out ground truth, with baselines (supplementary F, Table 2)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from objectfolder.audio.spectrogram import SAMPLE_RATE, spectrogram
from objectfolder.audio.synthesis import gains, is_audible, sinusoid_bank
from objectfolder.errors import ObjectFolderError
from objectfolder.materials import Material
from objectfolder.metrics import SpectrogramErrors, gain_errors, psnr, ssim
from objectfolder.nets.audio_gains import energy_weights
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.truncation import lost_energy
from objectfolder.vision.cameras import image_intrinsics
from objectfolder.vision.color import find_lit_foreground, on_white

BATCH = 16  # sounds per spectrogram batch
MIN_PIXELS = 50  #: contact pixels that a touch needs to count in ``psnr_contact``


def evaluate_vision(view: Callable[..., np.ndarray], views: dict[str, np.ndarray]) -> dict[str, Any]:
    """Compute PSNR and SSIM of held-out views, in sRGB on white.

    Half of all views are nearly unlit on a white background, so the lit foreground is also scored on its own:
    pixels that the object covers fully and whose true radiance exceeds 1 % of white. The views themselves
    are noisy: ``noise_floor`` and ``noise_floor_lit`` are the ``psnr`` and ``psnr_lit_foreground`` of a
    perfect answer, given if the views contain their noise.

    Parameters
    ----------
    view : callable
        Called like `ObjectFile.view`.
    views : dict
        Contents of ``views/test.npz``.
    """
    errors, white, similarity, lit_errors = [], [], [], []
    for rgba, pose, light, intrinsics in zip(
        views["rgba"].astype(np.float32), views["camera_to_world"], views["light"], image_intrinsics(views)
    ):
        truth = on_white(torch.from_numpy(rgba)).numpy()
        image = view(pose, light, intrinsics=intrinsics)[0]
        squared = (image - truth) ** 2
        errors.append(squared.mean())
        white.append(((1 - truth) ** 2).mean())
        similarity.append(ssim(image, truth))
        lit_errors.append(squared[find_lit_foreground(rgba)].ravel())
    scores = {
        "psnr": float(np.mean(psnr(np.array(errors)))),
        "psnr_pooled": float(psnr(np.mean(errors))),
        "psnr_worst": float(psnr(np.max(errors))),
        "ssim": float(np.mean(similarity)),
        "baseline_white": float(np.mean(psnr(np.array(white)))),
        "views": len(errors),
    }
    order = np.argsort(errors, kind="stable").tolist()
    scores |= {"best_view": order[0], "median_view": order[len(order) // 2], "worst_view": order[-1]}
    lit_error = np.concatenate(lit_errors)
    if lit_error.size:
        scores["psnr_lit_foreground"] = float(psnr(lit_error.mean()))
    if "noise" in views:
        noise, lit_noise = views["noise"].T
        scores["noise_floor"] = float(np.mean(psnr(noise)))
        if lit_error.size:
            pixels = [len(lit) for lit in lit_errors]
            scores["noise_floor_lit"] = float(psnr(np.average(lit_noise, weights=pixels)))
    return scores


def shown_views(scores: dict[str, Any], count: int) -> dict[int, str]:
    """Choose views for a contact sheet: the worst, the median and the best, and others at equal steps.

    Parameters
    ----------
    scores : dict
        Result of `evaluate_vision`.
    count : int
        Largest number of views.

    Returns
    -------
    dict
        Title of each view by its index.
    """
    named = {scores[f"{name}_view"]: name for name in ("best", "median", "worst")}
    others = [i for i in range(scores["views"]) if i not in named]
    step = np.linspace(0, len(others) - 1, min(max(count - len(named), 0), len(others)))
    chosen = {row: f"{named[row]}: view {row + 1}" for row in reversed(named)}
    return chosen | {others[int(i)]: f"view {others[int(i)] + 1}" for i in step}


def view_answers(
    file: ObjectFile, views: dict[str, np.ndarray], rows: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return true held-out whole views and the Object File's; both (N, H, W, 3), sRGB on white."""
    rgba = views["rgba"][rows].astype(np.float32)
    whole = image_intrinsics(views)[0]
    answers = file.view(views["camera_to_world"][rows], views["light"][rows], intrinsics=whole)
    return on_white(torch.from_numpy(rgba)).numpy(), answers


@dataclass(frozen=True)
class Strikes:
    """Unit impulses at surface points whose true modes are known."""

    rows: np.ndarray  #: (N,) indices of the points
    impulses: np.ndarray  #: (N, 3) N s

    @classmethod
    def random(cls, rows: np.ndarray, count: int, rng: np.random.Generator) -> "Strikes":
        """Draw strikes at random points of ``rows``, in random directions."""
        impulses = rng.normal(size=(count, 3))
        impulses /= np.linalg.norm(impulses, axis=1, keepdims=True)
        return cls(rows[rng.integers(len(rows), size=count)], impulses)

    def __getitem__(self, index: slice) -> "Strikes":
        """Return a slice of the strikes."""
        return Strikes(self.rows[index], self.impulses[index])

    def titles(self, points: np.ndarray) -> list[str]:
        """Label each strike with its point and direction; points (P, 3) are metres."""
        return [
            f"at ({', '.join(f'{x:.1f}' for x in points[row] * 1000)}) mm\n"
            f"towards ({', '.join(f'{x:.2f}' for x in impulse)})"
            for row, impulse in zip(self.rows, self.impulses)
        ]


def evaluate_gains(file: ObjectFile, modes: dict[str, np.ndarray], rows: np.ndarray) -> dict[str, Any]:
    """Score gains at held-out surface points, and frequencies and decay times, which are stored, not learned.

    ``baseline_nearest`` is the ``gain_error`` of the true mode shapes at the nearest training point.

    Raises
    ------
    ObjectFolderError
        If the Object File was made from other modes.
    """
    damped, damping = modes["damped_frequency"], modes["damping"]
    if len(file.frequencies) != len(damping):
        raise ObjectFolderError(
            f"{file.key}: the Object File holds {len(file.frequencies)} modes, modes.npz {len(damping)}; "
            f"run `objectfolder build {file.key}`"
        )
    if len(damping) == 0:
        return {}
    predicted = file.mode_shapes(modes["points"][rows] * file.scale).astype(np.float64)
    true_shapes = modes["shapes"][rows].astype(np.float64)
    scores = gain_errors(predicted, true_shapes, energy_weights(damped, damping), 1 / damped)
    training = np.flatnonzero(modes["split"] == 0)
    near = training[cKDTree(modes["points"][training]).query(modes["points"][rows])[1]]
    nearest = gain_errors(
        modes["shapes"][near].astype(np.float64), true_shapes, energy_weights(damped, damping), 1 / damped
    )
    stored = file.tuning()
    return scores | {
        "baseline_nearest": nearest["gain_error"],
        "worst_mode_hz": float(damped[int(scores.pop("worst_mode"))] / (2 * np.pi)),
        "frequency_error": float(np.abs(stored.damped_frequency.numpy() / damped - 1).max()),
        "decay_time_error": float(np.abs(damping / stored.damping.numpy() - 1).max()),
        "points": len(rows),
    }


def evaluate_sounds(
    file: ObjectFile, modes: dict[str, np.ndarray], strikes: Strikes, rng: np.random.Generator
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
    for sounds in zip(*(torch.from_numpy(s).split(BATCH) for s in strike_sounds(file, modes, strikes))):
        truth, answer, noise = (spectrogram(s) for s in (*sounds, white_noise(sounds[0], rng)))
        errors.add(answer, truth)
        noise_errors.add(noise, truth)
    noise_scores = noise_errors.scores()
    return counts | errors.scores() | ({"baseline_noise": noise_scores["psnr"]} if noise_scores else {})


def evaluate_truncation(modes: dict[str, np.ndarray], report: dict[str, Any]) -> dict[str, Any]:
    """Count the modes that were found but not solved, and estimate their energy; empty if none were counted.

    ``lost_energy`` is the share of the energy of unit impulses' sounds, with all modes below the frequency to
    which they were counted; see `objectfolder.objectfile.truncation.lost_energy`.

    Parameters
    ----------
    report : dict
        Contents of ``modal.json``.
    """
    found = report["count_below_max_frequency"]
    if found is None:
        return {}
    stuff = Material(report["material"], **report["material_properties"])
    kept, limit = modes["damped_frequency"], report["max_frequency_hz"]
    lost = lost_energy(modes["shapes"], kept, stuff, found, limit) if report["truncated"] else 0.0
    return {"modes_found": found, "lost_energy": lost}


def white_noise(sounds: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    """Draw white Gaussian noise with the energy of each sound; (N, samples)."""
    noise = torch.from_numpy(rng.standard_normal(sounds.shape)).to(sounds.dtype)
    # Norms rather than energies: squares of micrometres per newton second underflow.
    return noise * (sounds.double().norm(dim=1) / noise.double().norm(dim=1)).to(sounds.dtype)[:, None]


def strike_sounds(
    file: ObjectFile, modes: dict[str, np.ndarray], strikes: Strikes, sample_rate: int = SAMPLE_RATE
) -> tuple[np.ndarray, np.ndarray]:
    """Return true sounds of strikes and the Object File's; both (N, samples).

    The strikes are ideal impulses, which excite all modes alike.
    """
    tuning = torch.from_numpy(modes["damped_frequency"]), torch.from_numpy(modes["damping"])
    bank = sinusoid_bank(*tuning, sample_rate)
    shapes = torch.from_numpy(modes["shapes"][strikes.rows]).float()
    truth = gains(shapes, torch.from_numpy(strikes.impulses).float()) @ bank
    points = modes["points"][strikes.rows] * file.scale
    return truth.numpy(), file.impact(points, strikes.impulses, sample_rate, contact_time=0.0)


def evaluate_touch(
    file: ObjectFile, contacts: dict[str, np.ndarray], mean_image: np.ndarray
) -> dict[str, float]:
    """Compute the PSNR of tactile images at held-out contacts, and the error of their forces.

    Contacts where the object extends behind the gel (a handle, the inside of a cup) are impossible for a
    real sensor. They count in ``psnr`` and ``psnr_median``, but not in the other scores:
    ``psnr_unobstructed`` and ``psnr_median_unobstructed`` of whole images; ``psnr_contact`` of contact
    pixels, pooled over contacts with at least `MIN_PIXELS` of them; and ``force_error``, the mean error
    relative to the mean force, if both the gel and the network provide forces.

    Parameters
    ----------
    contacts : dict
        Contents of ``touch/test.npz``.
    mean_image : (H, W, 3) array
        Mean of the training images in grey levels: the baseline.
    """
    query = contacts["points"], contacts["depths"], contacts["angles"]
    force = np.full(len(contacts["points"]), np.nan)
    if file.fixed_contact is not None:
        images = file.touch(*query)
    else:
        found = [(part.images, part.force) for part in file.touches(*query)]
        images, force = (np.concatenate(parts) for parts in zip(*found))
    scores = touch_scores(images, contacts)
    baseline = touch_scores(np.broadcast_to(mean_image, images.shape), contacts)
    scores["baseline_mean_image"] = baseline["psnr"]
    free = contacts["obstructed"] == 0
    error = np.abs(force - contacts["force"])[free]
    if len(error) and np.isfinite(error).all() and contacts["force"][free].any():
        scores["force_error"] = float(error.mean() / contacts["force"][free].mean())
    return scores


def touch_scores(images: np.ndarray, contacts: dict[str, np.ndarray]) -> dict[str, float]:
    """Score images (N, H, W, 3) in grey levels; see `evaluate_touch`."""
    errors, free = np.empty(len(images)), contacts["obstructed"] == 0
    contact = []
    truths = zip(images, contacts["images"], contacts["masks"], free)
    for i, (image, truth, mask, counts) in enumerate(truths):
        squared = np.square((image.astype(np.float32) - truth) / 255).mean(2)
        errors[i] = squared.mean()
        if counts and mask.sum() >= MIN_PIXELS:
            contact.append(squared[mask])
    scores = {
        "psnr": float(psnr(errors.mean())),
        "psnr_median": float(np.median(psnr(errors))),
        "obstructed_fraction": float(1 - free.mean()),
        "contacts": len(images),
    }
    if free.any():
        scores["psnr_unobstructed"] = float(psnr(errors[free].mean()))
        scores["psnr_median_unobstructed"] = float(np.median(psnr(errors[free])))
    if contact:
        scores["psnr_contact"] = float(psnr(np.concatenate(contact).mean()))
    return scores


def summary_row(key: str, metrics: dict[str, Any]) -> dict[str, str]:
    """Return an object's row of the table printed at the end of a build."""
    v, a, t = metrics["vision"], metrics["audio"], metrics["touch"]

    def beside(values: dict[str, Any], *scores: str, form: str = ".1f", none: str = "silent") -> str:
        return " / ".join(f"{values[name]:{form}}" for name in scores) if scores[0] in values else none

    kept, found = a["modes"], a.get("modes_found")

    return {
        "object": key,
        "vision / white": beside(v, "psnr", "baseline_white"),
        "lit": f"{v['psnr_lit_foreground']:.1f}" if "psnr_lit_foreground" in v else "-",
        "audio / silence": beside(a, "psnr", "baseline_silence"),
        "gain error / nearest": beside(a, "gain_error", "baseline_nearest", form=".1%", none="-"),
        "modes": f"{kept}" if found in (None, kept) else f"{kept} of {found}",
        "touch / mean": beside(t, "psnr", "baseline_mean_image"),
        "kB": f"{metrics['file_bytes'] / 1000:.0f}",
    }
