"""Training of all nets: steps along the gradient, validated on the way."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.nets.checkpoint import Checkpoint, Training, TrainingState, copy_state, run_training
from objectfolder.nets.optimizers import make_default_adam, make_papers_adam
from objectfolder.nets.positional import train_in
from objectfolder.nets.settings import PapersNetConfig

WARM_UP = 50  #: steps over which the learning rate rises, unless it is constant


@dataclass(frozen=True)
class CurvePoint:
    """One row of a training curve."""

    step: int
    train_loss: float
    val_loss: float
    seconds: float  #: of this process on the CPU, and of those that a checkpoint continues


@dataclass(frozen=True)
class FitSettings:
    """The course of a training; the learning rate rises over `WARM_UP` steps, then falls as a cosine."""

    steps: int
    learning_rate: float  #: at its peak
    final_rate: float = 0.01  #: at the end, relative to the peak; 1: constant from the first step on
    evaluations: int = 20  #: of the validation loss

    def rate(self, step: int, relative: float = 1) -> float:
        """Return the learning rate of a step, counted from 1, times another factor."""
        rise = min(1, step / (WARM_UP if self.final_rate < 1 else 1))
        fall = 0.5 * (1 + math.cos(math.pi * (step / self.steps))) * (1 - self.final_rate) + self.final_rate
        return self.learning_rate * relative * rise * fall


@dataclass(frozen=True)
class Session:
    """Where a training runs, apart from what it learns."""

    #: On the CPU. Seeds initialisation and batches; all randomness comes from it.
    generator: torch.Generator = field(default_factory=torch.Generator)
    device: str | torch.device = "cpu"  #: of the training; the net is returned on the CPU
    checkpoint: Checkpoint | None = None  #: where the state is written, and an earlier run is continued
    #: Called with each point of the training curve, those of an interrupted run included.
    report: Callable[[CurvePoint], None] = lambda point: None

    @contextmanager
    def initialisation(self) -> Iterator[None]:
        """Seed torch's global generator (CPU), from which layers draw, and restore it afterwards."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(torch.randint(2**31, (1,), generator=self.generator)))
            yield


def fit(
    net: nn.Module,
    batch_loss: Callable[[], torch.Tensor],
    val_loss: Callable[[], float],
    settings: FitSettings,
    session: Session,
    optimizer: torch.optim.Optimizer | None = None,
) -> list[CurvePoint]:
    """Minimise a loss; keep the weights of the lowest validation loss, and return the training curve.

    ``batch_loss`` draws a batch from the session's generator; ``val_loss`` is called without gradients. The
    default optimizer is Adam; the learning rate is multiplied by each group's ``relative_rate``. Raises
    ObjectFolderError if a loss is not finite.
    """
    optimizer = optimizer or make_default_adam(net)
    steps, evaluations = settings.steps, settings.evaluations
    parameters = list(net.parameters())
    marks = {round((i + 1) * steps / evaluations) for i in range(evaluations)}

    def advance(state: TrainingState[CurvePoint]) -> CurvePoint | None:
        step = state.units + 1
        for group in optimizer.param_groups:
            group["lr"] = settings.rate(step, group.get("relative_rate", 1))
        for parameter in parameters:  # `zero_grad` would look for them at every step
            parameter.grad = None
        loss = batch_loss()
        loss.backward()
        optimizer.step()
        if not math.isfinite(value := loss.item()):
            raise ObjectFolderError(
                f"training diverged: the loss of step {step} of {steps} is {value}; lower learning_rate, "
                f"which is {settings.learning_rate:g}"
            )
        state.losses.append(value)
        if step not in marks:
            return None
        mean = np.cumsum(state.losses)[-1] / len(state.losses)
        with torch.no_grad():
            return CurvePoint(step, float(mean), float(val_loss()), state.seconds)

    state = run_training(
        Training(
            {"net": net, "optimizer": optimizer, "generator": session.generator},
            advance,
            is_finished=lambda state: state.units >= steps,
            is_better=lambda new, best: new.val_loss < best.val_loss or math.isnan(best.val_loss),
            keep=lambda: copy_state(net),
            point=CurvePoint,
            replays=True,
            clock=time.process_time,
        ),
        session.checkpoint,
        session.report,
    )
    net.load_state_dict(state.best)
    return state.curve


def fit_papers_net(
    net: nn.Module,
    batch_loss: Callable[[], torch.Tensor],
    val_loss: Callable[[], float],
    config: PapersNetConfig,
    session: Session,
) -> list[CurvePoint]:
    """Fit a net of the paper on the session's device, and return it to the CPU for evaluation."""
    net.to(session.device)
    train_in(net, config.precision)
    settings = FitSettings(config.steps, config.learning_rate, config.final_rate)
    curve = fit(net, batch_loss, val_loss, settings, session, make_papers_adam(net))
    net.cpu().eval()
    return curve


def choose_part_size(size: int, batch: int, device: str | torch.device) -> int:
    """Return ``size``, for a CPU's cache, or on another device the whole batch."""
    return size if torch.device(device).type == "cpu" else batch


def sum_in_parts(
    loss: Callable[..., torch.Tensor], size: int, first: torch.Tensor, *others: torch.Tensor
) -> torch.Tensor:
    """Return the mean loss of a batch, a part at a time: activations of a part stay in the cache.

    ``loss`` is the mean loss of rows, ``size`` the rows of a part; all other arguments have the rows of the
    batch along their first dimension. Gradients of all parts but the last are added to the parameters at
    once; those of the last follow from the result.
    """
    total = torch.zeros(())
    parts = list(zip(first.split(size), *(other.split(size) for other in others)))
    for part in parts[:-1]:
        share = loss(*part) * (len(part[0]) / len(first))
        share.backward()
        total = total + share.detach().cpu()
    return loss(*parts[-1]) * (len(parts[-1][0]) / len(first)) + total.to(first.device)


def minibatches(count: int, size: int, generator: torch.Generator) -> Iterable[torch.Tensor]:
    """Yield shuffled index batches without end; a sample appears at most once per epoch.

    Only for trainings of seconds, without a checkpoint, which would not hold the place in the epoch.
    """
    size = min(size, count)
    while True:
        order = torch.randperm(count, generator=generator)
        for start in range(0, count - size + 1, size):
            yield order[start : start + size]
