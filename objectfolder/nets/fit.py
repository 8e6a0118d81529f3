"""Training loop shared by all nets."""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass
from typing import Any, Protocol

import torch
from torch import nn

from objectfolder.errors import ObjectFolderError
from objectfolder.nets.adam import Adam
from objectfolder.nets.checkpoint import Checkpoint

WARM_UP = 50  #: steps over which the learning rate rises, unless it is constant


@dataclass(frozen=True)
class CurvePoint:
    """One row of a training curve."""

    step: int
    train_loss: float
    val_loss: float
    seconds: float  #: of this process on the CPU, and of those that a checkpoint continues


class Optimizer(Protocol):
    """What `fit` asks of an optimizer: groups of ``params`` with learning rates ``lr``, and steps."""

    param_groups: list[dict[str, Any]]

    def step(self) -> None:
        """Update every parameter that has a gradient."""


def fit(
    net: nn.Module,
    batch_loss: Callable[[], torch.Tensor],
    val_loss: Callable[[], float],
    steps: int,
    learning_rate: float,
    evaluations: int = 20,
    final_rate: float = 0.01,
    report: Callable[[CurvePoint], None] = lambda point: None,
    optimizer: Optimizer | None = None,
    checkpoint: Checkpoint | None = None,
) -> list[CurvePoint]:
    """Minimise a loss; keep the weights of the lowest validation loss.

    The learning rate rises over `WARM_UP` steps, then falls as a cosine.

    Parameters
    ----------
    net : nn.Module
        Trained in place.
    batch_loss : callable
        Draws a batch and returns its loss.
    val_loss : callable
        Returns the validation loss; called ``evaluations`` times, without gradients.
    steps : int
    learning_rate : float
        Peak learning rate.
    final_rate : float
        Final learning rate, relative to the peak; 1: constant from the first step on.
    report : callable
        Called with each point of the training curve, those of an interrupted run included.
    optimizer : Optimizer, optional
        Optimizer of the net's parameters; default: Adam. The learning rate set here is multiplied by each
        group's ``relative_rate``.
    checkpoint : Checkpoint, optional
        For trainings with `Adam`. Where the state is written from time to time, and from which an earlier run
        is continued. All that ``batch_loss`` draws must come from its generator.

    Returns
    -------
    list of CurvePoint
        Training curve.

    Raises
    ------
    ObjectFolderError
        If a loss is not finite.
    """
    # A larger epsilon would freeze hash-table entries with tiny gradients.
    if optimizer is None:
        optimizer = Adam([{"params": list(net.parameters())}], (0.9, 0.99), 1e-12)
    kept = optimizer if isinstance(optimizer, Adam) else None
    if checkpoint and kept is None:
        raise TypeError(f"{type(optimizer).__name__} has no checkpoints; expected Adam")
    best, best_state = math.inf, None
    curve: list[CurvePoint] = []
    warm_up = WARM_UP if final_rate < 1 else 1
    marks = {round((i + 1) * steps / evaluations) for i in range(evaluations)}
    start, running, count, done = time.process_time(), 0.0, 0, 0
    found = checkpoint.load() if checkpoint else None
    if found and kept:
        tensors, numbers = found
        net.load_state_dict(_under("net.", tensors))
        kept.restore(_under("optimizer.", tensors))
        best_state = _under("best.", tensors) or None
        running, count, done = (numbers[name] for name in ("running", "count", "step"))
        best = math.inf if numbers["best"] is None else numbers["best"]
        start -= numbers["seconds"]
        curve = [CurvePoint(*point) for point in numbers["curve"]]
        for point in curve:
            report(point)
    for step in range(done + 1, steps + 1):
        progress = step / steps
        decay = 0.5 * (1 + math.cos(math.pi * progress)) * (1 - final_rate) + final_rate
        for group in optimizer.param_groups:
            group["lr"] = learning_rate * group.get("relative_rate", 1) * min(1, step / warm_up) * decay
        net.zero_grad(set_to_none=True)
        loss = batch_loss()
        loss.backward()
        optimizer.step()
        if not math.isfinite(value := loss.item()):
            raise ObjectFolderError(
                f"training diverged: the loss of step {step} of {steps} is {value}; lower learning_rate, "
                f"which is {learning_rate:g}"
            )
        running, count = running + value, count + 1
        if step in marks:
            with torch.no_grad():
                point = CurvePoint(step, running / count, float(val_loss()), time.process_time() - start)
            running, count = 0.0, 0
            curve.append(point)
            report(point)
            if point.val_loss < best:
                best = point.val_loss
                best_state = {name: value.clone() for name, value in net.state_dict().items()}
        if checkpoint and kept and checkpoint.due():
            states = {"net": net.state_dict(), "optimizer": kept.tensors(), "best": best_state or {}}
            checkpoint.save(
                {f"{part}.{name}": value for part, state in states.items() for name, value in state.items()},
                {
                    "step": step,
                    "best": best if best_state else None,  # JSON has no infinity
                    "running": running,
                    "count": count,
                    "seconds": time.process_time() - start,
                    "curve": [astuple(point) for point in curve],
                },
            )
    if best_state is not None:
        net.load_state_dict(best_state)
    return curve


def _under(prefix: str, tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def part_size(size: int, batch: int, device: str | torch.device) -> int:
    """Return ``size``, for a CPU's cache, or on another device the whole batch."""
    return size if torch.device(device).type == "cpu" else batch


def in_parts(
    loss: Callable[..., torch.Tensor], size: int, first: torch.Tensor, *others: torch.Tensor
) -> torch.Tensor:
    """Return the mean loss of a batch, a part at a time: activations of a part stay in the cache.

    Gradients of all parts but the last are added to the parameters at once; those of the last follow from
    the result.

    Parameters
    ----------
    loss : callable
        Mean loss of rows.
    size : int
        Rows of a part.
    first : (N, ...) tensor
        Rows of the batch, the first argument of ``loss``.
    *others : (N, ...) tensors
        Its other arguments.
    """
    total = torch.zeros(())
    parts = list(zip(first.split(size), *(other.split(size) for other in others)))
    for part in parts[:-1]:
        share = loss(*part) * (len(part[0]) / len(first))
        share.backward()
        total = total + share.detach().cpu()
    return loss(*parts[-1]) * (len(parts[-1][0]) / len(first)) + total.to(first.device)


def minibatches(count: int, size: int, generator: torch.Generator) -> Iterable[torch.Tensor]:
    """Yield shuffled index batches without end; a sample appears at most once per epoch."""
    size = min(size, count)
    while True:
        order = torch.randperm(count, generator=generator)
        for start in range(0, count - size + 1, size):
            yield order[start : start + size]
