"""Run benchmarks on Object Files from anywhere: load them, sample what a task needs, train and score.

The stages of a build run the same code (`objectfolder.benchmarks.tasks.running`), with one thread and with
the settings and objects of the workspace.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.base.io import read_json, write_json
from objectfolder.benchmarks.datasets import close_ups, grasps, observations, sampling
from objectfolder.benchmarks.datasets.samples import Samples, has_uncertain_sound, object_digest
from objectfolder.benchmarks.datasets.settings import DecomposeConfig, GraspDataConfig, ObserveConfig
from objectfolder.benchmarks.datasets.splits import label_order, named_split
from objectfolder.benchmarks.models.encoders import check_encoder, read_weights
from objectfolder.benchmarks.reporting.tables import describe_uncertain
from objectfolder.benchmarks.tasks.job import Report
from objectfolder.benchmarks.tasks.running import KnownObject, Run, machine, run_benchmark, training_device
from objectfolder.benchmarks.tasks.task import Objects, Scores, Task, TaskParams, find_task
from objectfolder.benchmarks.tasks.vision_to_touch import VisionToTouchConfig
from objectfolder.engine.process import in_processes
from objectfolder.engine.resources import cores
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace import params as workspace
from objectfolder.workspace.installed import pipeline_folder
from objectfolder.workspace.layout import Benchmarks, Build
from objectfolder.workspace.lookup import find_object_files
from objectfolder.workspace.presets import read_preset
from objectfolder.workspace.stages import BENCHMARKS

if TYPE_CHECKING:
    from objectfolder.sim.body import RigidBody

#: Wraps an iteration in a progress bar, given its description and length.
Tracker = Callable[[Iterable[Any], str, int], Iterable[Any]]
Sources = Mapping[str, "LoadedFile"]  #: by object key
#: Open the samples that tasks name, given their folders by key.
SAMPLES: dict[str, Callable[[Mapping[str, Path]], Samples]] = {
    "observations": observations.certain_observations,
    "close_ups": observations.CloseUps,
    "grasps": grasps.Grasps,
}
#: What samples of an Object File depend on, whether a folder holds them, and what writes them. Each takes the
#: file and the ``_sample_settings``, or the former's answer.
SAMPLED: dict[str, tuple[Callable[..., dict[str, Any]], Callable[..., bool], Callable[..., None]]] = {
    "observations": (sampling.observation_request, sampling.is_sampled, sampling.sample_observations),
    "close_ups": (close_ups.close_up_request, close_ups.has_close_ups, close_ups.sample_close_ups),
}
TITLES = {"observations": "observing objects", "close_ups": "looking and touching"}  #: of progress


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Options of a benchmark on Object Files; None stands for the default."""

    files: Sequence[Path] | None = None  #: what `find_object_files` takes; default: ``build``
    preset: str | None = None  #: default: ``params.yaml`` of the workspace
    out: Path | None = None  #: folder of results; default: ``benchmarks/PRESET``
    splits: Sequence[str] | None = None  #: default: those of the task that the objects allow
    seeds: int | None = None
    encoder: str | None = None
    weights: Path | None = None
    threads: int | None = None  #: in total; default: one per core
    device: str | None = None  #: default: a GPU if there is one
    jobs: int | None = None  #: objects in parallel, which share the threads; default: see `run_task`

    @property
    def folder(self) -> Benchmarks:
        """Folder of results."""
        return Benchmarks(self.out or Path("benchmarks") / (self.preset or "own"))

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

    def params(self, task: Task, values: dict[str, Any], path: Path) -> TaskParams[Any]:
        """Return the parameters of a task, with the chosen encoder and number of seeds."""
        params = task.params(values, path)
        if self.seeds is not None:
            params = replace(params, settings=replace(params.settings, seeds=self.seeds))
        if self.encoder is not None and params.encode is not None:
            params = replace(params, encode=replace(params.encode, encoder=self.encoder))
        return params


def run_task(task: Task, options: BenchmarkOptions, report: Report, track: Tracker) -> dict[str, Scores]:
    """Run a task on each split of its samples, or with each object.

    Splits run in parallel on a CPU. Objects run one after another with all threads, or as many at a time as
    ``options.jobs``; of a task that has no use for several threads, as many as there are cores.

    ``report``, a module-level function, is called with lines of text, also in other processes; ``track``
    shows the progress of sampling. Returns scores by split or object key. Raises ObjectFolderError if an
    option is wrong or a split cannot be made, before any work; or if sampling or the task fails.
    """
    wanted = _chosen_splits(task, options)
    if not task.splits:
        task.check()
    values, path = options.values()
    params = options.params(task, values, path)
    weights = None if options.weights is None else read_weights(options.weights)
    if params.encode is not None:
        check_encoder(params.encode, task.encodes, weights)  # these fail before any work
    device = training_device(options.device) if task.trains_nets else "cpu"
    sources, folder, threads = load_object_files(options.files), options.folder, options.threads or cores()
    given: dict[str, Any]
    if task.splits:
        count, asked = _sample_settings(task, params, values, path)
        parts = _possible_splits(task, options, wanted, sources, count, report)
        if task.samples == "grasps":
            folders = collect_all_grasps(sources, asked, folder, threads, track, report)
        else:
            folders = collect_samples(str(task.samples), sources, asked, folder, threads, track)
        given = dict.fromkeys(parts, folders)
        jobs = min(threads, len(parts)) if device == "cpu" else 1
    else:
        max_hulls = workspace.settings(DecomposeConfig, values, path).hulls if task.robot else 0
        given = {key: (source.path, max_hulls) for key, source in sources.items()}
        jobs = options.jobs or (threads if task.single_threaded else 1)
    each = 1 if task.single_threaded else max(1, threads // jobs)
    shared = {"task": task, "params": params, "folder": folder, "device": device, "threads": each}
    attempts = [(part, inputs, options.weights, report, shared) for part, inputs in given.items()]
    _call_all(_run_part, attempts, jobs)
    return {part: read_json(folder.result(task.name, part)) for part in given}


def _chosen_splits(task: Task, options: BenchmarkOptions) -> list[str]:
    splits = list(dict.fromkeys(options.splits or task.splits))
    for split in splits:
        if split not in task.splits:
            why = "; materials are recognized of unseen objects, too: --label material"
            raise ObjectFolderError(
                f"--split {split!r} is unknown here, expected {' or '.join(task.splits)}"
                f"{why if task.name == 'recognize' else ''}"
            )
    return splits


def _possible_splits(
    task: Task,
    options: BenchmarkOptions,
    splits: Sequence[str],
    sources: Sources,
    count: int,
    report: Report,
) -> list[str]:
    """Return the splits that the task can be trained on; report what is left out, unless it was asked for."""
    marked = []
    if task.samples == "observations":  # of tasks that use sound
        marked = [key for key in label_order(sources) if has_uncertain_sound(sources[key].file)]
    if marked:
        report(describe_uncertain(marked))
    keys = label_order(sources.keys() - marked)
    labels = np.repeat(np.arange(len(keys)), count)
    objects = Objects(keys, labels, [sources[key].file.material for key in keys])
    problems = {}
    for split in splits:
        try:
            task.check(named_split(split, keys, count), objects)
        except ObjectFolderError as error:
            problems[split] = error
    if problems and (options.splits or len(problems) == len(splits)):
        raise next(iter(problems.values()))
    for problem in problems.values():
        report(f"left out: {problem}")
    samples = {"close_ups": "close views and touches"}.get(task.samples or "", task.samples)
    report(f"{plural(len(keys), 'object')}, {count} {samples} of each")
    return [split for split in splits if split not in problems]


def _sample_settings(
    task: Task, params: TaskParams[Any], values: dict[str, Any], path: Path
) -> tuple[int, tuple[Any, ...]]:
    """Return how many samples of each object a task has, and what they depend on besides the object."""
    if task.samples == "close_ups":
        assert params.encode is not None
        contacts = workspace.settings(VisionToTouchConfig, values, path).contacts
        return contacts, (contacts, params.encode.touch, params.seed)
    if task.samples == "grasps":
        wanted = workspace.settings(GraspDataConfig, values, path)
        hulls = workspace.settings(DecomposeConfig, values, path).hulls
        return wanted.grasps, (wanted.grasps, wanted, params.seed, hulls)
    observe = workspace.settings(ObserveConfig, values, path)
    return observe.observations, (observe, params.seed)


def _call_all(call: Callable[..., str | None], attempts: list[tuple[Any, ...]], jobs: int) -> None:
    """Call a function, which returns what failed, so many times at once; in processes if there are several.

    Raises ObjectFolderError if calls fail, after all others are finished.
    """
    several = min(jobs, len(attempts)) > 1
    problems = in_processes(call, attempts, jobs) if several else [call(*given) for given in attempts]
    if failed := sorted(problem for problem in problems if problem is not None):
        rest = len(attempts) - len(failed)
        kept = f"\nThe other {rest} ran; asked for without these, the results are printed." if rest else ""
        raise ObjectFolderError("\n".join(failed) + kept)


def _run_part(
    part: str, inputs: Any, weights: Path | None, report: Report, shared: dict[str, Any]
) -> str | None:
    """Run a task with folders of samples, or with an object, given its path and hulls; return what failed.

    Its cost is written beside the results; that of a finished run stays.
    """
    task, folder, threads = shared["task"], shared["folder"], shared["threads"]
    bound = threads if task.trains_nets else 1
    with _limit_threads(bound):
        try:
            known = SAMPLES[task.samples](inputs) if task.splits else _known_object(task, folder, *inputs)
            initial = None if weights is None else read_weights(weights)
            run = Run(training=task.load(), part=part, inputs=known, weights=initial, **shared)
            cost, path = run_benchmark(run, report), folder.machine(task.name, part)
        except ObjectFolderError as error:
            return str(error) if task.splits else f"{inputs[0]}: {error}"
    if not path.is_file() or read_json(path).get("seconds") != cost.seconds:
        today = datetime.now(UTC).date().isoformat()
        where = {"threads": threads, "machine": machine(shared["device"]), "date": today}
        write_json(path, asdict(cost) | where)
    return None


@contextmanager
def _limit_threads(count: int) -> Iterator[None]:
    """Give the libraries of this process so many threads, for a while."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        with threadpool_limits(count):
            yield
    finally:
        torch.set_num_threads(before)


def _known_object(task: Task, folder: Benchmarks, path: Path, max_hulls: int) -> KnownObject:
    file = ObjectFile.load(path)
    if not task.robot:
        return KnownObject(file, object_digest(file))
    from objectfolder.sim.hulls import hulls_digest

    body = _body(file, folder, max_hulls)
    return KnownObject(file, object_digest(file) + hulls_digest(body.hulls), body)


def _body(file: ObjectFile, folder: Benchmarks, max_hulls: int) -> "RigidBody":
    from objectfolder.sim.body import rigid_body  # needs what only robots need
    from objectfolder.sim.hulls import cached_hulls

    return rigid_body(file, cached_hulls(file, folder.hulls, max_hulls))


class LoadedFile(NamedTuple):
    """An Object File and its path."""

    path: Path
    file: ObjectFile


def load_object_files(places: Sequence[Path] | None) -> dict[str, LoadedFile]:
    """Load the Object Files that users name; return them by key. Default: ``build``.

    Raises ObjectFolderError if `find_object_files` finds none, one is invalid, or two are of the same object.
    """
    sources: dict[str, LoadedFile] = {}
    named = places or [Build("any").dir.parent]
    for path in [found for place in named for found in find_object_files(place)]:
        file = ObjectFile.load(path)
        if file.key in sources:
            raise ObjectFolderError(
                f"{path} and {sources[file.key].path} both contain {file.key}; give each object once"
            )
        sources[file.key] = LoadedFile(path, file)
    return sources


def collect_samples(
    kind: str, sources: Sources, settings: tuple[Any, ...], folder: Benchmarks, jobs: int, track: Tracker
) -> dict[str, Path]:
    """Sample each object, as `SAMPLED` says, unless its folder is complete; return the folders by key.

    Raises ObjectFolderError if an object cannot be sampled, mostly before any work.
    """
    request_of, is_done, _ = SAMPLED[kind]
    folders = {key: getattr(folder, kind)(key) for key in sources}
    requests = {key: request_of(source.file, *settings) for key, source in sources.items()}
    new = [
        (kind, source.path, settings, folders[key])
        for key, source in sources.items()
        if not is_done(requests[key], folders[key])
    ]
    _sample_all(_sample, new, jobs, track, TITLES[kind])
    return folders


def _sample_all(
    sample: Callable[..., None], new: list[tuple[Any, ...]], jobs: int, track: Tracker, title: str
) -> None:
    """Call a function for each of the new objects, several at a time."""
    if new:  # starting processes takes seconds
        for _ in track(in_processes(sample, new, jobs), title, len(new)):
            pass


def _sample(kind: str, path: Path, settings: tuple[Any, ...], folder: Path) -> None:
    with _limit_threads(1):
        SAMPLED[kind][2](ObjectFile.load(path), *settings, folder)


def collect_all_grasps(
    sources: Sources,
    settings: tuple[int, GraspDataConfig, int, int],
    folder: Benchmarks,
    jobs: int,
    track: Tracker,
    report: Report,
) -> dict[str, Path]:
    """Simulate grasps of each object, unless its folder is complete; return the folders by key.

    Touches are also simulated on the true surfaces if these lie beside all Object Files, and all touch nets
    answer the presses of pads.
    """
    from objectfolder.benchmarks.datasets.grasp_data import grasp_request, is_collected
    from objectfolder.mesh.ply import read_surface

    _, wanted, seed, max_hulls = settings
    folders = {key: folder.grasps(key) for key in sources}
    surfaces = {key: source.path.with_name(Build(key).surface.name) for key, source in sources.items()}
    lacking = [key for key, surface in surfaces.items() if not surface.is_file()]
    fixed = [key for key, source in sources.items() if source.file.fixed_contact]
    for keys, reason in (
        (lacking, "no true surface beside the Object File of"),
        (fixed, "a touch net of images, which knows one press alone, in"),
    ):
        if keys:
            report(
                f"{reason} {', '.join(keys)}: touches are simulated from Object Files only, "
                "without explicit ones to compare with"
            )
    new = []
    for key, source in sources.items():
        surface = None if lacking or fixed else surfaces[key]
        if (folders[key] / grasps.RECORD).is_file():  # and hence its hulls
            truth = None if surface is None else read_surface(surface)
            body = _body(source.file, folder, max_hulls)
            if is_collected(grasp_request(source.file, body, wanted, seed, truth), folders[key]):
                continue
        new.append((source.path, surface, settings, folder, report))
    _sample_all(_collect_grasps, new, jobs, track, "grasping objects")
    return folders


def _collect_grasps(
    path: Path,
    surface: Path | None,
    settings: tuple[int, GraspDataConfig, int, int],
    folder: Benchmarks,
    report: Report,
) -> None:
    from objectfolder.benchmarks.datasets.grasp_data import collect_grasps
    from objectfolder.mesh.ply import read_surface

    count, wanted, seed, max_hulls = settings
    with _limit_threads(1):
        file = ObjectFile.load(path)
        truth, body = None if surface is None else read_surface(surface), _body(file, folder, max_hulls)
        start = time.perf_counter()
        collect_grasps(file, body, wanted, seed, folder.grasps(file.key), truth)
        seconds = time.perf_counter() - start
    report(f"{file.key}: {count} grasps in {seconds:.0f} s, {count / seconds:.1f} per second")


def list_tasks() -> dict[str, Task]:
    """Return all tasks by name, also those that are variants of others."""
    tasks: dict[str, Task] = {}
    for task in map(find_task, BENCHMARKS):
        tasks[task.name] = task
        if task.variant is not None:
            tasks[task.variant.task.name] = task.variant.task
    return tasks
