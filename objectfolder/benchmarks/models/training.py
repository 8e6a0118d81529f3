"""Training of all benchmark nets: epochs, validated after each."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.settings import Precision
from objectfolder.nets.checkpoint import (
    Checkpoint,
    Training,
    TrainingState,
    copy_state,
    identity,
    run_training,
)

WARM_UP = 20  #: steps of linear learning rate warm-up
RISE = 0.2  #: share of a cycle in which the learning rate rises
STATISTICS = 8  #: batches to recompute batch normalization statistics from after each epoch

Batch = TypeVar("Batch")
Norm = nn.modules.batchnorm._BatchNorm


@dataclass(frozen=True)
class EpochPoint:
    """One row of a training curve."""

    epoch: int  #: from 1
    train_loss: float  #: mean over the batches
    val_score: float  #: higher is better
    seconds: float  #: of this epoch


@dataclass(frozen=True)
class Objective(Generic[Batch]):
    """What a net is to learn."""

    net: nn.Module  #: moved to the device and trained in place
    #: Returns the batches of an epoch, counted from 1. All randomness must follow from this number, not from
    #: a generator that persists over epochs.
    epoch_batches: Callable[[int], Iterable[Batch]]
    batch_loss: Callable[[Batch], torch.Tensor]
    #: Returns the validation score after each epoch, in evaluation mode and without gradients; higher is
    #: better.
    val_score: Callable[[], float]
    score: str = "score"  #: name of the validation score, for reports


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """The course of a training."""

    epochs: int  #: at most; the learning rate decays over all of them
    learning_rate: float  #: at its peak
    weight_decay: float = 0.0
    patience: int  #: epochs without a better score after which training stops
    #: Steps of all epochs together. The rate then rises over the first fifth of them and falls as half a
    #: cosine (Smith and Topin 2019); biases and parameters of normalizations do not decay. None: the rate
    #: rises over `WARM_UP` steps and falls as a cosine from epoch to epoch, and all parameters decay.
    cycle: int | None = None
    #: "bfloat16": under autocast if the processor has instructions for it (`has_bfloat16`), with channels
    #: last. Weights, optimizer, statistics of batch normalization and scores stay in float32. On CUDA,
    #: training is always under this autocast.
    precision: Precision = "float32"
    statistics: int = STATISTICS  #: batches to recompute batch normalization statistics from

    def rate(self, step: int, epoch: int) -> float:
        """Return the learning rate of a step in an epoch, both counted from 1."""
        if self.cycle is not None:
            return self.learning_rate * one_cycle(step / self.cycle)
        return self.learning_rate * (min(1, step / WARM_UP) * _fall((epoch - 1) / self.epochs))


def train(
    objective: Objective[Batch],
    settings: TrainSettings,
    checkpoint: Path | None = None,
    device: str | torch.device = "cpu",
    report: Callable[[EpochPoint], None] = lambda point: None,
) -> list[EpochPoint]:
    """Train a net with AdamW; restore its best epoch, in evaluation mode, and return the training curve.

    The same arguments give the same net, whether or not the call was interrupted: the checkpoint stores the
    state after each epoch, from which the same call resumes; delete it afterwards. ``report`` is called with
    each new point of the curve. Raises ObjectFolderError if training diverges, or the checkpoint is damaged
    or of another training.
    """
    net, epoch_batches, batch_loss = objective.net, objective.epoch_batches, objective.batch_loss
    device = torch.device(device)
    net.to(device)
    if settings.precision == "bfloat16":
        net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    lower = device.type == "cuda" or (settings.precision == "bfloat16" and has_bfloat16())
    groups = _groups(net, settings.weight_decay, spare=settings.cycle is not None)
    optimizer = torch.optim.AdamW(groups, lr=settings.learning_rate, fused=True)
    norms = [module for module in net.modules() if isinstance(module, Norm)]
    shapes = {name: tuple(value.shape) for name, value in net.state_dict().items()}
    task = {**asdict(settings), "net": identity(shapes)[:8]}

    def advance(state: TrainingState[EpochPoint]) -> EpochPoint:
        epoch, start = state.units + 1, time.perf_counter()
        net.train()
        losses = []
        for batch in epoch_batches(epoch):
            state.steps += 1
            for group in optimizer.param_groups:
                group["lr"] = settings.rate(state.steps, epoch)
            optimizer.zero_grad(set_to_none=True)
            with torch.autocast(device.type, torch.bfloat16, enabled=lower):
                loss = batch_loss(batch)
            loss.backward()
            optimizer.step()
            losses.append(loss.detach())
        train_loss = torch.stack(losses).double().mean().item()
        _renew(norms, islice(epoch_batches(epoch), settings.statistics), batch_loss)
        net.eval()
        with torch.no_grad():
            score = float(objective.val_score())
        if not math.isfinite(train_loss) or math.isnan(score):
            raise ObjectFolderError(
                f"epoch {epoch} has a training loss of {train_loss} and a validation score of {score}; "
                f"expected finite values: use a smaller learning_rate than {settings.learning_rate:g}"
            )
        return EpochPoint(epoch, train_loss, score, time.perf_counter() - start)

    def is_finished(state: TrainingState[EpochPoint]) -> bool:
        stale = len(state.curve) - 1 - state.best_row
        return state.units >= settings.epochs or stale >= settings.patience

    state = run_training(
        Training(
            {"net": net, "optimizer": optimizer},
            advance,
            is_finished,
            is_better=lambda new, best: new.val_score > best.val_score,
            keep=lambda: copy_state(net),
            point=EpochPoint,
        ),
        None if checkpoint is None else Checkpoint(checkpoint, task),
        report,
    )
    net.load_state_dict(state.best)
    net.eval()
    return state.curve


def one_cycle(done: float) -> float:
    """Return the learning rate after a share of all steps, of its peak."""
    return done / RISE if done < RISE else _fall((done - RISE) / (1 - RISE))


def _fall(done: float) -> float:
    return 0.5 * (1 + math.cos(math.pi * done))


def has_bfloat16() -> bool:
    """Return whether the processor multiplies matrices of bfloat16 by instructions of its own.

    Others emulate it, more slowly than they compute in float32.
    """
    known = torch.cpu.get_capabilities()
    return any(available for name, available in known.items() if name.endswith("bf16"))


def _groups(net: nn.Module, weight_decay: float, spare: bool) -> list[dict[str, Any]]:
    """Group the parameters of a net for the optimizer; ``spare`` vectors the weight decay."""
    if not spare:
        return [{"params": list(net.parameters()), "weight_decay": weight_decay}]
    return [
        {"params": [p for p in net.parameters() if p.ndim > 1], "weight_decay": weight_decay},
        {"params": [p for p in net.parameters() if p.ndim <= 1], "weight_decay": 0.0},
    ]


def _renew(
    norms: Sequence[Norm], batches: Iterable[Batch], batch_loss: Callable[[Batch], torch.Tensor]
) -> None:
    """Recompute batch normalization statistics as means over some batches (Wu and Johnson 2021).

    Running averages lag behind rapidly changing weights: on small data the first epochs would score near
    chance.
    """
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # the mean of all batches, not a running average
    with torch.no_grad():
        for batch in batches if norms else ():
            batch_loss(batch)


def shuffle(rows: np.ndarray, batch: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield each row once, in random order and in batches.

    A last batch of one row is merged into the one before, because batch normalization needs two.
    """
    order = rng.permutation(rows)
    yield from np.split(order, [batch * i for i in range(1, count_batches(len(order), batch))])


def count_batches(rows: int, batch: int) -> int:
    """Return the number of batches that `shuffle` yields of so many rows."""
    whole, rest = divmod(rows, batch)
    return max(1, whole + (rest > 1))
