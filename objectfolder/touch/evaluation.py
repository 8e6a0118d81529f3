"""Scores of an Object File's tactile images and forces against held-out contacts (supplementary F)."""

from typing import Any

import numpy as np

from objectfolder.base.metrics import psnr
from objectfolder.stored.surface import ANYWHERE
from objectfolder.touch.query import TouchQueries

MIN_PIXELS = 50  #: contact pixels that a touch needs to count in ``psnr_contact``


def evaluate_touch(file: TouchQueries, truth: dict[str, np.ndarray]) -> dict[str, Any]:
    """Compute the PSNR of tactile images at held-out contacts, and the error of their forces.

    Contacts where the object extends behind the gel (a handle, the inside of a cup) are impossible for a real
    sensor. They count in ``psnr`` and ``psnr_median``, but not in the other scores: ``psnr_unobstructed`` and
    ``psnr_median_unobstructed`` of whole images; ``psnr_contact`` of contact pixels, pooled over contacts
    with at least `MIN_PIXELS` of them; and ``force_error``, the mean error relative to the mean force, if
    both the gel and the network provide forces.

    The truth is the contents of ``touch/test.npz``, and ``mean_image``, (H, W, 3): the mean of the training
    images in grey levels, which is the baseline.
    """
    query = truth["points"], truth["depths"], truth["angles"]
    force = np.full(len(truth["points"]), np.nan)
    if file.fixed_contact is not None:
        images = file.touch(*query, tolerance=ANYWHERE)
    else:
        found = [(part.images, part.force) for part in file.touches(*query, tolerance=ANYWHERE)]
        images, force = (np.concatenate(parts) for parts in zip(*found))
    scores = score_images(images, truth)
    baseline = score_images(np.broadcast_to(truth["mean_image"], images.shape), truth)
    scores["baseline_mean_image"] = baseline["psnr"]
    free = truth["obstructed"] == 0
    error = np.abs(force - truth["force"])[free]
    if len(error) and np.isfinite(error).all() and truth["force"][free].any():
        scores["force_error"] = float(error.mean() / truth["force"][free].mean())
    return scores


def score_images(images: np.ndarray, contacts: dict[str, np.ndarray]) -> dict[str, float]:
    """Score images (N, H, W, 3) in grey levels; see `evaluate_touch`."""
    errors, free = np.empty(len(images)), contacts["obstructed"] == 0
    contact = []
    truths = zip(images, contacts["images"], contacts["masks"], free)
    for i, (image, truth, mask, counts) in enumerate(truths):
        squared = np.square((image.astype(np.float32) - truth) / 255).mean(2)
        errors[i] = squared.mean()
        if counts and mask.sum() >= MIN_PIXELS:
            contact.append(squared[mask])
    scores = {"psnr": float(psnr(errors.mean())), "psnr_median": float(np.median(psnr(errors)))}
    scores |= {"obstructed_fraction": float(1 - free.mean()), "contacts": len(images)}
    if free.any():
        scores["psnr_unobstructed"] = float(psnr(errors[free].mean()))
        scores["psnr_median_unobstructed"] = float(np.median(psnr(errors[free])))
    if contact:
        scores["psnr_contact"] = float(psnr(np.concatenate(contact).mean()))
    return scores
