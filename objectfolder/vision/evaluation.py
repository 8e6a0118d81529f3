"""Scores of an Object File's views against held-out ones (supplementary F, Table 2)."""

from typing import Any

import numpy as np
import torch

from objectfolder.base.metrics import psnr, ssim
from objectfolder.vision.cameras import image_intrinsics
from objectfolder.vision.color import find_lit_foreground, on_white
from objectfolder.vision.query import VisionQueries


def evaluate_vision(file: VisionQueries, truth: dict[str, np.ndarray]) -> dict[str, Any]:
    """Compute PSNR and SSIM of held-out views, the contents of ``views/test.npz``, in sRGB on white.

    Half of all views are nearly unlit on a white background, so the lit foreground is also scored on its own:
    pixels that the object covers fully and whose true radiance exceeds 1 % of white. The views themselves are
    noisy: ``noise_floor`` and ``noise_floor_lit`` are the ``psnr`` and ``psnr_lit_foreground`` of a perfect
    answer, given if the views contain their noise.
    """
    errors, white, similarity, lit_errors = [], [], [], []
    asked = truth["camera_to_world"], truth["light"], image_intrinsics(truth)
    for rgba, pose, light, intrinsics in zip(truth["rgba"].astype(np.float32), *asked):
        shown = on_white(torch.from_numpy(rgba)).numpy()
        image = file.view(pose, light, intrinsics=intrinsics)[0]
        squared = (image - shown) ** 2
        errors.append(squared.mean())
        white.append(((1 - shown) ** 2).mean())
        similarity.append(ssim(image, shown))
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
    if "noise" in truth:
        noise, lit_noise = truth["noise"].T
        scores["noise_floor"] = float(np.mean(psnr(noise)))
        if lit_error.size:
            pixels = [len(lit) for lit in lit_errors]
            scores["noise_floor_lit"] = float(psnr(np.average(lit_noise, weights=pixels)))
    return scores


def choose_views(scores: dict[str, Any], count: int) -> dict[int, str]:
    """Choose at most ``count`` views of `evaluate_vision`; return the title of each by its index.

    They are the worst, the median and the best, and others at equal steps.
    """
    named = {scores[f"{name}_view"]: name for name in ("best", "median", "worst")}
    others = [i for i in range(scores["views"]) if i not in named]
    step = np.linspace(0, len(others) - 1, min(max(count - len(named), 0), len(others)))
    chosen = {row: f"{named[row]}: view {row + 1}" for row in reversed(named)}
    return chosen | {others[int(i)]: f"view {others[int(i)] + 1}" for i in step}


def compare_views(
    file: VisionQueries, views: dict[str, np.ndarray], rows: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return true held-out whole views and the Object File's; both (N, H, W, 3), sRGB on white."""
    rgba = views["rgba"][rows].astype(np.float32)
    whole = image_intrinsics(views)[0]
    answers = file.view(views["camera_to_world"][rows], views["light"][rows], intrinsics=whole)
    return on_white(torch.from_numpy(rgba)).numpy(), answers
