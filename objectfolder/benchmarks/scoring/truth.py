"""Ground truth of reconstruction, and scores of predictions against it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets.occupancy import OccupancySamples, cached_occupancy, extract_mesh
from objectfolder.benchmarks.scoring.shapes import (
    SampledSurface,
    intersection_over_union,
    sample_mesh,
    surface_scores,
)
from objectfolder.mesh.isosurface import Isosurface

POOL = 2**16  #: points of each kind to train on, per object
VAL_POINTS = 2**12  #: uniform points to validate on
#: Candidate thresholds; the best on validation rows is used.
THRESHOLDS = np.linspace(0.05, 0.95, 19).round(2)


@dataclass(frozen=True)
class Truth:
    """True shapes of objects, which are identified by label."""

    surfaces: Mapping[str, Callable[[], Isosurface]]  #: loads the stored surface by key, in label order
    digests: Mapping[str, str]  #: of the Object Files by key
    sides: Mapping[str, float]  #: longest sides by key, metres
    points: int  #: for the IoU, and on each surface
    resolution: int  #: nodes along a side of the grid
    seed: int
    folder: Path  #: of cached occupancy samples

    @property
    def keys(self) -> tuple[str, ...]:
        """Objects in label order."""
        return tuple(self.surfaces)

    @cached_property
    def occupancy(self) -> OccupancySamples:
        """Occupancy samples of all objects; sampled at first use, or read."""
        path, sizes = self.folder / "occupancy.npz", (POOL, VAL_POINTS, self.points, self.resolution)
        return cached_occupancy(path, self.surfaces, self.digests, *sizes, self.seed)

    def surface(self, label: int) -> Isosurface:
        """Load the stored surface of an object."""
        return self.surfaces[self.keys[label]]()

    @cached_property
    def reference(self) -> Callable[[int], tuple[SampledSurface, tuple[float, float]]]:
        """Function that samples an object's surface and scores a second sample of it; results are cached."""
        return cache(self._reference)

    def _reference(self, label: int) -> tuple[SampledSurface, tuple[float, float]]:
        surface = self.surface(label)

        def sample(purpose: str) -> SampledSurface:
            rng = numpy_generator(self.seed, "reconstruct", "surface", purpose, self.keys[label])
            sampled = sample_mesh(surface.vertices, surface.faces, self.points, rng)
            assert sampled is not None  # Object Files without a surface are refused when read
            return sampled

        truth = sample("truth")
        return truth, surface_scores(sample("floor"), truth)

    def floor(self, labels: Sequence[int] | np.ndarray) -> dict[str, float]:
        """Return the mean surface scores of a second sample of objects: those of a perfect prediction."""
        return self._means(np.array([self.reference(int(label))[1] for label in labels]), labels)

    def _means(self, surfaces: np.ndarray, labels: Sequence[int] | np.ndarray) -> dict[str, float]:
        """Average surface scores (N, 2) of objects; the distance also in centimetres."""
        sides = 100 * np.array([self.sides[self.keys[label]] for label in labels])
        return {
            "chamfer_l1": float(surfaces[:, 0].mean()),
            "chamfer_cm": float((surfaces[:, 0] * sides).mean()),
            "normal_consistency": float(surfaces[:, 1].mean()),
        }

    def scores(
        self,
        purpose: str,
        labels: np.ndarray,
        inside: Callable[[int], np.ndarray],
        mesh: Callable[[int], tuple[np.ndarray, np.ndarray]],
    ) -> dict[str, Any]:
        """Score N predictions of objects, labels (N,); ``purpose`` seeds the points on their surfaces.

        ``inside`` returns which of ``occupancy.score_points`` are inside the i-th prediction, ``mesh`` its
        vertices and faces. Returns means of ``iou``, ``chamfer_l1``, ``chamfer_cm`` (the same distance in
        centimetres) and ``normal_consistency``; ``samples``, the number of predictions, of which ``empty``
        have no surface; ``per_object``, IoU by key.
        """
        iou, surfaces, empty = np.zeros(len(labels)), np.zeros((len(labels), 2)), 0
        for i, label in enumerate(labels):
            iou[i] = intersection_over_union(inside(i), self.occupancy.score_inside[label])
            rng = numpy_generator(self.seed, "reconstruct", "surface", purpose, str(i))
            predicted = sample_mesh(*mesh(i), self.points, rng)
            surfaces[i] = surface_scores(predicted, self.reference(int(label))[0])
            empty += predicted is None
        return {
            "iou": float(iou.mean()),
            **self._means(surfaces, labels),
            "samples": len(labels),
            "empty": empty,
            "per_object": {
                self.keys[label]: float(iou[labels == label].mean()) for label in np.unique(labels)
            },
        }

    def average_shape(self, train: np.ndarray, val: np.ndarray, test: np.ndarray) -> dict[str, Any]:
        """Score the mean occupancy of the objects ``train`` as a constant prediction of ``test``.

        All are labels. The ``threshold``, returned beside the `scores`, is chosen on the objects ``val``.
        """
        occupancy, side = self.occupancy, self.resolution

        def mean(inside: np.ndarray) -> np.ndarray:
            return inside[train].mean(0, dtype=np.float32)

        guess = mean(occupancy.val_inside)
        guesses = np.broadcast_to(guess, (len(val), len(guess)))
        level, _ = best_level(guesses, occupancy.val_inside[val], THRESHOLDS)
        grid = occupancy.grid(train).mean(0, dtype=np.float32).reshape(side, side, side)
        inside, mesh = mean(occupancy.score_inside) > level, extract_mesh(grid, level)
        return self.scores("average_shape", test, lambda i: inside, lambda i: mesh) | {"threshold": level}

    def known_shapes(self, purpose: str, answers: np.ndarray, test: np.ndarray) -> dict[str, Any]:
        """Score the shapes of known objects, ``answers`` (N,), as predictions of others, ``test`` (N,).

        Both are labels; see `scores`.
        """

        def mesh(i: int) -> tuple[np.ndarray, np.ndarray]:
            surface = self.surface(int(answers[i]))
            return surface.vertices, surface.faces

        return self.scores(purpose, test, lambda i: self.occupancy.score_inside[answers[i]], mesh)

    def nearest_shapes(self, known: np.ndarray, test: np.ndarray) -> np.ndarray:
        """Return the known object (K,) with the highest IoU to each of ``test`` (N,); labels, (N,)."""
        inside = self.occupancy.score_inside
        objects, rows = np.unique(test, return_inverse=True)
        nearest = [known[np.argmax(intersection_over_union(inside[known], inside[one]))] for one in objects]
        return np.array(nearest)[rows]


def best_level(values: np.ndarray, inside: np.ndarray, levels: np.ndarray) -> tuple[float, float]:
    """Return the level of values (B, P) with the highest mean IoU to the truth (B, P), and that IoU.

    Ties go to the lowest level.
    """
    scores = [float(intersection_over_union(values > level, inside).mean()) for level in levels]
    best = int(np.argmax(scores))
    return float(levels[best]), scores[best]
