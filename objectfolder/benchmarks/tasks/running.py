"""Run one benchmark task and write its results; shared by the stages and the command line."""

import csv
import platform
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from objectfolder.base.disk import refuse_links
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import file_digest, read_json, write_json, write_text
from objectfolder.base.locks import exclusive, remove_unused
from objectfolder.benchmarks.datasets.samples import Samples
from objectfolder.benchmarks.datasets.splits import Split, named_split
from objectfolder.benchmarks.models.encoders import Weights, own_code
from objectfolder.benchmarks.reporting.tables import describe_uncertain
from objectfolder.benchmarks.tasks.job import Job, ObjectJob, Report
from objectfolder.benchmarks.tasks.task import Scores, Task, TaskParams
from objectfolder.workspace.code_digests import code_digest
from objectfolder.workspace.layout import Benchmarks

if TYPE_CHECKING:
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.sim.body import RigidBody

#: Files in a progress folder that are kept as results: a trained model, a figure, an animation.
KEPT = {"model.safetensors": Benchmarks.model, "sheet.png": Benchmarks.sheet, "episodes.gif": Benchmarks.film}


@dataclass(frozen=True)
class KnownObject:
    """Object of a run."""

    file: "ObjectFile"
    digest: str  #: of all that the result depends on
    body: "RigidBody | None" = None  #: for a robot


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run of a task: on a split of the samples of many objects, or with one object."""

    task: Task
    training: Callable[[Any], tuple[Scores, list[list[Any]]]]  #: `Task.load`
    part: str  #: split, "seen" or "unseen", or object key
    inputs: Samples | KnownObject
    params: TaskParams[Any]
    folder: Benchmarks  #: of results
    weights: Weights | None = None  #: initial weights of encoders; default: random
    device: str | None = None  #: to train nets on; default: a GPU if there is one
    threads: int = 1  #: of a simulation; results do not depend on it

    def identity(self) -> tuple[Any, ...]:
        """Return everything that the result of each seed depends on."""
        given: tuple[Any, ...] = (self.inputs.digest, self.params.one_seed(), code_digest(self.training))
        if not isinstance(self.inputs, KnownObject):
            given += (self.split.digest,)  # the frozen list of objects is data, which is part of no code
        if self.params.encode is not None:
            given += (
                None if self.weights is None else file_digest(self.weights.path),
                own_code(self.params.encode.encoder),
                torch.device(training_device(self.device)).type,  # a GPU trains in bfloat16
            )
        return given

    @property
    def split(self) -> Split:
        """Rows of each part."""
        assert not isinstance(self.inputs, KnownObject)
        return named_split(self.part, self.inputs.keys, self.inputs.count)

    def job(self, progress: Path, report: Report) -> Job[Any] | ObjectJob[Any]:
        """Return the argument of the training function."""
        settings, encode, seed = self.params.settings, self.params.encode, self.params.seed
        device = "cpu" if encode is None else training_device(self.device)
        if isinstance(self.inputs, KnownObject):
            known = self.task.name, self.inputs.file, self.inputs.body, settings, seed
            return ObjectJob(*known, progress, report, self.threads, encode, self.weights, device)
        assert encode is not None
        inputs = self.inputs, self.split, settings, encode, seed
        return Job(*inputs, progress, self.weights, device, report)


@dataclass(frozen=True)
class RunTime:
    """Time that a run took, including interrupted calls as far as their last report."""

    seconds: float  #: of training and scoring
    cpu_seconds: float  #: of this process


def _keep_time(progress: Path) -> Callable[[], float]:
    """Return a function that writes and returns the processor time of all calls that worked in a folder."""
    path, start = progress / "processor_seconds.json", time.process_time()
    before: float = read_json(path) if path.is_file() else 0.0

    def keep() -> float:
        seconds = before + time.process_time() - start
        write_json(path, seconds)
        return seconds

    return keep


def run_stage(
    task: Task,
    training: Callable[[Any], tuple[Scores, list[list[Any]]]],
    part: str,
    inputs: Samples | KnownObject,
) -> None:
    """Run a task as a stage of a build: with the settings and in the folder of the workspace."""
    params, folder = task.params(), Benchmarks()
    run = Run(task=task, training=training, part=part, inputs=inputs, params=params, folder=folder)
    if isinstance(inputs, Samples) and inputs.uncertain:
        print(describe_uncertain(inputs.uncertain))
    run_benchmark(run, print)


def run_benchmark(run: Run, report: Report) -> RunTime:
    """Run a task and write its scores, training curves and the files in `KEPT`.

    An interrupted run is resumed, unless its inputs, parameters or code have changed. What was finished is
    kept for the next run, which may have more seeds. ``report`` gets a line about each part of the training.

    Raises ObjectFolderError if the split cannot be made from these objects, or the task fails.
    """
    task, part, folder = run.task, run.part, run.folder
    progress = folder.progress(task.name, part, run.identity())
    refuse_links(progress, folder.dir)
    waiting = f"waiting for another process that runs {task.name}, {part}, in {folder.dir}"
    with exclusive(progress, lambda: report(waiting)):  # and then find everything finished
        spent = _keep_time(progress)

        def keep_and_report(line: str) -> None:
            spent()
            report(line)

        scores, curve = run.training(run.job(progress, keep_and_report))
        if not isinstance(run.inputs, KnownObject):
            left_out = run.inputs.uncertain
            scores |= {"keys": run.inputs.keys} | ({"uncertain": left_out} if left_out else {})
        write_results(task, part, folder, progress, scores, curve)
        cost = RunTime(scores["seconds"], spent())
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

    Raises ObjectFolderError if torch cannot use it here.
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
