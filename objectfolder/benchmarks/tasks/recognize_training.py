"""Recognition of objects and materials from a view, a sound, a touch, and all of their combinations.

Objects: supplementary I.1. Materials: another label of the same observations.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import nn

from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.models.classifier import Classifier, Inputs, join_classifiers
from objectfolder.benchmarks.models.training import EpochPoint, Objective, count_batches, shuffle
from objectfolder.benchmarks.reporting.confusion import draw_confusion
from objectfolder.benchmarks.scoring.scores import accuracy, over_seeds
from objectfolder.benchmarks.scoring.together import accuracy_together, bound_alone, bound_together
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.recognize import (
    RecognizeConfig,
    Target,
    check_learnt,
    keep_learnt_materials,
    material_target,
)
from objectfolder.benchmarks.tasks.task import Objects
from objectfolder.benchmarks.tasks.touch_shapes import in_touch_frame

LETTERS = {"V": "vision", "A": "audio", "T": "touch"}
#: V, A, T, VA, VT, AT, VAT: input modalities; the rows of the main paper's Table 2.
COMBINATIONS = tuple("".join(letters) for size in (1, 2, 3) for letters in combinations(LETTERS, size))
TOUCHES = (1, 2, 4, 8, 16)  #: numbers of touches of one object that answer together
FLAT = 20e-6  #: relief in metres below which a touch is on flat ground, and tells nothing
PANELS = ("V", "A", "T", "VAT")  #: of the figure of confusion
FUSION_RATE = 0.1  #: learning rate of trained encoders relative to new ones


@dataclass(frozen=True)
class _Setting:
    """What all nets share."""

    #: By combination, without validation and test rows all of whose inputs of these modalities repeat.
    jobs: dict[str, Job[RecognizeConfig]]
    target: Target
    flat: np.ndarray  #: (n,) bool: test touches of "T" that tell nothing

    @classmethod
    def of(cls, job: Job[RecognizeConfig], repeats: dict[str, np.ndarray], target: Target) -> "_Setting":
        jobs = {
            name: job.without_repeats(repeats, [LETTERS[letter] for letter in name]) for name in COMBINATIONS
        }
        observations, test = cast(Observations, job.observations), jobs["T"].split.test
        return cls(jobs, target, (observations.relief(test) < FLAT) | observations.untouched(test))


def recognize(job: Job[RecognizeConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score the recognition of instances (main paper, Table 2).

    Each modality alone is an encoder with a linear classifier. A combination starts from the nets of its
    modalities with the same seed (`join_classifiers`) and is trained jointly. The best epoch is chosen on the
    validation rows; the test rows are evaluated once, with that epoch. Several test touches of an object
    answer together by the mean of their log probabilities.

    Raises ObjectFolderError if a test object is absent from training, a part of the split is empty, training
    diverges, or the encoder is unknown.

    Returns scores: by combination (``V`` to ``VAT``) the ``accuracy``, its ``interval_95`` (half width over
    the training seeds, None for one), and the accuracies of the ``seeds``; ``touches`` and
    ``touches_not_flat``: the same by number of touches, of all and of those with a relief of `FLAT` or more,
    with their ``bound`` (`bound_together`), also of T (`bound_alone`); ``flat``, the share of test touches
    that are on flat ground or miss the object, and their ``flat_accuracy``, if there are any; ``confusion``
    of VAT (K, K), by object and answer, summed over the seeds; ``chance`` (``uniform``: 1/K of the K classes
    that are learnt, ``majority``: the share of the commonest object in the test rows); `Job.counts` before
    any row is dropped; ``untested``, by combination the objects without a test row; and ``seconds`` of
    training.
    """
    objects = Objects(job.observations.keys, job.observations.labels)
    check_learnt(job.split, objects)
    return _classify(job, Target(job.observations.keys, objects.labels))


def classify_materials(job: Job[RecognizeConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score the classification of materials; otherwise as `recognize`.

    Validation and test rows of materials that no training object has are left out.

    Raises ObjectFolderError if all objects for training are of one material, or none for the test is of a
    material of theirs.

    Returns the scores of `recognize`, by material; also the ``materials`` and those ``left_out``.
    """
    observations, split = job.observations, job.split
    materials = [str(observations.records[key]["material"]) for key in observations.keys]
    objects = Objects(observations.keys, observations.labels, materials)
    target, learnt = material_target(objects), keep_learnt_materials(split, objects)
    left_out = np.setdiff1d(
        target.labels[np.concatenate([split.val, split.test])], target.labels[split.train]
    )
    scores, curve = _classify(replace(job, split=learnt), target)
    return scores | {
        "materials": list(target.names),
        "left_out": [target.names[label] for label in left_out],
    }, curve


def _classify(job: Job[RecognizeConfig], target: Target) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score all combinations; see `recognize`."""
    seeds = range(job.params.seeds)
    job.check_sizes(LETTERS.values())
    job = in_touch_frame(job)
    repeats = job.repeats(LETTERS.values(), target.labels)
    setting = _Setting.of(job, repeats, target)
    finished = {(run, name): _train_once(setting, run, name) for run in seeds for name in COMBINATIONS}
    classes = len(target.names)
    scores: dict[str, Any] = {}
    confusion = {name: np.zeros((classes, classes), np.int64) for name in COMBINATIONS}
    for name, used in setting.jobs.items():
        labels = target.labels[used.split.test]
        predicted = [np.array(finished[run, name]["predicted"]) for run in seeds]
        scores[name] = over_seeds("accuracy", [accuracy(p, labels) for p in predicted])
        for answer in predicted:
            np.add.at(confusion[name], (labels, answer), 1)
    title = f"Answers of split {job.split.name}, share of each class"
    draw_confusion(title, {k: confusion[k] for k in PANELS}, target.names, job.progress / "sheet.png")
    scores["T"]["bound"] = bound_alone(setting.flat, target.labels[setting.jobs["T"].split.test])
    curve = [[run, name, *row] for (run, name), unit in finished.items() for row in unit["curve"]]
    learnt, tested = (target.labels[rows] for rows in (job.split.train, job.split.test))
    return {
        **scores,
        **_touches(setting, [finished[run, "T"] for run in seeds]),
        "confusion": confusion["VAT"].tolist(),
        "chance": {
            "uniform": 1 / len(np.unique(learnt)),
            "majority": float(np.bincount(tested).max() / len(tested)),
        },
        **job.counts(repeats),
        "untested": {name: lost for name, used in setting.jobs.items() if (lost := job.untested(used))},
        "seconds": sum(unit["seconds"] for unit in finished.values()),
    }, curve


def _touches(setting: _Setting, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the scores by number of touches over the seeds, with bounds."""
    flat, labels, objects = setting.flat, *_of_touches(setting)
    scores: dict[str, Any] = {"flat": float(flat.mean())}
    if flat.any():
        right = [np.array(run["predicted"])[flat] == labels[flat] for run in runs]
        scores["flat_accuracy"] = float(np.mean(right))
    for kind, used in _kinds(flat).items():
        scores[kind] = {
            size: over_seeds("accuracy", [run["together"][kind][size] for run in runs])
            | {"bound": bound_together(flat[used], labels[used], objects[used], int(size))}
            for size in runs[0]["together"][kind]
        }
    return scores


def _kinds(flat: np.ndarray) -> dict[str, np.ndarray]:
    """Return which of the test touches are used, by the name of their scores."""
    return {"touches": np.ones_like(flat), "touches_not_flat": ~flat}


def _of_touches(setting: _Setting) -> tuple[np.ndarray, np.ndarray]:
    """Return the classes and the objects of the test touches."""
    job = setting.jobs["T"]
    return setting.target.labels[job.split.test], job.observations.labels[job.split.test]


def _together(setting: _Setting, logits: torch.Tensor) -> dict[str, dict[str, float]]:
    """Score test touches by number, as far as an object has so many; by kind and number."""
    log_probabilities = logits.double().log_softmax(1).numpy()
    labels, objects = _of_touches(setting)
    scores: dict[str, dict[str, float]] = {}
    for kind, used in _kinds(setting.flat).items():
        scores[kind] = {}
        for size in TOUCHES:
            rng = numpy_generator(setting.jobs["T"].seed, "recognize", kind, str(size))
            score = accuracy_together(log_probabilities[used], labels[used], objects[used], size, rng)
            if score is not None:
                scores[kind][str(size)] = score
    return scores


def _train_once(setting: _Setting, run: int, name: str) -> dict[str, Any]:
    """Return the results of one combination with one seed, trained unless finished earlier."""
    job = setting.jobs[name]

    def score(net: Classifier) -> dict[str, Any]:
        logits = _logits(job, net, name, job.split.test)
        together = {"together": _together(setting, logits)} if name == "T" else {}
        return {"predicted": logits.argmax(1).tolist(), **together}

    # Fusion needs the nets of single modalities, so they are kept until a seed is finished.
    done = COMBINATIONS if name == COMBINATIONS[-1] else [name] * (len(name) > 1)
    spent = [_checkpoint(job, run, one) for one in done]
    return job.train_once(f"{run}_{name}", lambda: _train(setting, run, name), score, spent)


def _train(setting: _Setting, run: int, name: str) -> tuple[Classifier, list[EpochPoint]]:
    """Train one combination, or read its finished checkpoint."""
    job, target = setting.jobs[name], setting.target
    params, split, labels = job.params, job.split, target.labels
    if len(name) > 1:
        net = join_classifiers([_train(setting, run, letter)[0] for letter in name])
        epochs, rate = params.fusion_epochs, FUSION_RATE
    else:
        with seeded(job.seed, "recognize", str(run), name):
            net = Classifier({name: job.make_encoder(LETTERS[name])}, len(target.names))
        epochs, rate = params.epochs, 1.0

    def epoch_batches(epoch: int) -> Iterator[tuple[Inputs, torch.Tensor]]:
        rng = numpy_generator(job.seed, "recognize", str(run), name, str(epoch))
        for rows in shuffle(split.train, params.batch, rng):
            yield _inputs(job, name, rows, rng), torch.from_numpy(labels[rows]).to(job.device)

    def batch_loss(batch: tuple[Inputs, torch.Tensor]) -> torch.Tensor:
        inputs, expected = batch
        return nn.functional.cross_entropy(net(inputs), expected, label_smoothing=params.label_smoothing)

    def val_score() -> float:
        return accuracy(_logits(job, net, name, split.val).argmax(1).numpy(), labels[split.val])

    steps = epochs * count_batches(len(split.train), params.batch)
    curve = job.train(
        f"recognize {name}, seed {run + 1} of {params.seeds}",
        Objective(net, epoch_batches, batch_loss, val_score, "accuracy"),
        _checkpoint(job, run, name),
        epochs,
        rate,
        steps if params.schedule == "one_cycle" else None,
    )
    return net, curve


def _checkpoint(job: Job[RecognizeConfig], run: int, name: str) -> Path:
    return job.progress / f"{run}_{name}.pt"


def _inputs(
    job: Job[RecognizeConfig], name: str, rows: np.ndarray, rng: np.random.Generator | None = None
) -> Inputs:
    """Return the encoder inputs of a combination for rows."""
    return {letter: job.inputs(LETTERS[letter], rows, rng) for letter in name}


@torch.no_grad()
def _logits(job: Job[RecognizeConfig], net: Classifier, name: str, rows: np.ndarray) -> torch.Tensor:
    """Return the logits of a net for rows; (n, K), on the CPU."""
    parts = np.split(rows, range(job.params.batch, len(rows), job.params.batch))
    return torch.cat([net(_inputs(job, name, part)) for part in parts]).cpu()
