"""Scores of an Object File's views against held-out ones (supplementary F, Table 2)."""

from typing import Any

import numpy as np
import torch
from scipy.ndimage import uniform_filter

from objectfolder.base.metrics import psnr, ssim
from objectfolder.mesh import srgb
from objectfolder.vision.cameras import image_intrinsics
from objectfolder.vision.color import MIN_FOREGROUND_ALPHA, find_lit_foreground, on_white
from objectfolder.vision.query import VisionQueries

_NEIGHBOURHOOD = 5  # pixels along a side, over which noise and error of a view are compared
_NOISY = 0.05  # variance over squared error below which colours are taken as they are
_BRIGHTEST = 2.0  # radiance at which rare bright paths are cut
_DARK = 0.2  # share of the object that is lit in a view, below which it is too dark to show
_TANGENT = 1e-6  # difference of colours below which a chord is the tangent


def evaluate_vision(file: VisionQueries, truth: dict[str, np.ndarray]) -> dict[str, Any]:
    """Compute PSNR and SSIM of held-out views, the contents of ``views/test.npz``, in sRGB on white.

    Half of all views are nearly unlit on a white background, so the lit foreground is also scored on its own:
    pixels that the object covers fully and whose true radiance exceeds 1 % of white.

    True views are path-traced and noisy. If they come with their noise, errors are those against views
    without it, see `noiseless_error`; ``psnr_standard_error`` is what the noise leaves uncertain of ``psnr``,
    dB. Nothing counts with an error below half of its standard error; ``views_at_least`` counts those within
    two standard errors of a perfect one, whose PSNR is at least what it counts with. ``noise_floor`` and
    ``noise_floor_lit`` are the PSNR of the noise alone, which the SSIM contains.
    """
    errors, deviations, white, similarity, lit, floors = ([] for _ in range(6))
    views = truth["rgba"].astype(np.float32)
    noises = truth.get("noise", np.zeros_like(views)).astype(np.float32)
    asked = truth["camera_to_world"], truth["light"], image_intrinsics(truth)
    for rgba, noise, pose, light, intrinsics in zip(views, noises, *asked):
        image = file.view(pose, light, intrinsics=intrinsics)[0]
        error, spread = noiseless_error(image, rgba, noise)
        halves = (on_white(torch.from_numpy(half)).numpy() for half in (rgba + noise, rgba - noise))
        variance = np.square(np.subtract(*halves)).mean(-1) / 4
        mean, deviation = _pooled(error, spread)
        errors.append(mean)
        deviations.append(deviation)
        floors.append(variance.mean())
        white.append(noiseless_error(np.ones_like(image), rgba, noise)[0].mean())
        similarity.append(ssim(image, on_white(torch.from_numpy(rgba)).numpy()))
        chosen = find_lit_foreground(rgba - abs(noise))
        lit.append(np.stack([error[chosen], spread[chosen], variance[chosen]]))
    scores = {
        "psnr": float(np.mean(psnr(np.array(errors)))),
        "psnr_pooled": float(psnr(float(np.mean(errors)))),
        "psnr_worst": float(psnr(max(errors))),
        "ssim": float(np.mean(similarity)),
        "baseline_white": float(np.mean(psnr(np.array(white)))),
        "views": len(errors),
    }
    order = np.argsort(np.round(errors, 12), kind="stable").tolist()  # perfect ones tie
    scores |= {"best_view": order[0], "median_view": order[len(order) // 2], "worst_view": order[-1]}
    lit_error, lit_spread, lit_variance = np.concatenate(lit, axis=1)
    if lit_error.size:
        scores["psnr_lit_foreground"] = float(psnr(_pooled(lit_error, lit_spread)[0]))
    if "noise" in truth:
        relative = np.array(deviations) / np.maximum(errors, 1e-20)
        scores["psnr_standard_error"] = float(10 / np.log(10) * np.linalg.norm(relative) / len(errors))
        scores["views_at_least"] = int((relative > 0.5).sum())
        scores["noise_floor"] = float(np.mean(psnr(np.array(floors))))
        if lit_error.size:
            scores["noise_floor_lit"] = float(psnr(lit_variance.mean()))
    return scores


def _pooled(error: np.ndarray, spread: np.ndarray) -> tuple[float, float]:
    """Return the mean of errors, at least half of its standard error, and that."""
    deviation = float(np.linalg.norm(spread)) / spread.size
    return max(float(error.mean()), deviation / 2), deviation


def noiseless_error(image: np.ndarray, rgba: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the squared error of an image against a view without noise, per pixel.

    The image (H, W, 3) is in sRGB on white, the view (H, W, 4) linear: the mean of two independent renders,
    which are the view plus and minus its noise (H, W, 4). The product of the errors of the two renders is,
    in linear colours, an unbiased estimate of the squared error against their expectation. In sRGB it
    counts by the square of the chord's slope between the image and the true colour. Where the noise of a
    pixel and its neighbours is as large as their error, the chord is the tangent at the image, so that the
    slope hardly depends on the noise.

    Returns the error (H, W), mean over the colours, which may be negative, and its standard deviation by the
    noise (H, W).
    """
    answer = srgb.decode(np.asarray(image, np.float64))
    # On white. Renders are cut well above white: to cut there would make their mean too dark.
    renders = (view[..., :3] + (1 - view[..., 3:]) for view in (rgba + noise, rgba - noise))
    first, second = (render.clip(max=_BRIGHTEST) for render in renders)
    error, half = (first + second) / 2 - answer, (first - second) / 2
    around = (_NEIGHBOURHOOD, _NEIGHBOURHOOD, 1)
    variance, square = (uniform_filter(each.astype(np.float64) ** 2, around) for each in (half, error))
    noisy = variance / np.where(square > 0, square, 1)
    trusted = np.where(noisy < _NOISY, 1, (1 - noisy).clip(min=0))
    step = trusted * error
    chord = srgb.encode((answer + step).clip(0, 1)) - image
    slope = np.where(abs(step) > _TANGENT, chord / np.where(step == 0, 1, step), srgb.encode_slope(answer))
    return (slope**2 * (error**2 - half**2)).mean(-1), abs((2 * slope**2 * error * half).mean(-1))


def choose_views(scores: dict[str, Any], rgba: np.ndarray, count: int) -> dict[int, str]:
    """Choose at most ``count`` of the true views (N, H, W, 4); return the title of each by its index.

    They are the worst, the median and the best of `evaluate_vision`, but not a best one that is dark, which
    shows nothing; then those that are lit most.
    """
    lit = find_lit_foreground(rgba).sum((1, 2)) / (rgba[..., 3] >= MIN_FOREGROUND_ALPHA).sum((1, 2)).clip(1)
    named = {scores[f"{name}_view"]: name for name in ("best", "median", "worst")}
    if named[best := scores["best_view"]] == "best" and lit[best] < _DARK:
        del named[best]
    others = [i for i in np.argsort(-lit, kind="stable").tolist() if i not in named]
    chosen = {row: f"{named[row]}: view {row + 1}" for row in reversed(named)}
    return chosen | {row: f"view {row + 1}" for row in others[: max(count - len(named), 0)]}


def compare_views(
    file: VisionQueries, views: dict[str, np.ndarray], rows: list[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return true held-out whole views, the Object File's, and the PSNR of each as it is scored, dB.

    Views are (N, H, W, 3), sRGB on white.
    """
    rgba = views["rgba"][rows].astype(np.float32)
    noise = views.get("noise", np.zeros(0))
    noise = noise[rows].astype(np.float32) if noise.ndim == 4 else np.zeros_like(rgba)  # fewer in old builds
    whole = image_intrinsics(views)[0]
    answers = file.view(views["camera_to_world"][rows], views["light"][rows], intrinsics=whole)
    errors = [_pooled(*noiseless_error(*each))[0] for each in zip(answers, rgba, noise)]
    return on_white(torch.from_numpy(rgba)).numpy(), answers, np.asarray(psnr(np.array(errors)))
