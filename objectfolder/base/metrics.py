"""Error metrics between answers and ground truth."""

import numpy as np
import torch
from skimage.metrics import structural_similarity


def psnr(error: float | np.ndarray, peak: float = 1.0) -> float | np.ndarray:
    """Compute the peak signal-to-noise ratio of a mean squared error, dB; at most 200 (supplementary F)."""
    return 10 * np.log10(peak**2 / np.maximum(error, 1e-20 * peak**2))


def ssim(image: np.ndarray, reference: np.ndarray) -> float:
    """Compute the SSIM of two (H, W, 3) images in [0, 1] (Wang et al. 2004; 11x11 Gaussian)."""
    pair = (np.asarray(picture, np.float64) for picture in (image, reference))
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    return float(structural_similarity(*pair, channel_axis=2, data_range=1.0, **options))


class SpectrogramErrors:
    """PSNR of complex spectrograms, accumulated batch by batch.

    ``psnr`` follows the paper: real and imaginary parts are scaled to [0, 1] by the smallest and largest true
    value, so that silence scores 50 dB and more. It pools the errors of all sounds; the loudest count most.
    ``psnr_mean`` is the mean over sounds. ``psnr_own_max`` compares magnitudes relative to the peak of each.
    """

    def __init__(self) -> None:
        self._low, self._high = np.inf, -np.inf
        self._power, self._count = 0.0, 0
        self._errors: list[np.ndarray] = []  # mean square of each sound
        self._own: list[np.ndarray] = []

    def add(self, image: torch.Tensor, truth: torch.Tensor) -> None:
        """Add a batch of (N, F, T) complex spectrograms."""
        parts = torch.view_as_real(truth)
        self._low, self._high = min(self._low, parts.min().item()), max(self._high, parts.max().item())
        error = torch.view_as_real(image - truth).double()
        self._errors.append(error.square().flatten(1).mean(1).numpy())
        self._power += parts.double().square().sum().item()
        self._count += parts.numel()
        size = truth.abs().flatten(1)
        peak = size.amax(1, keepdim=True).clamp(min=torch.finfo(size.dtype).tiny)
        self._own.append(((image.abs().flatten(1) - size) / peak).double().square().mean(1).numpy())

    def scores(self) -> dict[str, float]:
        """Return the scores of all batches, dB; empty if the truth is silent."""
        span = (self._high - self._low) ** 2
        if not span > 0:
            return {}
        errors = np.concatenate(self._errors) / span
        return {
            "psnr": float(psnr(errors.mean())),
            "psnr_mean": float(np.mean(psnr(errors))),
            "psnr_own_max": float(np.mean(psnr(np.concatenate(self._own)))),
            "baseline_silence": float(psnr(self._power / self._count / span)),
        }


def gain_errors(
    predicted: np.ndarray, shapes: np.ndarray, energy: np.ndarray, gain: np.ndarray
) -> dict[str, float]:
    """Compute the relative errors of mode shapes (P, 3, M).

    ``gain_error`` weights the squared error of each mode by its energy (M,); ``gain_error_frobenius`` by the
    square of its gain (M,), that of a unit shape value; ``gain_error_worst`` is that of the mode
    ``worst_mode``, counted from 0.
    """
    squared, truth = ((predicted - shapes) ** 2).sum((0, 1)), (shapes**2).sum((0, 1))
    each = np.sqrt(np.divide(squared, truth, out=np.zeros_like(truth), where=truth > 0))

    def relative(weight: np.ndarray) -> float:
        total = float(truth @ weight)
        return float(np.sqrt(squared @ weight / total)) if total > 0 else 0.0

    return {
        "gain_error": relative(energy),
        "gain_error_frobenius": relative(gain**2),
        "gain_error_worst": float(each.max()),
        "worst_mode": int(each.argmax()),
    }
