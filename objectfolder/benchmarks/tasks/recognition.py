"""Instance recognition from a view, a sound, a touch, and all of their combinations (supplementary I.1)."""

import copy
import time
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import torch
from annotated_types import Interval
from torch import nn

from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.models.training import EpochPoint, TrainingConfig, batch_count, shuffled
from objectfolder.benchmarks.scoring.scores import accuracy, interval_95
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.running import Task
from objectfolder.errors import ObjectFolderError
from objectfolder.seeding import numpy_generator, seeded
from objectfolder.settings import Count

LETTERS = {"V": "vision", "A": "audio", "T": "touch"}
#: V, A, T, VA, VT, AT, VAT: input modalities; the rows of the main paper's Table 2.
COMBINATIONS = tuple("".join(letters) for size in (1, 2, 3) for letters in combinations(LETTERS, size))
CURVE_COLUMNS = ("seed", "modalities", "epoch", "train_loss", "val_accuracy")  #: of the training curves
FUSION_RATE = 0.1  #: learning rate of trained encoders relative to new ones

Inputs = dict[str, torch.Tensor]  #: by letter


@dataclass(frozen=True, kw_only=True)
class RecognizeConfig(TrainingConfig):
    """Section ``recognize`` of ``params.yaml``."""

    seeds: Count  #: runs whose mean is the result
    fusion_epochs: Count  #: of several modalities together, after each was trained alone
    schedule: Literal["cosine", "one_cycle"]  #: `objectfolder.benchmarks.models.training.train`
    label_smoothing: Annotated[float, Interval(ge=0, lt=1)]


class Classifier(nn.Module):
    """Encoders, one per modality, and a linear layer from their features to classes.

    Parameters
    ----------
    encoders : dict
        By letter; each with an attribute ``features``.
    classes : int
    """

    def __init__(self, encoders: dict[str, nn.Module], classes: int):
        super().__init__()
        self.encoders = nn.ModuleDict(encoders)
        width = sum(cast(int, encoder.features) for encoder in encoders.values())
        self.head = nn.Linear(width, classes)

    def forward(self, inputs: Inputs) -> torch.Tensor:
        """Inputs (B, C, H, W) of each encoder -> (B, classes) logits."""
        features = [encoder(inputs[letter]) for letter, encoder in self.encoders.items()]
        return self.head(torch.cat(features, 1))


def join_classifiers(parts: Sequence[Classifier]) -> Classifier:
    """Join trained classifiers of different modalities.

    The joint classifier initially outputs the sum of their logits, the product of their probabilities, which
    is exact for observations that are conditionally independent given the object.
    """
    encoders = {name: copy.deepcopy(net) for part in parts for name, net in part.encoders.items()}
    with seeded(0, "fused"):  # the layer is filled below
        net = Classifier(encoders, parts[0].head.out_features)
    net.head.load_state_dict(
        {
            "weight": torch.cat([part.head.weight.detach() for part in parts], 1),
            "bias": sum(part.head.bias.detach() for part in parts),
        }
    )
    return net


def recognize(job: Job[RecognizeConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score the recognition of instances (main paper, Table 2).

    Each modality alone is an encoder with a linear classifier. A combination starts from the nets of its
    modalities with the same seed (`join_classifiers`) and is trained jointly. The best epoch is chosen on the
    validation rows; the test rows are evaluated once, with that epoch.

    Returns
    -------
    dict
        By combination (``V`` to ``VAT``) the ``accuracy``, its ``interval_95`` (half width over the training
        seeds, None for one), and the accuracies of the ``seeds``; ``confusion`` of VAT (K, K), by object and
        answer, summed over the seeds; ``chance`` (``uniform``: 1/K, ``majority``: the share of the commonest
        object in the test rows); the counts of `Job.without_duplicates`, and ``seconds`` of training.
    list
        Rows of the training curves: `CURVE_COLUMNS`.

    Raises
    ------
    ObjectFolderError
        If a test object is absent from training, a part of the split is empty, training diverges, or the
        encoder is unknown.
    """
    keys, split, params = job.observations.keys, job.split, job.params
    unknown = np.setdiff1d(job.observations.labels[split.test], job.observations.labels[split.train])
    if unknown.size:
        raise ObjectFolderError(
            f"split {split.name}: test class {keys[unknown[0]]} is absent from training; use --split seen"
        )
    job, rows = job.without_duplicates(tuple(LETTERS.values()))
    finished = {
        (run, name): _finished(job, run, name) for run in range(params.seeds) for name in COMBINATIONS
    }
    labels, classes = job.observations.labels[job.split.test], len(keys)
    scores: dict[str, Any] = {}
    for name in COMBINATIONS:
        predicted = [np.array(finished[run, name]["predicted"]) for run in range(params.seeds)]
        accuracies = [accuracy(p, labels) for p in predicted]
        scores[name] = {
            "accuracy": float(np.mean(accuracies)),
            "interval_95": interval_95(accuracies),
            "seeds": accuracies,
        }
    confusion = np.zeros((classes, classes), np.int64)
    for answer in predicted:  # of VAT, the last
        np.add.at(confusion, (labels, answer), 1)
    curve = [[run, name, *row] for (run, name), unit in finished.items() for row in unit["curve"]]
    return {
        **scores,
        "confusion": confusion.tolist(),
        "chance": {"uniform": 1 / classes, "majority": float(np.bincount(labels).max() / len(labels))},
        **rows,
        "seconds": sum(unit["seconds"] for unit in finished.values()),
    }, curve


def _finished(job: Job[RecognizeConfig], run: int, name: str) -> dict[str, Any]:
    """Return the results of one combination with one seed, trained unless finished earlier."""

    def make() -> dict[str, Any]:
        net, curve = _trained(job, run, name)
        start = time.perf_counter()
        predicted = _predicted(job, net, name, job.split.test)
        seconds = sum(point.seconds for point in curve) + time.perf_counter() - start
        rows = [astuple(point)[:3] for point in curve]
        return {"predicted": predicted.tolist(), "curve": rows, "seconds": seconds}

    result = job.finished(f"{run}_{name}", make)
    # Fusion needs the nets of single modalities, so they are kept until a seed is finished.
    for done in COMBINATIONS if name == COMBINATIONS[-1] else [name] * (len(name) > 1):
        _checkpoint(job, run, done).unlink(missing_ok=True)
    return result


def _trained(job: Job[RecognizeConfig], run: int, name: str) -> tuple[Classifier, list[EpochPoint]]:
    """Train one combination, or read its finished checkpoint."""
    params, split, labels = job.params, job.split, job.observations.labels
    if len(name) > 1:
        net = join_classifiers([_trained(job, run, letter)[0] for letter in name])
        epochs, rate = params.fusion_epochs, FUSION_RATE
    else:
        with seeded(job.seed, "recognize", str(run), name):
            net = Classifier({name: job.make_encoder(LETTERS[name])}, len(job.observations.keys))
        epochs, rate = params.epochs, 1.0

    def epoch_batches(epoch: int) -> Iterator[tuple[Inputs, torch.Tensor]]:
        rng = numpy_generator(job.seed, "recognize", str(run), name, str(epoch))
        for rows in shuffled(split.train, params.batch, rng):
            yield _inputs(job, name, rows, rng), job.labels(rows)

    def batch_loss(batch: tuple[Inputs, torch.Tensor]) -> torch.Tensor:
        inputs, expected = batch
        return nn.functional.cross_entropy(net(inputs), expected, label_smoothing=params.label_smoothing)

    steps = epochs * batch_count(len(split.train), params.batch)
    curve = job.train(
        f"recognize {name}, seed {run + 1} of {params.seeds}",
        net,
        epoch_batches,
        batch_loss,
        lambda: accuracy(_predicted(job, net, name, split.val), labels[split.val]),
        "accuracy",
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
def _predicted(job: Job[RecognizeConfig], net: Classifier, name: str, rows: np.ndarray) -> np.ndarray:
    """Return the predictions of a net for rows; (n,) int64."""
    parts = np.split(rows, range(job.params.batch, len(rows), job.params.batch))
    answers = [net(_inputs(job, name, part)).argmax(1) for part in parts]
    return torch.cat(answers).cpu().numpy()


RECOGNIZE = Task("recognize", RecognizeConfig, recognize, CURVE_COLUMNS, Observations)
