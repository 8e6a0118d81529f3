"""The shapes that reconstructions are measured against, and the scores of answers to them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.benchmarks.datasets.occupancy import OccupancySamples, cached_occupancy, extract_mesh
from objectfolder.benchmarks.scoring.shapes import (
    SampledSurface,
    intersection_over_union,
    sample_mesh,
    surface_scores,
)
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile.file import ObjectFile
from objectfolder.seeding import numpy_generator

POOL = 2**16  #: points of each kind to train on, per object
VAL_POINTS = 2**12  #: uniform points to validate on
#: Occupancies that are tried as the threshold; the best on validation is taken.
THRESHOLDS = np.linspace(0.05, 0.95, 19).round(2)


@dataclass(frozen=True)
class Truth:
    """Shapes of objects, which are named by their labels."""

    files: dict[str, Path]  #: Object Files by key, in the order of the labels
    points: int  #: of the scores: for the IoU, and on either surface
    resolution: int  #: nodes along a side of the grid
    seed: int
    folder: Path  #: where sampled occupancies are kept

    @property
    def keys(self) -> tuple[str, ...]:
        """Objects by label."""
        return tuple(self.files)

    @cached_property
    def occupancy(self) -> OccupancySamples:
        """Occupancy samples of all objects; made at first use, or read."""
        path, sizes = self.folder / "occupancy.npz", (POOL, VAL_POINTS, self.points, self.resolution)
        return cached_occupancy(path, self.files, *sizes, self.seed)

    @cached_property
    def sampled(self) -> Callable[[int], SampledSurface]:
        """Give the sampled surface of an object; only those that are asked for are sampled, and kept."""
        return cache(lambda label: self._sampled(label, "truth"))

    def surface(self, label: int) -> Isosurface:
        """Stored surface of an object."""
        return ObjectFile.load(self.files[self.keys[label]]).surface

    def floor(self, labels: Sequence[int] | np.ndarray) -> dict[str, float]:
        """SampledSurface scores of objects sampled anew: what a perfect answer would get."""
        scores = [surface_scores(self._sampled(int(i), "floor"), self.sampled(int(i))) for i in labels]
        return dict(zip(("chamfer_l1", "normal_consistency"), np.mean(scores, 0).tolist()))

    def scores(
        self,
        purpose: str,
        labels: np.ndarray,
        inside: Callable[[int], np.ndarray],
        mesh: Callable[[int], tuple[np.ndarray, np.ndarray]],
    ) -> dict[str, Any]:
        """Score answers, each about the object of a label.

        Parameters
        ----------
        purpose : str
            Names the random points on the answers' surfaces.
        labels : (N,) int array
        inside : callable
            Gives for the i-th answer which of ``occupancy.score_points`` are inside.
        mesh : callable
            Gives its vertices and faces.

        Returns
        -------
        dict
            Means of ``iou``, ``chamfer_l1`` and ``normal_consistency``; ``samples``, the number of answers,
            of which ``empty`` had no surface; ``per_object``, IoU by key.
        """
        iou, surfaces, empty = np.zeros(len(labels)), np.zeros((len(labels), 2)), 0
        for i, label in enumerate(labels):
            iou[i] = intersection_over_union(inside(i), self.occupancy.score_inside[label])
            rng = numpy_generator(self.seed, "reconstruct", "surface", purpose, str(i))
            predicted = sample_mesh(*mesh(i), self.points, rng)
            surfaces[i] = surface_scores(predicted, self.sampled(int(label)))
            empty += predicted is None
        chamfer, consistency = surfaces.mean(0).tolist()
        return {
            "iou": float(iou.mean()),
            "chamfer_l1": chamfer,
            "normal_consistency": consistency,
            "samples": len(labels),
            "empty": empty,
            "per_object": {
                self.keys[label]: float(iou[labels == label].mean()) for label in np.unique(labels)
            },
        }

    def average_shape(self, learnt: np.ndarray, val: np.ndarray, test: np.ndarray) -> dict[str, Any]:
        """Score the mean occupancy of some objects, the same answer whatever is seen or heard.

        Parameters
        ----------
        learnt : (K,) int array
            Labels of the objects that are averaged.
        val : (V,) int array
            Labels that the threshold is best for.
        test : (N,) int array
            Labels that are answered.

        Returns
        -------
        dict
            See `scores`; and ``threshold``.
        """
        occupancy, side = self.occupancy, self.resolution

        def mean(inside: np.ndarray) -> np.ndarray:
            return inside[learnt].mean(0, dtype=np.float32)

        guess = mean(occupancy.val_inside)
        guesses = np.broadcast_to(guess, (len(val), len(guess)))
        level, _ = best_level(guesses, occupancy.val_inside[val], THRESHOLDS)
        grid = occupancy.grid(learnt).mean(0, dtype=np.float32).reshape(side, side, side)
        inside, mesh = mean(occupancy.score_inside) > level, extract_mesh(grid, level)
        return self.scores("average_shape", test, lambda i: inside, lambda i: mesh) | {"threshold": level}

    def _sampled(self, label: int, purpose: str) -> SampledSurface:
        surface = self.surface(label)
        rng = numpy_generator(self.seed, "reconstruct", "surface", purpose, self.keys[label])
        sampled = sample_mesh(surface.vertices, surface.faces, self.points, rng)
        assert sampled is not None  # an Object File without a surface is refused when it is read
        return sampled


def best_level(values: np.ndarray, inside: np.ndarray, levels: np.ndarray) -> tuple[float, float]:
    """Level above which values (B, P) agree best with the truth (B, P), and the mean IoU there.

    Of levels that are equally good, the lowest.
    """
    scores = [float(intersection_over_union(values > level, inside).mean()) for level in levels]
    best = int(np.argmax(scores))
    return float(levels[best]), scores[best]
