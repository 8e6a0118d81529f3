"""The loop of every training, and the file from which a killed one continues to the same bits."""

import hashlib
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch

from objectfolder.base.arrays import torch_problem
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import atomic_stream, file_digest

INTERVAL = 60.0  #: wall seconds between two checkpoints of a training whose units are short
FORMAT = "objectfolder training 2"
_FIELDS = ("units", "steps", "losses", "best_row", "best")  # of `TrainingState`, stored as they are

Point = TypeVar("Point")


@dataclass
class Checkpoint:
    """A file that holds the state of an unfinished training; nothing in it is executed."""

    path: Path
    identity: Any  #: of the training: text, or a dictionary; a file of another one is not continued
    interval: float = 0.0  #: wall seconds between two writes
    replaces: bool = False  #: a file that is damaged or of another training, instead of refusing it
    _written: float = field(default_factory=time.monotonic, init=False)

    def load(self) -> dict[str, Any] | None:
        """Return the stored state, with its tensors on the CPU; None if there is none to continue.

        Raises ObjectFolderError if the file is damaged or of another training, unless it is replaced.
        """
        if not self.path.is_file():
            return None
        try:
            stored: Any = torch.load(self.path, map_location="cpu", weights_only=True)
        except Exception as error:  # the unpickler raises any exception
            problem = f"is damaged ({torch_problem(error)})"
        else:
            if not isinstance(stored, dict) or stored.get("format") != FORMAT:
                problem = "is not a checkpoint of a training"
            elif stored["identity"] != self.identity:
                problem = f"is of a training with {stored['identity']}, expected {self.identity}"
            else:
                return {name: value for name, value in stored.items() if name not in ("format", "identity")}
        if self.replaces:
            return None
        raise ObjectFolderError(f"{self.path} {problem}; delete it to restart this training")

    def is_due(self) -> bool:
        """Whether the last write is an interval ago."""
        return time.monotonic() - self._written >= self.interval

    def save(self, state: Mapping[str, Any]) -> None:
        """Write a state; the file is complete or the earlier one."""
        with atomic_stream(self.path) as stream:
            torch.save({"format": FORMAT, "identity": self.identity, **state}, stream)
        self._written = time.monotonic()


def identity(settings: object, files: Iterable[Path] = ()) -> str:
    """Return the digest of all that a training depends on: settings, files that exist, and PyTorch."""
    digests = [file_digest(path) for path in files if path.is_file()]
    return hashlib.sha256(repr((settings, digests, torch.__version__)).encode()).hexdigest()


@dataclass
class TrainingState(Generic[Point]):
    """How far a training is."""

    clock: Callable[[], float]
    started: float  #: on the clock; earlier by the time of the runs that this one continues
    units: int = 0  #: trained
    steps: int = 0  #: of the optimizer, for trainings whose units have several
    losses: list[float] = field(default_factory=list)  #: of the units since the last point of the curve
    curve: list[Point] = field(default_factory=list)
    best_row: int = -1  #: of the curve
    best: Any = None  #: what `Training.keep` returned there

    @property
    def seconds(self) -> float:
        """Of the training, runs that were killed included."""
        return self.clock() - self.started


@dataclass(frozen=True)
class Training(Generic[Point]):
    """What a training does, unit by unit: a step, an epoch, some rollouts; see `run_training`."""

    #: All that a unit depends on but its number: nets, optimizers, random generators.
    parts: Mapping[str, Any]
    #: Trains the next unit; returns a point of the curve if it ends with a validation.
    advance: Callable[[TrainingState[Point]], Point | None]
    is_finished: Callable[[TrainingState[Point]], bool]
    is_better: Callable[[Point, Point], bool]  #: than the best point so far
    keep: Callable[[], Any]  #: copies what is to be kept of the best: plain values and tensors
    point: Callable[..., Point]  #: dataclass of the curve's points
    replays: bool = False  #: report the points of a run that this one continues, too
    clock: Callable[[], float] = time.perf_counter


def run_training(
    training: Training[Point],
    checkpoint: Checkpoint | None = None,
    report: Callable[[Point], None] = lambda point: None,
) -> TrainingState[Point]:
    """Train until it is finished, from the checkpoint on if there is one; it stays until it is deleted.

    A training that was killed between any two statements ends with the bits of one that was not.
    """
    state = TrainingState[Point](training.clock, training.clock())
    if checkpoint is not None and (stored := checkpoint.load()) is not None:
        for name, part in training.parts.items():
            restore = part.set_state if isinstance(part, torch.Generator) else part.load_state_dict
            restore(stored["parts"][name])
        state.started -= stored["seconds"]
        for name in _FIELDS:
            setattr(state, name, stored[name])
        state.curve = [training.point(*row) for row in stored["curve"]]
        for point in state.curve if training.replays else ():
            report(point)
    while not training.is_finished(state):
        found = training.advance(state)
        state.units += 1
        if found is not None:
            state.losses = []
            state.curve.append(found)
            if state.best_row < 0 or training.is_better(found, state.curve[state.best_row]):
                state.best_row, state.best = len(state.curve) - 1, training.keep()
        if checkpoint is not None and checkpoint.is_due():
            checkpoint.save(_stored(training, state))
        if found is not None:
            report(found)
    return state


def _stored(training: Training[Point], state: TrainingState[Point]) -> dict[str, Any]:
    return {
        "parts": {
            name: part.get_state() if isinstance(part, torch.Generator) else part.state_dict()
            for name, part in training.parts.items()
        },
        "curve": [astuple(point) for point in state.curve],  # type: ignore[call-overload]
        "seconds": state.seconds,
        **{name: getattr(state, name) for name in _FIELDS},
    }


def copy_state(net: torch.nn.Module) -> dict[str, torch.Tensor]:
    """Copy a net's tensors, which training changes in place."""
    return {name: value.clone() for name, value in net.state_dict().items()}
