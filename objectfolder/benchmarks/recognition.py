"""Which object is it? From a view, a sound, a touch, and all of their combinations (supplementary I.1)."""

import copy
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
import torch
from torch import nn

from objectfolder.artifacts import read_json, write_json
from objectfolder.benchmarks.encoders import InputSizes, Weights, make_encoder, prepare
from objectfolder.benchmarks.observations import Observations
from objectfolder.benchmarks.scores import accuracy, interval_95
from objectfolder.benchmarks.splits import Split, without_duplicates
from objectfolder.benchmarks.training import EpochPoint, shuffled, train
from objectfolder.errors import ObjectFolderError
from objectfolder.seeding import numpy_generator, seeded

LETTERS = {"V": "vision", "A": "audio", "T": "touch"}
#: V, A, T, VA, VT, AT, VAT: what an object is told by; the rows of the main paper's Table 2.
COMBINATIONS = tuple("".join(letters) for size in (1, 2, 3) for letters in combinations(LETTERS, size))
CURVE_COLUMNS = ("seed", "modalities", "epoch", "train_loss", "val_accuracy")  #: of the training curves
FUSION_RATE = 0.1  #: learning rate of encoders that are trained already, relative to that of new ones

Inputs = dict[str, torch.Tensor]  #: by letter


class Params(Protocol):
    """How the nets are trained; `objectfolder.benchmarks.params` has them."""

    seeds: int
    epochs: int
    fusion_epochs: int
    batch: int
    learning_rate: float
    weight_decay: float
    patience: int


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


def fused(parts: Sequence[Classifier]) -> Classifier:
    """Join trained classifiers of different modalities.

    It starts from the sum of their logits: the product of what each believes, which is right for
    observations that are independent of each other, given the object.
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


def recognize(
    observations: Observations,
    split: Split,
    params: Params,
    encoder: str,
    sizes: InputSizes,
    *,
    weights: Weights | None = None,
    seed: int,
    progress: Path,
    device: str | torch.device = "cpu",
    report: Callable[[str], None] = lambda line: None,
) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score the recognition of instances (main paper, Table 2).

    Each modality alone is an encoder with a linear classifier. A combination starts from the same seed's nets
    of its modalities (`fused`) and is trained jointly. The best epoch is chosen on the validation rows; the
    test rows are read once, with that one.

    Parameters
    ----------
    observations : Observations
    split : Split
        Kept-back rows that show what is learnt from are dropped.
    params : RecognizeParams
    encoder : str
        Registered in `objectfolder.benchmarks.encoders`.
    sizes : InputSizes
    weights : Weights, optional
        That all encoders start from; default: random ones.
    seed : int
    progress : Path
        Folder of what is finished, and of checkpoints. A call that was interrupted goes on from it: it
        must be empty, or of a call with the same arguments.
    device : str or torch.device, optional
    report : callable, optional
        Called with a line about each epoch.

    Returns
    -------
    dict
        By combination (``V`` to ``VAT``) the ``accuracy``, its ``interval_95`` (half width over the training
        seeds, None for one), and the accuracies of the ``seeds``; ``confusion`` of VAT (K, K), by object and
        answer, summed over the seeds; ``chance`` (``uniform``: 1/K, ``majority``: the share of the commonest
        object in the test rows); ``objects``, ``rows`` of each part of the split, ``duplicates`` that were
        dropped, and ``seconds`` of training.
    list
        Rows of the training curves: `CURVE_COLUMNS`.

    Raises
    ------
    ObjectFolderError
        If an object of the test rows is never learnt, nothing is left of a part of the split, a training
        diverges, or the encoder is unknown.
    """
    unknown = np.setdiff1d(observations.labels[split.test], observations.labels[split.train])
    if unknown.size:
        raise ObjectFolderError(
            f"split {split.name} tests with {observations.keys[unknown[0]]}, which is not learnt; nobody "
            "recognizes what he never met: use split seen"
        )
    split, duplicates = without_duplicates(split, observations, tuple(LETTERS.values()))
    task = _Task(observations, split, params, encoder, sizes, weights, seed, progress, device, report)
    finished = {
        (run, name): _finished(task, run, name) for run in range(params.seeds) for name in COMBINATIONS
    }
    labels, classes = observations.labels[split.test], len(observations.keys)
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
        "objects": classes,
        "rows": {part: len(getattr(split, part)) for part in ("train", "val", "test")},
        "duplicates": duplicates,
        "seconds": sum(unit["seconds"] for unit in finished.values()),
    }, curve


@dataclass(frozen=True)
class _Task:
    """Arguments of `recognize`."""

    observations: Observations
    split: Split
    params: Params
    encoder: str
    sizes: InputSizes
    weights: Weights | None
    seed: int
    progress: Path
    device: str | torch.device
    report: Callable[[str], None]

    def checkpoint(self, run: int, name: str) -> Path:
        return self.progress / f"{run}_{name}.pt"

    def inputs(self, name: str, rows: np.ndarray, rng: np.random.Generator | None = None) -> Inputs:
        """What the encoders of a combination are given of some rows."""
        return {
            letter: prepare(
                LETTERS[letter],
                self.observations.read(LETTERS[letter], rows),
                self.sizes,
                rng,
                self.device,
            )
            for letter in name
        }

    def labels(self, rows: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(self.observations.labels[rows]).to(self.device)

    def predicted(self, net: Classifier, name: str, rows: np.ndarray) -> np.ndarray:
        """Answers of a net for rows; (n,) int64."""
        with torch.no_grad():
            answers = [
                net(self.inputs(name, some)).argmax(1)
                for some in np.split(rows, range(self.params.batch, len(rows), self.params.batch))
            ]
        return torch.cat(answers).cpu().numpy()


def _finished(task: _Task, run: int, name: str) -> dict[str, Any]:
    """What one combination scored with one seed; trained if no earlier call did."""
    path = task.progress / f"{run}_{name}.json"
    if not path.is_file():
        net, curve = _trained(task, run, name)
        start = time.perf_counter()
        predicted = task.predicted(net, name, task.split.test)
        seconds = sum(point.seconds for point in curve) + time.perf_counter() - start
        rows = [astuple(point)[:3] for point in curve]
        write_json(path, {"predicted": predicted.tolist(), "curve": rows, "seconds": seconds})
    # Fusions start from the nets of single modalities, which are kept until the last of a seed.
    for done in COMBINATIONS if name == COMBINATIONS[-1] else [name] * (len(name) > 1):
        task.checkpoint(run, done).unlink(missing_ok=True)
    return read_json(path)


def _trained(task: _Task, run: int, name: str) -> tuple[Classifier, list[EpochPoint]]:
    """Train one combination; where its checkpoint is finished, that is read and no more."""
    params, split, labels = task.params, task.split, task.observations.labels
    if len(name) > 1:
        net = fused([_trained(task, run, letter)[0] for letter in name])
        epochs, learning_rate = params.fusion_epochs, params.learning_rate * FUSION_RATE
    else:
        with seeded(task.seed, "recognize", str(run), name):
            net = Classifier(
                {name: make_encoder(task.encoder, LETTERS[name], task.weights)}, len(task.observations.keys)
            )
        epochs, learning_rate = params.epochs, params.learning_rate

    def epoch_batches(epoch: int) -> Iterator[tuple[Inputs, torch.Tensor]]:
        rng = numpy_generator(task.seed, "recognize", str(run), name, str(epoch))
        for rows in shuffled(split.train, params.batch, rng):
            yield task.inputs(name, rows, rng), task.labels(rows)

    def batch_loss(batch: tuple[Inputs, torch.Tensor]) -> torch.Tensor:
        inputs, expected = batch
        return nn.functional.cross_entropy(net(inputs), expected)

    def report(point: EpochPoint) -> None:
        task.report(
            f"recognize {name}, seed {run + 1} of {params.seeds}, epoch {point.epoch} of {epochs}: "
            f"training loss {point.train_loss:.3f}, validation accuracy {point.val_score:.3f}, "
            f"{point.seconds:.0f} s"
        )

    curve = train(
        net,
        epoch_batches,
        batch_loss,
        lambda: accuracy(task.predicted(net, name, split.val), labels[split.val]),
        epochs=epochs,
        learning_rate=learning_rate,
        weight_decay=params.weight_decay,
        patience=params.patience,
        checkpoint=task.checkpoint(run, name),
        device=task.device,
        report=report,
    )
    return net, curve
