"""Training loop shared by all nets."""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import nn

from objectfolder.nets.adam import Adam


@dataclass(frozen=True)
class CurvePoint:
    """One row of a training curve."""

    step: int
    train_loss: float
    val_loss: float
    seconds: float


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
) -> list[CurvePoint]:
    """Minimise a loss with warm-up and cosine decay; keep the weights of the lowest validation loss.

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
        Final learning rate, relative to the peak.
    report : callable
        Called with each point of the training curve.
    optimizer : Optimizer, optional
        Optimizer of the net's parameters; default: Adam. The learning rate set here is multiplied by each
        group's ``relative_rate``.

    Returns
    -------
    list of CurvePoint
        Training curve.
    """
    # A larger epsilon would freeze hash-table entries with tiny gradients.
    if optimizer is None:
        optimizer = Adam([{"params": list(net.parameters())}], (0.9, 0.99), 1e-12)
    best, best_state = math.inf, None
    curve: list[CurvePoint] = []
    marks = {round((i + 1) * steps / evaluations) for i in range(evaluations)}
    start, running, count = time.perf_counter(), 0.0, 0
    for step in range(1, steps + 1):
        progress = step / steps
        decay = 0.5 * (1 + math.cos(math.pi * progress)) * (1 - final_rate) + final_rate
        for group in optimizer.param_groups:
            group["lr"] = learning_rate * group.get("relative_rate", 1) * min(1, step / 50) * decay
        net.zero_grad(set_to_none=True)
        loss = batch_loss()
        loss.backward()
        optimizer.step()
        running, count = running + loss.item(), count + 1
        if step in marks:
            with torch.no_grad():
                point = CurvePoint(step, running / count, float(val_loss()), time.perf_counter() - start)
            running, count = 0.0, 0
            curve.append(point)
            report(point)
            if point.val_loss < best:
                best = point.val_loss
                best_state = {name: value.clone() for name, value in net.state_dict().items()}
    if best_state is not None:
        net.load_state_dict(best_state)
    return curve


def minibatches(count: int, size: int, generator: torch.Generator) -> Iterable[torch.Tensor]:
    """Yield shuffled index batches without end; a sample appears at most once per epoch."""
    size = min(size, count)
    while True:
        order = torch.randperm(count, generator=generator)
        for start in range(0, count - size + 1, size):
            yield order[start : start + size]
