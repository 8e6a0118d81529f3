"""Run a task on one split and leave its results: what the stages and the command line share."""

import csv
import hashlib
import inspect
import platform
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

import objectfolder
from objectfolder.benchmarks.datasets.splits import named_split
from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.models.encoders import InputSizes, Weights, own_file, registered
from objectfolder.benchmarks.params import RobotParams, TaskParams
from objectfolder.benchmarks.tasks.job import Job, Samples
from objectfolder.io import atomic, file_digest, write_json
from objectfolder.workspace.code_digests import digests

if TYPE_CHECKING:
    import trimesh

#: What a task leaves in its progress folder under these names is kept: a net to ask, a picture or a film to
#: look at.
KEPT = {
    "model.safetensors": Benchmarks.model,
    "sheet.png": Benchmarks.sheet,
    "episodes.gif": Benchmarks.film,
}


#: A task, such as `objectfolder.benchmarks.tasks.recognition.recognize`: returns scores, with the ``seconds``
#: that they took, and rows of training curves.
Task = Callable[[Job[Any]], tuple[dict[str, Any], list[list[Any]]]]


def run_task(
    name: str,
    task: Task,
    columns: Sequence[str],
    split: str,
    observations: Samples,
    params: TaskParams[Any],
    folder: Benchmarks,
    report: Callable[[str], None],
    weights: Weights | None = None,
    device: str | None = None,
) -> float:
    """Run a task on one split and write its scores, curves and what else it has.

    An interrupted call is gone on from, unless observations, parameters, weights or the
    code of the task have changed.

    Parameters
    ----------
    name : str
        Of the task, one of `objectfolder.workspace.params.TASKS`.
    task : callable
    columns : sequence of str
        Of its training curves.
    split : str
    observations : Observations or Grasps
    params : TaskParams
    folder : Benchmarks
    report : callable
        Called with a line about each epoch.
    weights : Weights, optional
        That encoders start from.
    device : str, optional
        Where nets train; default: a GPU, if there is one.

    Returns
    -------
    Seconds that training and scoring took, those of interrupted calls included.

    Raises
    ------
    ObjectFolderError
        If the split cannot be made of these objects, or the task fails.
    """
    encode = params.encode
    sizes = InputSizes(encode.image, encode.spectrogram, encode.touch)
    files = [None if weights is None else weights.path, own_file(encode.encoder)]
    given = [file_digest(path) for path in files if path is not None]
    identity = (observations.digest, params, code_digest(task), given)
    progress = folder.progress(name, split, identity)
    scores, curve = task(
        Job(
            observations,
            named_split(split, observations.keys, observations.count),
            params.settings,
            registered(encode.encoder),
            sizes,
            params.seed,
            progress,
            weights,
            device or ("cuda" if torch.cuda.is_available() else "cpu"),
            report,
        )
    )
    return leave(name, split, folder, progress, scores | {"keys": observations.keys}, columns, curve)


def leave(
    name: str,
    split: str,
    folder: Benchmarks,
    progress: Path,
    scores: dict[str, Any],
    columns: Sequence[str],
    curve: Sequence[Sequence[Any]],
) -> float:
    """Write scores and curves of a task that is done, keep the files of `KEPT`, remove its progress.

    Returns
    -------
    The ``seconds`` among the scores, which are not written: the rest is the same whenever it is run.
    """
    with atomic(folder.curve(name, split)) as temporary, temporary.open("w", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([columns, *curve])
    for left, path in KEPT.items():
        if (progress / left).exists():
            (progress / left).replace(path(folder, name, split))
    write_json(folder.result(name, split), {k: v for k, v in scores.items() if k != "seconds"})
    rmtree(progress, ignore_errors=True)
    seconds: float = scores["seconds"]
    return seconds


def object_identity(
    path: Path, hulls: "Sequence[trimesh.Trimesh]", params: RobotParams[Any], task: Callable[..., Any]
) -> tuple[Any, ...]:
    """All that the results of a robot's task with an object follow from, for `Benchmarks.progress`.

    Parameters
    ----------
    path : Path
        The Object File.
    hulls : sequence of trimesh.Trimesh
    params : RobotParams
    task : callable
    """
    shapes = hashlib.sha256(b"".join(np.ascontiguousarray(hull.vertices).tobytes() for hull in hulls))
    return file_digest(path), shapes.hexdigest(), params, code_digest(task)


def machine(device: str | None = None) -> str:
    """Name of the processor that nets train on."""
    if device != "cpu" and torch.cuda.is_available():
        return torch.cuda.get_device_name(device)
    models = re.findall(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return models[0] if models else platform.processor()


def code_digest(task: Callable[..., Any]) -> str:
    """Digests of all modules of ours that a task runs."""
    package = Path(objectfolder.__file__).parent
    return digests(Path(inspect.getfile(task)).relative_to(package.parent), package.parent)
