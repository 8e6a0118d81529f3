"""An Object File against held-out ground truth (supplementary F, Table 2), beside honest baselines."""

from typing import Any

import numpy as np
import torch

from objectfolder.audio.spectrogram import SAMPLE_RATE, spectrogram
from objectfolder.audio.synthesis import audible, sinusoid_bank
from objectfolder.metrics import SpectrogramErrors, awgn_psnr, gain_errors, psnr, ssim
from objectfolder.nets.audio_gains import energy_weights
from objectfolder.objectfile import ObjectFile
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.color import on_white

AWGN = {"sigma_0_05": 0.05, "variance_0_05": 0.05**0.5}  # the paper says variance, its figures mean sigma


def evaluate_vision(file: ObjectFile, views: dict[str, np.ndarray]) -> dict[str, float]:
    """PSNR and SSIM of held-out views, in sRGB on white.

    Half of all views are nearly unlit on a white background, so the lit foreground is scored apart:
    pixels that the object covers fully and whose true radiance exceeds 1 % of white.
    """
    height, width = views["rgba"].shape[1:3]
    intrinsics = Intrinsics(width, height, float(views["focal"]))
    errors, white, similarity, lit_errors = [], [], [], []
    for rgba, pose, light in zip(views["rgba"].astype(np.float32), views["camera_to_world"], views["light"]):
        truth = on_white(torch.from_numpy(rgba)).numpy()
        image = file.view(pose, light, intrinsics=intrinsics)[0]
        squared = (image - truth) ** 2
        errors.append(squared.mean())
        white.append(((1 - truth) ** 2).mean())
        similarity.append(ssim(image, truth))
        lit = (rgba[..., 3] >= 0.999) & (rgba[..., :3].max(-1) > 0.01)
        lit_errors.append(squared[lit].ravel())
    scores = {
        "psnr": float(np.mean(psnr(np.array(errors)))),
        "psnr_pooled": float(psnr(np.mean(errors))),
        "psnr_worst": float(psnr(np.max(errors))),
        "ssim": float(np.mean(similarity)),
        "baseline_white": float(np.mean(psnr(np.array(white)))),
        "views": len(errors),
    }
    lit_error = np.concatenate(lit_errors)
    return scores | ({"psnr_lit_foreground": float(psnr(lit_error.mean()))} if lit_error.size else {})


def evaluate_audio(
    file: ObjectFile, modes: dict[str, np.ndarray], rows: np.ndarray, impacts: int, rng: np.random.Generator
) -> dict[str, float]:
    """Gains at held-out surface points, and spectrograms of random impacts there.

    PSNR is in the paper's convention: real and imaginary parts, scaled to [0, 1] by the object's smallest
    and largest true value. Silence scores 50 dB and more in it, so it is printed beside.
    ``psnr_own_max`` compares magnitudes relative to each sound's own peak.
    """
    true_shapes = modes["shapes"][rows].astype(np.float64)
    damped, damping = modes["damped_frequency"], modes["damping"]
    if len(damping) == 0:
        return {"modes": 0, "points": len(rows)}
    predicted = file.mode_shapes(modes["points"][rows] * file.scale).astype(np.float64)
    energy = energy_weights(damped, damping)
    scores = gain_errors(predicted, true_shapes, energy, 1 / damped)
    heard = audible(torch.from_numpy(damped), SAMPLE_RATE).numpy()
    scores |= {"modes": len(damping), "modes_heard": int(heard.sum()), "points": len(rows)}
    if not heard.any():
        return scores
    force = rng.normal(size=(impacts, 3))
    force /= np.linalg.norm(force, axis=1, keepdims=True)
    chosen = rng.integers(len(rows), size=impacts)
    bank = sinusoid_bank(torch.from_numpy(damped[heard]), torch.from_numpy(damping[heard]))
    # The transform is linear: transform the bank once and mix spectrograms.
    bank_spectra = torch.view_as_real(spectrogram(bank)).flatten(1)
    true_gains, gains = (
        torch.from_numpy(np.einsum("ndm,nd->nm", s[chosen][:, :, heard], force)).float()
        for s in (true_shapes, predicted)
    )
    low, high, error, power, own = np.inf, -np.inf, 0.0, 0.0, []
    for g, g_true in zip(gains.split(16), true_gains.split(16)):
        truth, image = g_true @ bank_spectra, g @ bank_spectra
        low, high = min(low, truth.min().item()), max(high, truth.max().item())
        error += (image - truth).double().square().sum().item()
        power += truth.double().square().sum().item()
        size = torch.view_as_complex(truth.view(len(g), -1, 2)).abs()
        difference = torch.view_as_complex(image.view(len(g), -1, 2)).abs() - size
        own.append((difference / size.amax(1, keepdim=True)).double().square().mean(1).numpy())
    count = impacts * bank_spectra.shape[1]
    span = (high - low) ** 2
    return scores | {
        "psnr": float(psnr(error / count / span)),
        "psnr_own_max": float(np.mean(psnr(np.concatenate(own)))),
        "baseline_silence": float(psnr(power / count / span)),
        "impacts": impacts,
    }


def evaluate_spectrograms(
    file: ObjectFile, modes: dict[str, np.ndarray], rows: np.ndarray, impacts: int, rng: np.random.Generator
) -> dict[str, float]:
    """Sounds of random impacts at held-out surface points, of an audio net that stores no modes.

    The scores are those of `evaluate_audio`, but for the gains.
    """
    damped = torch.from_numpy(modes["damped_frequency"])
    heard = audible(damped, SAMPLE_RATE)
    scores: dict[str, float] = {
        "modes": len(damped),
        "modes_heard": int(heard.sum()),
        "points": len(rows),
    }
    if not heard.any():
        return scores
    force = rng.normal(size=(impacts, 3))
    force /= np.linalg.norm(force, axis=1, keepdims=True)
    chosen = rows[rng.integers(len(rows), size=impacts)]
    bank = sinusoid_bank(damped, torch.from_numpy(modes["damping"]))
    errors = SpectrogramErrors()
    for row, push in zip(chosen, force):
        gains = torch.from_numpy(push @ modes["shapes"][row]).float()
        sound = torch.from_numpy(file.impact(modes["points"][row] * file.scale, push))
        errors.add(spectrogram(sound), spectrogram((gains @ bank)[None]))
    return scores | errors.scores() | {"impacts": impacts}


def evaluate_touch(
    file: ObjectFile, contacts: dict[str, np.ndarray], mean_image: np.ndarray
) -> dict[str, float]:
    """PSNR of tactile images at held-out contacts.

    Contacts where the object reaches behind the gel (a handle, the inside of a cup) are impossible for a
    real sensor; they count in ``psnr`` and are left out of ``psnr_unobstructed``.

    Parameters
    ----------
    mean_image : (H, W, 3) array
        Mean of the training images in grey levels: the baseline.
    """
    truth = contacts["images"].astype(np.float32)
    images = file.touch(contacts["points"], contacts["depths"], contacts["angles"])
    errors = np.square((images - truth) / 255).mean((1, 2, 3))
    baseline = np.square((truth - mean_image) / 255).mean((1, 2, 3))
    free = contacts["obstructed"] == 0
    scores = {
        "psnr": float(psnr(errors.mean())),
        "psnr_median": float(np.median(psnr(errors))),
        "obstructed_fraction": float(1 - free.mean()),
        "baseline_mean_image": float(psnr(baseline.mean())),
        "contacts": len(truth),
    }
    if free.any():
        scores["psnr_unobstructed"] = float(psnr(errors[free].mean()))
    return scores


def evaluate_awgn(
    shapes: dict[str, tuple[int, ...]], rng: np.random.Generator
) -> dict[str, dict[str, float]]:
    """PSNR of ground truth corrupted by white Gaussian noise, per convention and modality.

    In data scaled to [0, 1] it is a property of the noise alone: 26.0 dB for sigma 0.05, 13.0 dB for
    variance 0.05.
    """
    return {
        name: {modality: awgn_psnr(shape, sigma, rng) for modality, shape in shapes.items()}
        for name, sigma in AWGN.items()
    }


def summary_row(key: str, metrics: dict[str, Any]) -> dict[str, str]:
    """One line of the table that a build ends with."""
    v, a, t = metrics["vision"], metrics["audio"], metrics["touch"]

    def beside(values: dict[str, Any], score: str, baseline: str) -> str:
        return f"{values[score]:.1f}/{values[baseline]:.1f}" if score in values else "silent"

    return {
        "object": key,
        "vision / white": beside(v, "psnr", "baseline_white"),
        "lit": f"{v['psnr_lit_foreground']:.1f}" if "psnr_lit_foreground" in v else "-",
        "audio / silence": beside(a, "psnr", "baseline_silence"),
        "gain error": f"{a['gain_error']:.1%}" if "gain_error" in a else "-",
        "touch / mean": beside(t, "psnr", "baseline_mean_image"),
        "KB": f"{metrics['file_bytes'] / 1024:.0f}",
    }
