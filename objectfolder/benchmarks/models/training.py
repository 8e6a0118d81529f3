"""Resumable training loop of all benchmark nets."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import nn

from objectfolder.errors import ObjectFolderError
from objectfolder.io import atomic, torch_problem
from objectfolder.settings import Precision

WARM_UP = 20  #: steps of linear learning rate warm-up
RISE = 0.2  #: share of a cycle in which the learning rate rises
STATISTICS = 8  #: batches to recompute batch normalization statistics from after each epoch
FORMAT = "objectfolder benchmark training 1"  #: of a checkpoint
REMOVE = "delete it to restart this training"

Batch = TypeVar("Batch")
Norm = nn.modules.batchnorm._BatchNorm


@dataclass(frozen=True)
class EpochPoint:
    """One row of a training curve."""

    epoch: int  #: from 1
    train_loss: float  #: mean over the batches
    val_score: float  #: higher is better
    seconds: float  #: of this epoch


def train(
    net: nn.Module,
    epoch_batches: Callable[[int], Iterable[Batch]],
    batch_loss: Callable[[Batch], torch.Tensor],
    val_score: Callable[[], float],
    *,
    epochs: int,
    learning_rate: float,
    weight_decay: float = 0.0,
    patience: int,
    cycle: int | None = None,
    precision: Precision = "float32",
    statistics: int = STATISTICS,
    checkpoint: Path | None = None,
    device: str | torch.device = "cpu",
    report: Callable[[EpochPoint], None] = lambda point: None,
) -> list[EpochPoint]:
    """Train a net with AdamW; restore its best epoch, in evaluation mode.

    The same arguments give the same net, whether or not the call was interrupted. To that end, all randomness
    must follow from the epoch number, not from a generator that persists over epochs.

    Parameters
    ----------
    net : nn.Module
        Moved to the device and trained in place.
    epoch_batches : callable
        Returns the batches of an epoch, counted from 1.
    batch_loss : callable
        Returns the loss of a batch.
    val_score : callable
        Returns the validation score after each epoch, in evaluation mode and without gradients; higher is
        better.
    epochs : int
        At most; the learning rate decays over all of them.
    learning_rate : float
        Peak rate.
    patience : int
        Epochs without a better score after which training stops.
    cycle : int, optional
        Steps of all epochs together. The rate then rises over the first fifth of them and falls as half a
        cosine (Smith and Topin 2019); biases and parameters of normalizations do not decay. By default, the
        rate rises over `WARM_UP` steps and falls as a cosine from epoch to epoch, and all parameters decay.
    precision : {"float32", "bfloat16"}
        "bfloat16": under autocast if the processor has instructions for it (`has_bfloat16`), with channels
        last. Weights, optimizer, statistics of batch normalization and scores stay in float32. On CUDA,
        training is always under this autocast.
    statistics : int
        Batches to recompute batch normalization statistics from after each epoch.
    checkpoint : Path, optional
        File that stores the state after each epoch, from which the same call resumes; delete it afterwards.
    report : callable
        Called with each new point of the curve.

    Returns
    -------
    The training curve.

    Raises
    ------
    ObjectFolderError
        If training diverges, or the checkpoint is damaged or of another training.
    """
    device = torch.device(device)
    net.to(device)
    if precision == "bfloat16":
        net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    lower = device.type == "cuda" or (precision == "bfloat16" and has_bfloat16())
    optimizer = torch.optim.AdamW(
        _groups(net, weight_decay, spare=cycle is not None), lr=learning_rate, fused=True
    )
    settings = {
        "epochs": epochs,
        "learning_rate": learning_rate,
        "weight_decay": weight_decay,
        "patience": patience,
        "cycle": cycle,
        "precision": precision,
    }
    norms = [module for module in net.modules() if isinstance(module, Norm)]
    curve: list[EpochPoint] = []
    best, step = _copied(net), 0
    if checkpoint is not None and checkpoint.is_file():
        curve, best, step = _resume(checkpoint, net, optimizer, settings)
    while len(curve) < epochs and len(curve) - _best_epoch(curve) < patience:
        epoch, start = len(curve) + 1, time.perf_counter()
        net.train()
        losses = []
        for batch in epoch_batches(epoch):
            step += 1
            if cycle is None:
                rate = min(1, step / WARM_UP) * _fall((epoch - 1) / epochs)
            else:
                rate = one_cycle(step / cycle)
            for group in optimizer.param_groups:
                group["lr"] = learning_rate * rate
            optimizer.zero_grad(set_to_none=True)
            with torch.autocast(device.type, torch.bfloat16, enabled=lower):
                loss = batch_loss(batch)
            loss.backward()
            optimizer.step()
            losses.append(loss.detach())
        train_loss = torch.stack(losses).double().mean().item()
        _renew(norms, islice(epoch_batches(epoch), statistics), batch_loss)
        net.eval()
        with torch.no_grad():
            score = float(val_score())
        if not math.isfinite(train_loss) or math.isnan(score):
            raise ObjectFolderError(
                f"epoch {epoch} has a training loss of {train_loss} and a validation score of {score}; "
                f"expected finite values: use a smaller learning_rate than {learning_rate:g}"
            )
        curve.append(EpochPoint(epoch, train_loss, score, time.perf_counter() - start))
        if _best_epoch(curve) == epoch:
            best = _copied(net)
        if checkpoint is not None:
            state = {
                "format": FORMAT,
                "settings": settings,
                "curve": [astuple(point) for point in curve],
                "step": step,
                "net": net.state_dict(),
                "best": best,
                "optimizer": optimizer.state_dict(),
            }
            with atomic(checkpoint) as temporary:
                torch.save(state, temporary)
        report(curve[-1])
    net.load_state_dict(best)
    net.eval()
    return curve


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


def read_checkpoint(path: Path, form: str, settings: dict[str, Any]) -> dict[str, Any]:
    """Read the state of a training; nothing in the file is executed.

    Parameters
    ----------
    path : Path
        Written by ``torch.save``.
    form, settings
        Expected entries ``format`` and ``settings``.

    Raises
    ------
    ObjectFolderError
        If it is damaged, or of another training.
    """
    try:
        stored: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the unpickler raises any exception
        raise ObjectFolderError(f"{path} is damaged ({torch_problem(error)}); {REMOVE}") from error
    if not isinstance(stored, dict) or stored.get("format") != form:
        raise ObjectFolderError(f"{path} is not a checkpoint of a benchmark's training; {REMOVE}")
    if stored["settings"] != settings:
        raise ObjectFolderError(
            f"{path} is of a training with {stored['settings']}, expected {settings}; {REMOVE}"
        )
    return stored


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


def shuffled(rows: np.ndarray, batch: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield each row once, in random order and in batches.

    A last batch of one row is merged into the one before, because batch normalization needs two.
    """
    order = rng.permutation(rows)
    yield from np.split(order, [batch * i for i in range(1, batch_count(len(order), batch))])


def batch_count(rows: int, batch: int) -> int:
    """Return the number of batches of `shuffled` rows."""
    whole, rest = divmod(rows, batch)
    return max(1, whole + (rest > 1))


def _best_epoch(curve: list[EpochPoint]) -> int:
    """Return the epoch of the best score, the first of equals; 0 without epochs."""
    return max(curve, key=lambda point: point.val_score).epoch if curve else 0


def _copied(net: nn.Module) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in net.state_dict().items()}


def _shapes(state: dict[str, torch.Tensor]) -> dict[str, torch.Size]:
    return {name: value.shape for name, value in state.items()}


def _resume(
    checkpoint: Path, net: nn.Module, optimizer: torch.optim.Optimizer, settings: dict[str, Any]
) -> tuple[list[EpochPoint], dict[str, torch.Tensor], int]:
    """Restore net and optimizer from a checkpoint; return curve, best state and number of steps."""
    stored = read_checkpoint(checkpoint, FORMAT, settings)
    if _shapes(stored["net"]) != _shapes(net.state_dict()):
        raise ObjectFolderError(f"{checkpoint} is of another net; {REMOVE}")
    net.load_state_dict(stored["net"])
    optimizer.load_state_dict(stored["optimizer"])
    device = next(net.parameters()).device
    best = {name: value.to(device) for name, value in stored["best"].items()}
    return [EpochPoint(*row) for row in stored["curve"]], best, stored["step"]
