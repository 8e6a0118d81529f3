"""Run a task on one split and leave its results: what the stages and the command line share."""

import csv
import hashlib
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

import objectfolder
from objectfolder.artifacts import atomic, file_digest, write_json, write_png, write_safetensors
from objectfolder.benchmarks.encoders import InputSizes, Weights
from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.observations import Observations
from objectfolder.benchmarks.splits import Split, named_split
from objectfolder.sources import digests


@dataclass(frozen=True)
class Outcome:
    """What a task leaves.

    Parameters
    ----------
    scores : dict
        Numbers, for JSON.
    columns : sequence of str
        Of ``curve``.
    curve : list of rows
        Training curves.
    seconds : float
        Of training, those of interrupted calls included.
    model : (tensors, header), optional
        A net that can be asked later.
    sheet : (H, W, 3) uint8 array, optional
        A picture to look at.
    """

    scores: dict[str, Any]
    columns: Sequence[str]
    curve: list[list[Any]]
    seconds: float
    model: tuple[dict[str, np.ndarray], dict[str, Any]] | None = None
    sheet: np.ndarray | None = None


class Task(Protocol):
    """A task, such as `objectfolder.benchmarks.recognition.recognize`."""

    def __call__(
        self,
        observations: Observations,
        split: Split,
        params: Any,
        encoder: str,
        sizes: InputSizes,
        *,
        weights: Weights | None,
        seed: int,
        progress: Path,
        device: str,
        report: Callable[[str], None],
    ) -> Outcome:
        """Train and score."""


def run_task(
    name: str,
    task: Task,
    split: str,
    observations: Observations,
    params: SimpleNamespace,
    folder: Benchmarks,
    report: Callable[[str], None],
    weights: Weights | None = None,
    device: str = "cpu",
) -> Outcome:
    """Run a task on one split and write its scores, curves and what else it has.

    What an interrupted call has done is kept and gone on from, unless observations, parameters, weights or the code
    of the task have changed.

    Parameters
    ----------
    name : str
        Of the task, one of `objectfolder.params.TASKS`.
    task : callable
    split : str
    observations : Observations
    params : SimpleNamespace
        ``section``, ``encode`` and ``seed``; see `objectfolder.benchmarks.params.task_params`.
    folder : Benchmarks
    report : callable
        Called with a line about each epoch.
    weights : Weights, optional
        That encoders start from.
    device : str
        Where nets train.

    Raises
    ------
    ObjectFolderError
        If the split cannot be made of these objects, or the task fails.
    """
    encode = params.encode
    sizes = InputSizes(encode.image, tuple(encode.spectrogram), tuple(encode.touch))
    identity = (
        observations.digest,
        params,
        _code(task),
        "" if weights is None else file_digest(weights.path),
    )
    progress = folder.progress(name, split, hashlib.sha256(repr(identity).encode()).hexdigest())
    rows = named_split(split, observations.keys, observations.count)
    outcome = task(
        observations,
        rows,
        params.section,
        encode.encoder,
        sizes,
        weights=weights,
        seed=params.seed,
        progress=progress,
        device=device,
        report=report,
    )
    with atomic(folder.curve(name, split)) as temporary, temporary.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerows([outcome.columns, *outcome.curve])
    if outcome.model is not None:
        write_safetensors(folder.model(name, split), *outcome.model)
    if outcome.sheet is not None:
        write_png(folder.sheet(name, split), outcome.sheet)
    write_json(folder.result(name, split), outcome.scores)
    rmtree(progress, ignore_errors=True)
    return outcome


def _code(task: Task) -> str:
    """Digests of all modules of ours that a task runs."""
    package = Path(objectfolder.__file__).parent
    return digests(Path(inspect.getfile(task)).relative_to(package.parent), package.parent)
