"""Localize a contact on a known object by touch, sound, sight or several (ObjectFolder Benchmark, CVPR 2023).

A net turns what was felt, heard or seen into a belief over places on the object's surface. Logarithms of
beliefs add up: of several senses, and of several contacts of a robot that knows how it moved between them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.distance import cdist
from torch.nn import functional as F

from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.datasets.contacts import TOGETHER, contact_split, sample_contacts
from objectfolder.benchmarks.datasets.samples import has_uncertain_sound
from objectfolder.benchmarks.models.inputs import shift_each
from objectfolder.benchmarks.models.localizer import SOFTNESS, Localizer, add_beliefs, choose_likeliest
from objectfolder.benchmarks.models.training import EpochPoint, Objective, count_batches, shuffle
from objectfolder.benchmarks.scoring.scores import over_seeds
from objectfolder.benchmarks.tasks.job import Job, ObjectJob, in_chunks
from objectfolder.benchmarks.tasks.localize import SENSES, LocalizeConfig

LETTERS = {"T": "touch", "A": "audio", "V": "vision"}
WEIGHTS = (0.25, 0.5, 1.0)  #: of the belief by a sense in that by several, of which the last counts in full
PLACES = 1000  #: on the surface, among which the answer is
#: Sizes of inputs that the nearest contact is sought by.
POOLED = {"touch": (16, 12), "audio": (64, 8), "vision": (12, 12)}

Batch = tuple[torch.Tensor, torch.Tensor]  #: inputs, and beliefs


def localize(job: Job[LocalizeConfig], letters: str = "TAV") -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score the localization of contacts on one object.

    Nets learn a belief with a deviation of `SOFTNESS` around the true place. The answer is the place with
    the least expected distance. The best epoch is chosen on the validation contacts. At a known place, what
    is felt, heard and seen is independent, so that the belief by several senses is the product of their
    nets'; how much each but the last counts in it is chosen on the validation contacts. ``together`` are the
    answers after `TOGETHER` contacts with known moves between them. Letters are the senses that there are.

    Returns scores: errors as shares of the longest side. By those of ``SENSES`` that there are: ``net`` and
    ``nearest`` (the training contact with the most similar input), each with ``mean``, ``median`` and
    ``together``, and ``interval_95`` and ``seeds`` of the net's mean; of several also ``weights``, by seed.
    ``random``: a random place; ``constant``: the place with the least mean distance to the training contacts.
    ``contacts`` by part, and ``seconds``.
    """
    points = job.observations.read("point", np.arange(len(job.observations)))
    setting = _Setting.of(job, points, letters)
    seeds = range(job.params.seeds)
    finished = {(run, letter): _train_once(job, setting, run, letter) for run in seeds for letter in letters}
    scores: dict[str, Any] = {}
    for name in (name for name in SENSES if set(name) <= set(letters)):
        if len(name) == 1:
            runs = [finished[run, name]["scores"] for run in seeds]
        else:
            weights = [_choose_weights(job, setting, run, name) for run in seeds]
            runs = [setting.scores(_joint(job, run, name, "test", weights[run])) for run in seeds]
        net = {kind: float(np.mean([run[kind] for run in runs])) for kind in runs[0]}
        net |= over_seeds("mean", [run["mean"] for run in runs])
        scores[name] = {"net": net, "nearest": _nearest(job, setting, name)}
        if len(name) > 1:
            scores[name]["weights"] = weights
    train, test = points[job.split.train], points[job.split.test]
    spread = _between(setting.places, test)
    constant = np.argmin(_between(setting.places, train).mean(1))
    curve = [[run, letter, *row] for (run, letter), unit in finished.items() for row in unit["curve"]]
    return {
        **scores,
        "random": float(spread.mean()),
        "constant": float(spread[constant].mean()),
        "contacts": {part: len(getattr(job.split, part)) for part in ("train", "val", "test")},
        "seconds": sum(unit["seconds"] for unit in finished.values()),
    }, curve


@dataclass(frozen=True)
class _Setting:
    """What all nets of an object share."""

    places: np.ndarray  #: (P, 3), unit frame
    distances: np.ndarray  #: (P, P), between them
    targets: torch.Tensor  #: (N, P), the belief that each contact shall give
    inputs: dict[str, torch.Tensor]  #: of all contacts, by letter
    tests: np.ndarray  #: (n, 3), points of the test contacts
    groups: np.ndarray  #: (n, TOGETHER) test contacts of each sequence, the last of which is asked for

    @classmethod
    def of(cls, job: Job[LocalizeConfig], points: np.ndarray, letters: str) -> "_Setting":
        rng = numpy_generator(job.seed, "localize", "places")
        train, test = points[job.split.train], points[job.split.test]
        places = train[rng.permutation(len(train))[:PLACES]]
        every = np.arange(len(points))
        groups = [
            [*rng.choice(np.delete(np.arange(len(test)), k), TOGETHER - 1, replace=False), k]
            for k in range(len(test))
        ]
        squares = torch.from_numpy(_between(points, places) ** 2)
        return cls(
            places,
            _between(places, places),
            torch.softmax(-squares / (2 * SOFTNESS**2), 1).float(),
            {letter: in_chunks(partial(job.inputs, LETTERS[letter]), every) for letter in letters},
            test,
            np.array(groups),
        )

    def errors(self, belief: np.ndarray, truth: np.ndarray) -> np.ndarray:
        """Return the errors (N,) of beliefs (N, P) about contacts at points (N, 3)."""
        return np.linalg.norm(self.places[choose_likeliest(belief, self.distances)] - truth, axis=1)

    def scores(self, belief: np.ndarray) -> dict[str, float]:
        """Score the beliefs (n, P) of the test contacts."""
        single = self.errors(belief, self.tests)
        joint = [
            add_beliefs(belief[group], self.tests[group] - self.tests[group[-1]], self.places)
            for group in self.groups
        ]
        together = self.errors(np.array(joint), self.tests)
        return {
            "mean": float(single.mean()),
            "median": float(np.median(single)),
            "together": float(together.mean()),
        }


def _between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the distances between points, (N, 3) and (M, 3) -> (N, M)."""
    return np.linalg.norm(first[:, None] - second, axis=2)


def _nearest(job: Job[LocalizeConfig], setting: _Setting, name: str) -> dict[str, float]:
    """Score answers by how similar inputs are to those of the training contacts, averaged to a few pixels.

    One contact alone is answered by the training contact with the nearest inputs. ``together`` needs beliefs:
    they fall with the squared distance of the inputs, over twice the median squared distance of a training
    contact to its nearest.
    """
    parts = []
    for letter in name:
        pooled = (
            F.adaptive_avg_pool2d(setting.inputs[letter], POOLED[LETTERS[letter]]).flatten(1).cpu().numpy()
        )
        centred = pooled - pooled[job.split.train].mean(0)
        size = np.sqrt(np.mean(np.sum(centred[job.split.train] ** 2, axis=1)))
        parts.append(centred / (size if size > 0 else 1))  # 0 if all sounds are silent
    features = np.concatenate(parts, 1).astype(np.float64)
    train, test = features[job.split.train], features[job.split.test]
    own = cKDTree(train).query(train, 2)[0][:, 1]
    squares = cdist(test, train, "sqeuclidean")
    points = job.observations.read("point", job.split.train)
    of_place = cKDTree(points).query(setting.places)[1]
    belief = -squares[:, of_place] / (2 * max(float(np.median(own**2)), 1e-12))
    errors = np.linalg.norm(points[squares.argmin(1)] - setting.tests, axis=1)
    return setting.scores(belief) | {"mean": float(errors.mean()), "median": float(np.median(errors))}


def _train_once(job: Job[LocalizeConfig], setting: _Setting, run: int, letter: str) -> dict[str, Any]:
    """Return the scores of one net, trained unless finished earlier; its beliefs are kept."""
    checkpoint = job.progress / f"{run}_{letter}.pt"

    def score(net: Localizer) -> dict[str, Any]:
        beliefs = {part: _belief(setting, net, letter, getattr(job.split, part)) for part in ("val", "test")}
        write_npz(_beliefs_path(job, run, letter), **beliefs)
        return {"scores": setting.scores(beliefs["test"])}

    return job.train_once(
        f"{run}_{letter}", lambda: _train(job, setting, run, letter, checkpoint), score, [checkpoint]
    )


def _beliefs_path(job: Job[LocalizeConfig], run: int, letter: str) -> Path:
    return job.progress / f"{run}_{letter}.npz"


def _joint(job: Job[LocalizeConfig], run: int, name: str, part: str, weights: Sequence[float]) -> np.ndarray:
    """Return the weighted sum of beliefs of finished nets about the contacts of a part, (n, P)."""
    beliefs = [read_npz(_beliefs_path(job, run, letter), part)[part] for letter in name]
    return np.tensordot(weights, beliefs, 1)


def _choose_weights(job: Job[LocalizeConfig], setting: _Setting, run: int, name: str) -> list[float]:
    """Choose how much each sense counts, by the mean error of the validation contacts."""
    truth = job.observations.read("point", job.split.val)
    choices = [[*some, 1.0] for some in product(WEIGHTS, repeat=len(name) - 1)]
    errors = [setting.errors(_joint(job, run, name, "val", some), truth).mean() for some in choices]
    return choices[int(np.argmin(errors))]


def _train(
    job: Job[LocalizeConfig], setting: _Setting, run: int, letter: str, checkpoint: Path
) -> tuple[Localizer, list[EpochPoint]]:
    params, train = job.params, job.split.train
    purpose = ("localize", job.observations.keys[0], str(run), letter)
    with seeded(job.seed, *purpose):
        net = Localizer(job.make_encoder(LETTERS[letter]), setting.places)

    def epoch_batches(epoch: int) -> Iterator[Batch]:
        rng = numpy_generator(job.seed, *purpose, f"epoch {epoch}")
        for rows in shuffle(train, params.batch, rng):
            inputs = setting.inputs[letter][rows]
            if letter == "T" and job.encode.shift:
                inputs = shift_each(inputs, job.encode.shift, rng)
            yield inputs, setting.targets[rows].to(job.device)

    def batch_loss(batch: Batch) -> torch.Tensor:
        inputs, targets = batch
        # The loss of a net that gives exactly these beliefs is 0.
        return F.kl_div(net(inputs), targets, reduction="batchmean")

    truth = job.observations.read("point", job.split.val)

    def val_score() -> float:
        return -float(setting.errors(_belief(setting, net, letter, job.split.val), truth).mean())

    curve = job.train(
        f"localize {letter}, seed {run + 1} of {params.seeds}",
        Objective(net, epoch_batches, batch_loss, val_score, "minus error"),
        checkpoint,
        cycle=params.epochs * count_batches(len(train), params.batch),
    )
    return net, curve


@torch.no_grad()
def _belief(setting: _Setting, net: Localizer, letter: str, rows: np.ndarray) -> np.ndarray:
    """Return the beliefs of a net about contacts, (n, P)."""
    return in_chunks(lambda some: net(setting.inputs[letter][some]), rows).double().cpu().numpy()


def localize_object(job: ObjectJob[LocalizeConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Touch, strike and look at an object, and `localize` these contacts.

    Scores also hold its ``scale``, m, and ``diameter``, the greatest distance between two of its points over
    its longest side.

    If its sound is marked uncertain, contacts are localized without it, and scores say so: ``uncertain``.

    Raises ObjectFolderError if the object cannot be touched or heard, or there are too few contacts.
    """
    assert job.encode is not None
    count = job.params.contacts
    contacts, split = sample_contacts(job.file, count, job.seed, job.encode.image), contact_split(count)
    given = job.params, job.encode, job.seed, job.progress, job.weights, job.device, job.report
    marked = has_uncertain_sound(job.file)
    if marked:
        job.report(f"{job.file.key}: its sound is marked uncertain, so contacts are localized without it")
    lacking = {"A": marked, "V": "vision" not in job.file.header}
    letters = "".join(letter for letter in LETTERS if not lacking.get(letter))
    scores, curve = localize(Job(contacts, split, *given), letters)
    scores |= {"scale": job.file.scale, "diameter": _diameter(job.file.surface.vertices)}
    return scores | ({"uncertain": True} if marked else {}), curve


def _diameter(points: np.ndarray) -> float:
    """Return the greatest distance between two points (N, 3)."""
    hull = points[ConvexHull(points).vertices]
    return max(float(cdist(part, hull).max()) for part in np.array_split(hull, -(-len(hull) // 1000)))
