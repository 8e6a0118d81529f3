"""Baselines of grasp stability: the most frequent outcome, and classifiers of geometric measurements."""

import numpy as np
from sklearn.ensemble import GradientBoostingClassifier

from objectfolder.benchmarks.datasets.grasps import Grasps

#: Inputs of each classifier.
GEOMETRY: dict[str, tuple[str, ...]] = {
    "geometry": ("width", "offset"),
    "geometry_force": ("width", "offset", "force"),
}
#: Names of all baselines.
BASELINES = ("majority", "object_majority", *GEOMETRY)


def baselines(grasps: Grasps, train: np.ndarray, test: np.ndarray) -> dict[str, np.ndarray]:
    """Compute the predictions of all baselines for the test rows.

    Parameters
    ----------
    grasps : Grasps
    train, test : (n,), (m,) int arrays
        Rows; those of ``train`` with both outcomes.

    Returns
    -------
    dict
        By name of `BASELINES`, (m,) decision values: above 0 for success, higher for more likely.
        "majority": the most frequent outcome; "object_majority": that of the same object, or of all objects
        for one absent from training; "geometry": gradient boosted trees (Friedman 2001) on the opening of the
        jaws and the offset from the centre of mass, "geometry_force" with the force of the jaws, too.
    """
    outcomes, labels = grasps.success[train], grasps.labels
    share = outcomes.mean()
    of_object = [outcomes[labels[train] == i] for i in range(len(grasps.keys))]
    shares = np.array([values.mean() if len(values) else share for values in of_object])
    answers = {"majority": np.full(len(test), share - 0.5), "object_majority": shares[labels[test]] - 0.5}
    for name, measured in GEOMETRY.items():
        trees = GradientBoostingClassifier(random_state=0).fit(_numbers(grasps, measured, train), outcomes)
        answers[name] = trees.decision_function(_numbers(grasps, measured, test))
    return answers


def _numbers(grasps: Grasps, names: tuple[str, ...], rows: np.ndarray) -> np.ndarray:
    """Stack measured arrays as columns; (n, D) float64."""
    return np.column_stack([grasps.read(name, rows).astype(np.float64) for name in names])
