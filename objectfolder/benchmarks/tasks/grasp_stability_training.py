"""Grasp stability from a view, from touch, and from both (main paper, 4.4; supplementary H, I.4)."""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from sklearn.metrics import balanced_accuracy_score, roc_auc_score
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.datasets.grasps import Grasps
from objectfolder.benchmarks.models.baselines import predict_outcomes
from objectfolder.benchmarks.models.inputs import encoder_inputs
from objectfolder.benchmarks.models.training import EpochPoint, Objective, shuffle
from objectfolder.benchmarks.scoring.scores import accuracy, interval_95, over_seeds, wilson_95
from objectfolder.benchmarks.tasks.grasp_stability import GraspStabilityConfig
from objectfolder.benchmarks.tasks.job import Job

#: Input array of each stream of the net, V or T, by variant. Touches are simulated with Object Files or, if
#: "explicit", with the ground truth of the same contacts.
VARIANTS: dict[str, dict[str, str]] = {
    "V": {"V": "image"},
    "T": {"T": "touch"},
    "VT": {"V": "image", "T": "touch"},
    "T_explicit": {"T": "explicit"},
    "VT_explicit": {"V": "image", "T": "explicit"},
}
#: Nets trained on Object Files and tested with touches of the ground truth.
TRANSFERRED = {"T_on_explicit": "T", "VT_on_explicit": "VT"}
#: Differences of accuracies on the same rows: the first less the second.
COMPARED = (
    *(("T", "V"), ("VT", "V"), ("T_explicit", "T"), ("VT_explicit", "VT")),
    *TRANSFERRED.items(),
)
MODALITIES = {"V": "vision", "T": "touch"}  #: modality of each stream
PICTURES = {"V": 1, "T": 2}  #: per grasp; two fingers go through one encoder
FUSION_RATE = 0.1  #: learning rate of trained streams relative to new ones

Inputs = dict[str, torch.Tensor]  #: by stream


class StabilityNet(nn.Module):
    """A stream for vision, one for touch, or both, and two fully connected layers (supplementary I.4).

    Encoders, by stream "V" or "T", have an attribute ``features``. The one for touch sees both fingers, whose
    features are concatenated. Between the layers are ``hidden`` units.
    """

    def __init__(self, encoders: Mapping[str, nn.Module], hidden: int):
        super().__init__()
        self.encoders = nn.ModuleDict(dict(encoders))
        width = sum(PICTURES[stream] * cast(int, encoder.features) for stream, encoder in encoders.items())
        self.first, self.last = nn.Linear(width, hidden), nn.Linear(hidden, 1)

    def forward(self, inputs: Inputs) -> torch.Tensor:
        """Inputs (B, pictures, C, H, W) of each stream -> (B,) logits of success."""
        features = [
            encoder(inputs[stream].flatten(0, 1)).unflatten(0, inputs[stream].shape[:2]).flatten(1)
            for stream, encoder in self.encoders.items()
        ]
        return self.last(torch.relu(self.first(torch.cat(features, 1))))[:, 0]


def join_streams(parts: Sequence[StabilityNet], prior: float) -> StabilityNet:
    """Join trained nets of different streams.

    The joint net initially outputs the sum of their logits with the prior, the logit of the success rate,
    counted once, which is exact if the streams are conditionally independent given the outcome.
    """
    encoders = {name: copy.deepcopy(net) for part in parts for name, net in part.encoders.items()}
    with seeded(0, "fused"):  # the layers are filled below
        net = StabilityNet(encoders, sum(part.first.out_features for part in parts))
    with torch.no_grad():
        net.first.weight.copy_(torch.block_diag(*(part.first.weight for part in parts)))
        net.first.bias.copy_(torch.cat([part.first.bias for part in parts]))
        net.last.weight.copy_(torch.cat([part.last.weight for part in parts], 1))
        net.last.bias.copy_(torch.stack([part.last.bias - prior for part in parts]).sum(0) + prior)
    return net


def nested_order(rows: np.ndarray, labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Order rows at random so that, for every n, the first n are balanced over objects to within one."""
    order = rng.permutation(len(rows))
    of_object = labels[order]
    rank = np.zeros(len(rows), np.int64)
    for label in np.unique(labels):
        mine = of_object == label
        rank[mine] = np.arange(mine.sum())
    return rows[order[np.argsort(rank, kind="stable")]]


def grasp_stability(job: Job[GraspStabilityConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score the prediction of whether a grasp holds (main paper, 4.4; supplementary H and I.4).

    A single stream is an encoder with two fully connected layers; vision and touch together start from the
    nets of each with the same seed (`join_streams`) and are trained jointly. Smaller training sets are
    subsets of larger ones. Nets of touches from Object Files and ground truth have the same initial weights
    and see the same grasps in the same order. The best epoch is chosen on the validation rows, which are the
    same for every size.

    Raises ObjectFolderError if all training grasps have the same outcome, a part of the split is empty,
    training diverges, or the encoder is unknown.

    Returns ``sizes``: by number of training grasps what was ``asked`` for and, by variant (`VARIANTS`,
    `TRANSFERRED`, `BASELINES`), the ``accuracy`` on test rows, ``wilson_95`` (its interval over grasps of the
    same objects), the accuracies of the ``seeds`` and their ``interval_95`` (half width, None for one),
    ``balanced_accuracy`` and ``auc`` (None where all test grasps end alike); under ``compared``, as "A - B"
    of `COMPARED`, the paired ``difference`` of accuracies and its ``interval_95`` over rows. ``success``:
    shares in each part of the split; the counts of `Job.without_duplicates`, with equal camera images as
    duplicates, and ``seconds`` of training.
    """
    job, rows = job.without_duplicates(("image",))
    height, width = job.params.touch
    job = replace(job, encode=replace(job.encode, touch=(height, width)))
    grasps, split, params = cast(Grasps, job.observations), job.split, job.params
    names = [name for name, arrays in VARIANTS.items() if "explicit" not in arrays.values()]
    if grasps.has_explicit:
        names = list(VARIANTS)
    rng = numpy_generator(job.seed, "grasp_stability", split.name, "order")
    order = nested_order(split.train, grasps.labels[split.train], rng)
    sizes = {min(size, len(order)): size for size in reversed(params.sizes)}
    for size in sizes:
        _check_outcomes(grasps.success[order[:size]], split.name)
    curve: list[list[Any]] = []
    seconds, by_size = 0.0, {}
    for size in sorted(sizes):
        train = order[:size]
        told = job.compute_once(f"{size}_baselines", partial(_baselines, grasps, train, split.test))
        answers = {name: np.array([answer]) for name, answer in told.items()}
        for name in names:
            units = [_train_once(job, train, run, name, names[-1]) for run in range(params.seeds)]
            for answer in units[0]["logits"]:
                answers[answer] = np.array([unit["logits"][answer] for unit in units])
            curve += [[size, run, name, *row] for run, unit in enumerate(units) for row in unit["curve"]]
            seconds += sum(unit["seconds"] for unit in units)
        by_size[str(size)] = {"asked": sizes[size], **_measure(answers, grasps.success[split.test])}
    shares = {part: float(grasps.success[getattr(split, part)].mean()) for part in rows["rows"]}
    return {"sizes": by_size, "success": shares, **rows, "seconds": seconds}, curve


def _baselines(grasps: Grasps, train: np.ndarray, test: np.ndarray) -> dict[str, list[float]]:
    return {name: answer.tolist() for name, answer in predict_outcomes(grasps, train, test).items()}


def _check_outcomes(success: np.ndarray, split: str) -> None:
    if success.all() or not success.any():
        end = "succeed" if success[0] else "fail"
        raise ObjectFolderError(
            f"split {split}: the first {len(success)} training grasps all {end}, expected both outcomes; "
            "use a larger first size, or collect other grasps"
        )


def _measure(answers: Mapping[str, np.ndarray], success: np.ndarray) -> dict[str, Any]:
    """Score the predictions (seeds, n) of each variant for the same n rows; above 0 for success."""
    both = len(np.unique(success)) == 2
    scores: dict[str, Any] = {}
    for name, logits in answers.items():
        accuracies = [accuracy(answer > 0, success) for answer in logits]
        balanced = [balanced_accuracy_score(success, answer > 0) for answer in logits if both]
        areas = [roc_auc_score(success, answer) for answer in logits if both]
        scores[name] = over_seeds("accuracy", accuracies) | {
            "wilson_95": wilson_95(round(np.mean(accuracies) * len(success)), len(success)),
            "balanced_accuracy": float(np.mean(balanced)) if both else None,
            "auc": float(np.mean(areas)) if both else None,
        }
    right = {name: ((logits > 0) == success).mean(0) for name, logits in answers.items()}
    scores["compared"] = {
        f"{first} - {second}": {
            "difference": float(np.mean(right[first] - right[second])),
            "interval_95": interval_95(list(right[first] - right[second])),
        }
        for first, second in COMPARED
        if first in right
    }
    return scores


def _train_once(
    job: Job[GraspStabilityConfig], train: np.ndarray, run: int, name: str, last: str
) -> dict[str, Any]:
    """Return the predictions of one variant with one seed, trained unless finished earlier."""

    def score(net: StabilityNet) -> dict[str, Any]:
        given = {name: VARIANTS[name]}
        if cast(Grasps, job.observations).has_explicit:
            transferred = [answer for answer, source in TRANSFERRED.items() if source == name]
            given |= {answer: VARIANTS[name] | {"T": "explicit"} for answer in transferred}
        test = job.split.test
        return {"logits": {answer: _logits(job, net, of, test).tolist() for answer, of in given.items()}}

    # Fusion needs the nets of single streams, so they are kept until a seed is finished.
    done = VARIANTS if name == last else [name] * (len(VARIANTS[name]) > 1)
    spent = [_checkpoint(job, train, run, one) for one in done]
    return job.train_once(
        _checkpoint(job, train, run, name).stem, lambda: _train(job, train, run, name), score, spent
    )


def _train(
    job: Job[GraspStabilityConfig], train: np.ndarray, run: int, name: str
) -> tuple[StabilityNet, list[EpochPoint]]:
    """Train one variant, or read its finished checkpoint."""
    params, split, arrays = job.params, job.split, VARIANTS[name]
    success = cast(Grasps, job.observations).success
    # The same for touches of either source, so that only the inputs differ.
    purpose = ("grasp_stability", split.name, str(len(train)), str(run), "".join(arrays))
    if len(arrays) > 1:
        share = success[train].mean()
        parts = [part for part, of in VARIANTS.items() if len(of) == 1 and of.items() <= arrays.items()]
        alone = [_train(job, train, run, part)[0] for part in parts]
        net = join_streams(alone, float(np.log(share / (1 - share))))
        epochs, rate = params.fusion_epochs, FUSION_RATE
    else:
        with seeded(job.seed, *purpose):
            encoders = {stream: job.make_encoder(MODALITIES[stream]) for stream in arrays}
            net = StabilityNet(encoders, params.hidden)
        epochs, rate = params.epochs, 1.0
    repeated = np.tile(train, max(1, params.epoch_grasps // len(train)))

    def epoch_batches(epoch: int) -> Iterator[tuple[Inputs, torch.Tensor]]:
        rng = numpy_generator(job.seed, *purpose, str(epoch))
        for rows in shuffle(repeated, params.batch, rng):
            yield _inputs(job, arrays, rows, rng), torch.from_numpy(success[rows]).float().to(job.device)

    def batch_loss(batch: tuple[Inputs, torch.Tensor]) -> torch.Tensor:
        inputs, expected = batch
        return nn.functional.binary_cross_entropy_with_logits(net(inputs), expected)

    def val_score() -> float:
        return accuracy(_logits(job, net, arrays, split.val) > 0, success[split.val])

    curve = job.train(
        f"grasp stability {split.name}, {name} of {len(train)}, seed {run + 1} of {params.seeds}",
        Objective(net, epoch_batches, batch_loss, val_score, "accuracy"),
        _checkpoint(job, train, run, name),
        epochs,
        rate,
    )
    return net, curve


def _checkpoint(job: Job[GraspStabilityConfig], train: np.ndarray, run: int, name: str) -> Path:
    return job.progress / f"{len(train)}_{run}_{name}.pt"


def _inputs(
    job: Job[GraspStabilityConfig],
    arrays: Mapping[str, str],
    rows: np.ndarray,
    rng: np.random.Generator | None = None,
) -> Inputs:
    """Return the stream inputs of a variant for rows; (B, pictures, C, H, W) each."""
    inputs = {}
    for stream, array in arrays.items():
        raw = job.observations.read(array, rows)
        pictures = raw.reshape(-1, *raw.shape[-3:])
        prepared = encoder_inputs(MODALITIES[stream], pictures, job.sizes, rng, job.device)
        inputs[stream] = prepared.unflatten(0, (len(rows), PICTURES[stream]))
    return inputs


@torch.no_grad()
def _logits(
    job: Job[GraspStabilityConfig], net: StabilityNet, arrays: Mapping[str, str], rows: np.ndarray
) -> np.ndarray:
    """Return the logits of a net for rows; (n,) float32, above 0 for success."""
    parts = np.split(rows, range(job.params.batch, len(rows), job.params.batch))
    return torch.cat([net(_inputs(job, arrays, part)) for part in parts]).float().cpu().numpy()
