"""Run benchmarks on Object Files outside the pipeline, as the command line does."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from objectfolder.benchmarks.collect import (
    Tracker,
    collect_all_grasps,
    collect_glances,
    collect_observations,
    load_object_files,
)
from objectfolder.benchmarks.datasets.glances import Glances
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.datasets.observe_config import ObserveConfig
from objectfolder.benchmarks.datasets.splits import label_order, named_split
from objectfolder.benchmarks.models.encoders import check_encoder, read_weights
from objectfolder.benchmarks.params import RobotParams, TaskParams, robot_params, splits_of, task_params
from objectfolder.benchmarks.tasks.running import (
    Objects,
    Report,
    Run,
    SplitRun,
    Task,
    machine,
    run_benchmark,
    training_device,
)
from objectfolder.engine.process import in_processes
from objectfolder.engine.resources import cores
from objectfolder.errors import ObjectFolderError, plural
from objectfolder.io import read_json, write_json
from objectfolder.workspace import params as workspace
from objectfolder.workspace.installed import pipeline_folder
from objectfolder.workspace.layout import Benchmarks
from objectfolder.workspace.presets import read_preset

Scores = dict[str, dict[str, Any]]  #: contents of result files, by split or object


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Options of a benchmark on Object Files; None stands for the default."""

    files: Sequence[Path] | None = None  #: Object Files, or folders that contain some; default: ``build``
    preset: str | None = None  #: default: ``params.yaml`` of the workspace
    out: Path | None = None  #: folder of results; default: ``benchmarks/PRESET``
    splits: Sequence[str] | None = None  #: default: those of the task that the objects allow
    seeds: int | None = None
    encoder: str | None = None
    weights: Path | None = None
    threads: int | None = None  #: default: one per core
    device: str | None = None  #: default: a GPU if there is one

    @property
    def folder(self) -> Benchmarks:
        """Folder of results."""
        return Benchmarks(self.out or Path("benchmarks") / (self.preset or "own"))

    @property
    def cores(self) -> int:
        """Threads to use in total."""
        return self.threads or cores()

    def values(self) -> tuple[dict[str, Any], Path]:
        """Return ``params.yaml`` with the preset merged into it, and the file to name in errors.

        Outside a workspace, with files and a preset, both are those of the package.
        """
        root = Path()
        if not (root / workspace.PARAMS_FILE).is_file():
            if not self.files or self.preset is None:
                raise ObjectFolderError(
                    f"{workspace.PARAMS_FILE} does not exist; run inside an objectfolder workspace, or name "
                    "Object Files and give --preset, such as --preset quick"
                )
            root = pipeline_folder()
        values, path = workspace.read(root / workspace.PARAMS_FILE), root / workspace.PARAMS_FILE
        if self.preset is not None:
            sections, path = read_preset(self.preset, root)
            values |= sections
        return values, path

    def with_seeds(self, settings: Any) -> Any:
        """Return a task's section with the chosen number of seeds."""
        return settings if self.seeds is None else replace(settings, seeds=self.seeds)

    def task_params(self, task: Task, values: dict[str, Any], path: Path) -> TaskParams[Any]:
        """Return the parameters of a task, with the chosen encoder and number of seeds."""
        params = task_params(task.config, values, path)
        encode = params.encode if self.encoder is None else replace(params.encode, encoder=self.encoder)
        return replace(params, settings=self.with_seeds(params.settings), encode=encode)


def run_on_splits(task: Task, options: BenchmarkOptions, report: Report, track: Tracker) -> Scores:
    """Collect the samples of all objects and run a task on each split; splits run in parallel on a CPU.

    Parameters
    ----------
    task : Task
    options : BenchmarkOptions
    report : callable
        A module-level function, called with lines of text, also in other processes.
    track : callable
        Shows the progress of sampling.

    Returns
    -------
    Scores by split.

    Raises
    ------
    ObjectFolderError
        If an option is wrong or a split cannot be made, before any work; or if sampling or the task fails.
    """
    known = splits_of(task.name)
    splits = list(dict.fromkeys(options.splits or known))
    for split in splits:
        if split not in known:
            why = "; materials are recognized of unseen objects, too: --label material"
            raise ObjectFolderError(
                f"--split {split!r} is unknown here, expected {' or '.join(known)}"
                f"{why if task.name == 'recognize' else ''}"
            )
    values, path = options.values()
    params = options.task_params(task, values, path)
    weights = None if options.weights is None else read_weights(options.weights)
    check_encoder(params.encode, task.encodes, weights)  # these two fail before any work
    device = training_device(options.device)
    sources, folder, cores = load_object_files(options.files), options.folder, options.cores

    def announce(count: int, samples: str) -> None:
        keys = label_order(sources)
        labels = np.repeat(np.arange(len(keys)), count)
        objects = Objects(keys, labels, [sources[key].file.material for key in keys])
        problems = {}
        for split in splits:  # fails before any work
            try:
                task.check(named_split(split, keys, count), objects)
            except ObjectFolderError as error:
                problems[split] = error
        if problems and (options.splits or len(problems) == len(splits)):
            raise next(iter(problems.values()))
        for split, problem in problems.items():
            splits.remove(split)
            report(f"left out: {problem}")
        report(f"{plural(len(sources), 'object')}, {count} {samples} of each")

    if task.samples is Observations:
        observe = workspace.settings(ObserveConfig, values, path)
        announce(observe.observations, "observations")
        folders = collect_observations(sources, observe, params.seed, folder, cores, track)
    elif task.samples is Glances:
        count, size = params.settings.contacts, params.encode.touch
        announce(count, "close views and touches")
        folders = collect_glances(sources, count, size, params.seed, folder, cores, track)
    else:
        wanted = workspace.settings(workspace.section_config("grasp_data"), values, path)
        announce(wanted.grasps, "grasps")
        hulls = _max_hulls(values, path)
        folders = collect_all_grasps(sources, wanted, hulls, params.seed, folder, cores, track, report)
    jobs = min(cores, len(splits)) if device == "cpu" else 1
    shared = (folders, params, folder, options.weights, cores // jobs, device, report)
    _call_all(_run_split, [(task, split, *shared) for split in splits], jobs)
    return {split: read_json(folder.result(task.name, split)) for split in splits}


def _run_split(
    task: Task,
    split: str,
    folders: dict[str, Path],
    params: TaskParams[Any],
    folder: Benchmarks,
    weights: Path | None,
    threads: int,
    device: str,
    report: Report,
) -> None:
    assert task.samples is not None
    with _bound(threads):
        initial = None if weights is None else read_weights(weights)
        spec = SplitRun(task, split, task.samples(folders), params, folder, initial, device)
        _run_timed(spec, report, threads, device)


def run_on_objects(task: Task, options: BenchmarkOptions, report: Report, jobs: int = 1) -> Scores:
    """Run a robot's task with each object.

    Parameters
    ----------
    task : Task
    options : BenchmarkOptions
        ``threads`` are those of one object's simulation.
    report : callable
        A module-level function, called with lines of text, also in other processes.
    jobs : int
        Objects in parallel.

    Returns
    -------
    Scores by object key.

    Raises
    ------
    ObjectFolderError
        If an option is wrong, before any work; or if the task fails.
    """
    values, path = options.values()
    params = robot_params(task.config, values, path)
    params = replace(params, settings=options.with_seeds(params.settings))
    hulls, folder = _max_hulls(values, path), options.folder
    sources = load_object_files(options.files)
    shared = (hulls, params, folder, options.cores, report)
    _call_all(_run_object, [(task, source.path, *shared) for source in sources.values()], jobs)
    return {key: read_json(folder.result(task.name, key)) for key in sources}


def run_on_contacts(options: BenchmarkOptions, report: Report, jobs: int = 1) -> Scores:
    """Localize contacts on each object (`objectfolder.benchmarks.tasks.localization.localize`).

    Parameters
    ----------
    options : BenchmarkOptions
    report : callable
        A module-level function, called with lines of text, also in other processes.
    jobs : int
        Objects in parallel, which share the threads.

    Returns
    -------
    Scores by object key.

    Raises
    ------
    ObjectFolderError
        If an option is wrong, before any work; or if the task fails.
    """
    from objectfolder.benchmarks.datasets.contacts import contact_split
    from objectfolder.benchmarks.tasks.localization import LOCALIZE

    values, path = options.values()
    params = options.task_params(LOCALIZE, values, path)
    check_encoder(params.encode, LOCALIZE.encodes)  # these three fail before any work
    contact_split(params.settings.contacts)
    device = training_device(options.device)
    sources, folder = load_object_files(options.files), options.folder
    threads = max(1, options.cores // jobs)
    shared = (params, folder, threads, device, report)
    _call_all(_localize, [(source.path, *shared) for source in sources.values()], jobs)
    return {key: read_json(folder.result(LOCALIZE.name, key)) for key in sources}


def _localize(
    path: Path,
    params: TaskParams[Any],
    folder: Benchmarks,
    threads: int,
    device: str,
    report: Report,
) -> None:
    from objectfolder.benchmarks.tasks.localization import ContactRun
    from objectfolder.objectfile.file import ObjectFile

    with _bound(threads):
        try:
            _run_timed(ContactRun(ObjectFile.load(path), params, folder, device), report, threads, device)
        except ObjectFolderError as error:
            raise ObjectFolderError(f"{path}: {error}") from error


def _run_object(
    task: Task,
    path: Path,
    max_hulls: int,
    params: RobotParams[Any],
    folder: Benchmarks,
    threads: int,
    report: Report,
) -> None:
    from objectfolder.benchmarks.tasks.robots import ObjectRun
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.objectfile.file import ObjectFile

    with _bound(1):
        file = ObjectFile.load(path)
        try:
            hulls = cached_hulls(file, folder.hulls, max_hulls)
            _run_timed(ObjectRun(task, file, hulls, params, folder, threads), report, threads, "cpu")
        except ObjectFolderError as error:
            raise ObjectFolderError(f"{path}: {error}") from error


@contextmanager
def _bound(threads: int) -> Iterator[None]:
    """Bind torch and numpy to so many threads."""
    torch.set_num_threads(threads)
    with threadpool_limits(threads):
        yield


def _run_timed(spec: Run, report: Report, threads: int, device: str) -> None:
    """Run a task, and write its cost beside the results; that of a finished run stays."""
    cost, path = run_benchmark(spec, report), spec.folder.machine(spec.task.name, spec.part)
    if path.is_file() and read_json(path).get("seconds") == cost.seconds:
        return
    today = datetime.now(UTC).date().isoformat()
    where = {"threads": threads, "machine": machine(device), "date": today}
    write_json(path, asdict(cost) | where)


def _call_all(call: Callable[..., None], arguments: list[tuple[Any, ...]], jobs: int) -> None:
    """Call a function with each of the arguments, in processes if there are several jobs.

    Raises
    ------
    ObjectFolderError
        If calls fail, after all others are finished.
    """
    attempts = [(call, *given) for given in arguments]
    if min(jobs, len(attempts)) > 1:
        problems = list(in_processes(_problem, attempts, jobs))
    else:
        problems = [_problem(*given) for given in attempts]
    failed = sorted(problem for problem in problems if problem is not None)
    if failed:
        rest = len(attempts) - len(failed)
        kept = f"\nThe other {rest} ran; asked for without these, the results are printed." if rest else ""
        raise ObjectFolderError("\n".join(failed) + kept)


def _problem(call: Callable[..., None], *arguments: Any) -> str | None:
    """Call a function; return the message of its error, if it fails."""
    try:
        call(*arguments)
    except ObjectFolderError as error:
        return str(error)
    return None


def _max_hulls(values: dict[str, Any], path: Path) -> int:
    hulls: int = workspace.settings(workspace.section_config("decompose"), values, path).hulls
    return hulls
