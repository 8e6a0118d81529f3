"""Run one benchmark task and write its results; shared by the stages and the command line."""

import csv
import platform
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from objectfolder.benchmarks.datasets.samples import Samples
from objectfolder.benchmarks.datasets.splits import Split, named_split
from objectfolder.benchmarks.models.encoders import Weights, own_code, registered
from objectfolder.benchmarks.params import TaskParams
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.disk import refuse_links
from objectfolder.errors import ObjectFolderError
from objectfolder.io import file_digest, read_json, write_json, write_text
from objectfolder.locks import exclusive, remove_unused
from objectfolder.workspace.code_digests import code_digest
from objectfolder.workspace.layout import Benchmarks

#: Files in a progress folder that are kept as results: a trained model, a figure, an animation.
KEPT = {
    "model.safetensors": Benchmarks.model,
    "sheet.png": Benchmarks.sheet,
    "episodes.gif": Benchmarks.film,
}

Report = Callable[[str], None]


@dataclass(frozen=True)
class Objects:
    """Objects of a split, known before they are sampled."""

    keys: Sequence[str]  #: in label order
    labels: np.ndarray  #: (rows,) int64, the object of each row
    materials: Sequence[str] = ()  #: of the objects, as far as a task asks for them


def any_objects(split: Split, objects: Objects) -> None:
    """Accept all objects from which the split can be made."""


@dataclass(frozen=True)
class Task:
    """A benchmark task; each task module declares its own."""

    name: str  #: of the stage, and prefix of result files
    config: type[Any]  #: dataclass of the task's section in ``params.yaml``
    #: Takes a `Job` or a `objectfolder.benchmarks.tasks.robots.RobotJob`. Returns scores, including the
    #: ``seconds`` taken, and rows of training curves.
    run: Callable[[Any], tuple[dict[str, Any], list[list[Any]]]]
    columns: tuple[str, ...]  #: of the training curves
    samples: Callable[[dict[str, Path]], Samples] | None = None  #: opens samples by key; None for robots
    #: Raises ObjectFolderError if the task cannot be trained on a split of these objects.
    check: Callable[[Split, Objects], None] = any_objects
    encodes: tuple[str, ...] = ()  #: modalities that it makes encoders for


class Run(Protocol):
    """One run of a task: `SplitRun` or `objectfolder.benchmarks.tasks.robots.ObjectRun`."""

    @property
    def task(self) -> Task:
        """Task to run."""

    @property
    def part(self) -> str:
        """Split or object key, which names the result files."""

    @property
    def folder(self) -> Benchmarks:
        """Folder of results."""

    def identity(self) -> tuple[Any, ...]:
        """Return everything that the result of each seed depends on."""

    def job(self, progress: Path, report: Report) -> Any:
        """Return the argument of the task."""

    def description(self) -> dict[str, Any]:
        """Return entries to add to the scores."""


@dataclass(frozen=True)
class SplitRun:
    """Run of a task on one split of the samples of many objects."""

    task: Task
    part: str  #: split, "seen" or "unseen"
    samples: Samples
    params: TaskParams[Any]
    folder: Benchmarks
    weights: Weights | None = None  #: initial weights of encoders; default: random
    device: str | None = None  #: to train on; default: a GPU if there is one

    def identity(self) -> tuple[Any, ...]:
        """Return everything that the result of each seed depends on."""
        weights = [] if self.weights is None else [file_digest(self.weights.path)]
        given = weights, own_code(self.params.encode.encoder)
        # The frozen list of objects is data, which is part of no code.
        rows = self.split.digest
        device = torch.device(training_device(self.device)).type  # a GPU trains in bfloat16
        return self.samples.digest, rows, self.params.one_seed(), code_digest(self.task.run), given, device

    @property
    def split(self) -> Split:
        """Rows of each part."""
        return named_split(self.part, self.samples.keys, self.samples.count)

    def job(self, progress: Path, report: Report) -> Job[Any]:
        """Return the argument of the task."""
        encode = self.params.encode
        return Job(
            self.samples,
            self.split,
            self.params.settings,
            registered(encode.encoder),
            encode.sizes,
            self.params.seed,
            progress,
            self.weights,
            training_device(self.device),
            report,
            encode.subtract,
            encode.shift,
            encode.precision,
            encode.flip,
        )

    def description(self) -> dict[str, Any]:
        """Return entries to add to the scores."""
        return {"keys": self.samples.keys}


@dataclass(frozen=True)
class RunTime:
    """Time that a run took, including interrupted calls as far as their last report."""

    seconds: float  #: of training and scoring
    cpu_seconds: float  #: of this process


class _ProcessorTime:
    """Processor time of all calls that worked in a progress folder, kept there at each report."""

    def __init__(self, progress: Path):
        self._path, self._start = progress / "processor_seconds.json", time.process_time()
        self._before: float = read_json(self._path) if self._path.is_file() else 0.0

    def keep(self) -> float:
        """Write and return the seconds so far."""
        seconds = self._before + time.process_time() - self._start
        write_json(self._path, seconds)
        return seconds


def run_benchmark(spec: Run, report: Report) -> RunTime:
    """Run a task and write its scores, training curves and the files in `KEPT`.

    An interrupted run is resumed, unless its inputs, parameters or code have changed. What was finished is
    kept for the next run, which may have more seeds.

    Parameters
    ----------
    spec : SplitRun or ObjectRun
    report : callable
        Called with a line of text about each part of the training.

    Returns
    -------
    RunTime

    Raises
    ------
    ObjectFolderError
        If the split cannot be made from these objects, or the task fails.
    """
    task, part, folder = spec.task, spec.part, spec.folder
    progress = folder.progress(task.name, part, spec.identity())
    refuse_links(progress, folder.dir)
    waiting = f"waiting for another process that runs {task.name}, {part}, in {folder.dir}"
    with exclusive(progress, lambda: report(waiting)):  # and then find everything finished
        spent = _ProcessorTime(progress)

        def keep_and_report(line: str) -> None:
            spent.keep()
            report(line)

        scores, curve = task.run(spec.job(progress, keep_and_report))
        write_results(task, part, folder, progress, scores | spec.description(), curve)
        cost = RunTime(scores["seconds"], spent.keep())
    for other in folder.outdated_progress(task.name, part, progress):
        remove_unused(other)
    return cost


def write_results(
    task: Task,
    part: str,
    folder: Benchmarks,
    progress: Path,
    scores: dict[str, Any],
    curve: Sequence[Sequence[Any]],
) -> None:
    """Write scores and curves of a finished task, and move the files in `KEPT` out of its progress folder.

    ``seconds`` are left out of the scores, so that the same inputs give the same bytes.
    """
    rows = StringIO()
    csv.writer(rows, lineterminator="\n").writerows([task.columns, *curve])
    write_text(folder.curve(task.name, part), rows.getvalue())
    for name, path in KEPT.items():
        kept = path(folder, task.name, part)
        if (progress / name).exists():
            (progress / name).replace(kept)
        else:
            kept.unlink(missing_ok=True)  # of an earlier run
    write_json(folder.result(task.name, part), {k: v for k, v in scores.items() if k != "seconds"})


def training_device(device: str | None = None) -> str:
    """Return the device to train on: the given one, else a GPU if there is one.

    Raises
    ------
    ObjectFolderError
        If torch cannot use it here.
    """
    chosen = device or ("cuda" if torch.cuda.is_available() else "cpu")
    try:
        torch.empty(0, device=chosen)
    except (RuntimeError, AssertionError) as error:  # an unknown name; a torch without CUDA
        reason = str(error).partition("\n")[0]
        raise ObjectFolderError(
            f"--device {chosen}: {reason}; expected cpu, or cuda with a GPU and a torch built for it "
            "(`objectfolder doctor`)"
        ) from error
    return chosen


def machine(device: str | None = None) -> str:
    """Return the name of the processor that nets train on."""
    if device != "cpu" and torch.cuda.is_available():
        return torch.cuda.get_device_name(device)
    models = re.findall(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return models[0] if models else platform.processor()
