"""Commands that run the benchmark tasks on Object Files, without the pipeline: bench."""

import os
import time
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from objectfolder.cli.console import console, print_wide, tracked
from objectfolder.errors import ObjectFolderError

if TYPE_CHECKING:
    from objectfolder.benchmarks.datasets.grasp_data import GraspDataConfig
    from objectfolder.benchmarks.datasets.sampling import ObserveConfig
    from objectfolder.benchmarks.layout import Benchmarks
    from objectfolder.benchmarks.params import TaskParams
    from objectfolder.benchmarks.reporting.tables import Table

#: Of each task; only that one is imported.
MODULES = {
    "recognize": "recognition",
    "retrieve": "retrieval",
    "reconstruct": "reconstruction",
    "grasp_stability": "grasp_stability",
}

bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Run the paper's benchmark tasks on Object Files: `recognition`, `retrieval`, `reconstruction`, and,"
    " with a robot, `stability`, `grasping`, `reach`.\n\n"
    "Objects are observed first: random views, impacts and touches are drawn from each Object File and kept "
    "in OUT/observations, where the next task finds them; grasps in OUT/grasps. What was interrupted goes on "
    "where it was.",
)

FilesArgument = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[FILE]...",
        help="Object Files, or folders that hold some (ObjectFile.safetensors); default: build.",
    ),
]
PresetOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="quick, standard or paper: how much is observed, how long nets train (params/NAME.yaml). "
        "Default: what params.yaml says.",
    ),
]
OutOption = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="Where results go; default: benchmarks/PRESET.")
]
SplitOption = Annotated[
    list[str] | None,
    typer.Option(
        "--split",
        help="seen: other observations of the trained objects; unseen: other objects. Repeat it for both; "
        "default: all that the task knows.",
    ),
]
SeedsOption = Annotated[
    int | None, typer.Option(min=1, help="Runs whose mean is the result; default: the preset's.")
]
EncoderOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.py:NAME",
        help="Encoder of views, spectrograms and touches: resnet18, or one that FILE.py registers "
        "(docs/benchmarks.md).",
    ),
]
WeightsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.pth",
        help="Weights to start from, such as torchvision's resnet18 of ImageNet; default: random.",
    ),
]
ThreadsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Default: all cores; splits share them and run side by side. The same number gives the same "
        "figures.",
    ),
]
DeviceOption = Annotated[
    str | None, typer.Option(help="Where nets train, such as cpu or cuda; default: a GPU if there is one.")
]


@bench_app.command()
def recognition(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    seeds: SeedsOption = None,
    encoder: EncoderOption = None,
    weights: WeightsOption = None,
    threads: ThreadsOption = None,
    device: DeviceOption = None,
) -> None:
    """Which object is it, from a view, an impact sound, a touch, or several of them?

    Accuracy on held-out observations, with its 95 % interval over seeds, beside chance and the paper's.

    `objectfolder bench recognition --preset quick`
    """
    _run("recognize", files, preset, out, None, seeds, encoder, weights, threads, device)


@bench_app.command()
def retrieval(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    split: SplitOption = None,
    seeds: SeedsOption = None,
    encoder: EncoderOption = None,
    weights: WeightsOption = None,
    threads: ThreadsOption = None,
    device: DeviceOption = None,
) -> None:
    """Find the sounds of what is seen, the touches of what is heard, and so on.

    Mean average precision for all six directions, beside CCA, chance and the paper's Table 3.

    `objectfolder bench retrieval --preset quick --split unseen`
    """
    _run("retrieve", files, preset, out, split, seeds, encoder, weights, threads, device)


@bench_app.command()
def reconstruction(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    split: SplitOption = None,
    encoder: EncoderOption = None,
    weights: WeightsOption = None,
    threads: ThreadsOption = None,
    device: DeviceOption = None,
) -> None:
    """What shape is it, from a view, an impact sound, or both?

    IoU, Chamfer-L1 and normal consistency, beside the average shape and the paper's Table 4. The net for
    views is kept: `objectfolder reconstruct PHOTO.jpg MESH.ply --model OUT/reconstruct_seen.safetensors`.

    `objectfolder bench reconstruction --preset quick --split seen`
    """
    _run("reconstruct", files, preset, out, split, None, encoder, weights, threads, device)


def _run(
    task: str,
    files: list[Path] | None,
    preset: str | None,
    out: Path | None,
    splits: list[str] | None,
    seeds: int | None,
    encoder: str | None,
    weights: Path | None,
    threads: int | None,
    device: str | None,
) -> None:
    import torch

    from objectfolder.benchmarks.datasets.grasp_data import GraspDataConfig
    from objectfolder.benchmarks.datasets.sampling import ObserveConfig
    from objectfolder.benchmarks.datasets.splits import label_order, named_split
    from objectfolder.benchmarks.layout import Benchmarks
    from objectfolder.benchmarks.models.encoders import make_encoder, read_weights, registered
    from objectfolder.benchmarks.params import splits_of, task_params
    from objectfolder.benchmarks.reporting.tables import table
    from objectfolder.engine.pool import in_processes
    from objectfolder.io import read_json
    from objectfolder.workspace import params as objects
    from objectfolder.workspace.presets import read_preset

    known = splits_of(task)
    splits = list(dict.fromkeys(splits or known))
    for split in splits:
        if split not in known:
            raise ObjectFolderError(f"--split {split!r} is unknown here, expected {' or '.join(known)}")
    values, path = objects.read(), Path(objects.PARAMS_FILE)
    if preset is not None:
        sections, path = read_preset(preset)
        values |= sections
    if encoder is not None:
        values["encode"] = {**(values.get("encode") or {}), "encoder": encoder}
    if seeds is not None:
        values[task] = {**(values.get(task) or {}), "seeds": seeds}
    params = task_params(objects.section_config(task), values, path)
    started = read_weights(weights) if weights is not None else None
    make_encoder(registered(params.encode.encoder), "vision", started)  # a wrong one is said before any work
    folder = Benchmarks(out if out is not None else Path("benchmarks") / (preset or "own"))
    threads = threads or os.cpu_count() or 1
    paths = _object_files(files)
    grasped = task == "grasp_stability"
    if grasped:
        wanted = objects.settings(GraspDataConfig, values, path)
        count = wanted.grasps
    else:
        observe = objects.settings(ObserveConfig, values, path)
        count = observe.observations
    for split in splits:  # what cannot be split is said before any work
        named_split(split, label_order(paths), count)
    console.print(f"{len(paths)} objects, {count} {'grasps' if grasped else 'observations'} of each")
    if grasped:
        hulls = objects.settings(objects.section_config("decompose"), values, path).hulls
        folders = _grasp(paths, wanted, hulls, params.seed, folder, threads)
    else:
        folders = _observe(paths, observe, params.seed, folder, threads)
    on_gpu = torch.cuda.is_available() if device is None else device != "cpu"
    together = 1 if on_gpu else min(threads, len(splits))
    calls = [(task, split, folders, params, folder, weights, threads // together, device) for split in splits]
    if together > 1:
        for _ in in_processes(_run_split, calls, together):
            pass
    else:
        for call in calls:
            _run_split(*call)
    for split in splits:
        _print(table(task, split, read_json(folder.result(task, split))))
        console.print(f"{folder.result(task, split)}  curves: {folder.curve(task, split)}", soft_wrap=True)


def _run_split(
    task: str,
    split: str,
    folders: dict[str, Path],
    params: "TaskParams[Any]",
    folder: "Benchmarks",
    weights: Path | None,
    threads: int,
    device: str | None,
) -> None:
    """Run a task on one split, and write what it took beside the results."""
    import torch

    from objectfolder.benchmarks.datasets.grasps import Grasps
    from objectfolder.benchmarks.datasets.observations import Observations
    from objectfolder.benchmarks.models.encoders import read_weights
    from objectfolder.benchmarks.tasks.running import machine, run_task
    from objectfolder.io import write_json

    torch.set_num_threads(threads)
    module = import_module(f"objectfolder.benchmarks.tasks.{MODULES[task]}")
    run, columns = getattr(module, task), module.CURVE_COLUMNS
    started = None if weights is None else read_weights(weights)
    before = time.process_time()
    samples = Grasps(folders) if task == "grasp_stability" else Observations(folders)
    seconds = run_task(task, run, columns, split, samples, params, folder, _say, started, device)
    took = {"seconds": seconds, "cpu_seconds": time.process_time() - before}
    write_json(folder.machine(task, split), took | {"threads": threads, "machine": machine(device)})


def _say(line: str) -> None:
    console.print(line, soft_wrap=True, highlight=False)


def _print(shown: "Table") -> None:
    from rich.table import Table

    grid = Table(title=shown.title)
    for i, column in enumerate(shown.columns):
        grid.add_column(column, justify="right" if i else "left")
    for row in shown.rows:
        grid.add_row(*row)
    print_wide(grid)
    console.print(shown.note, soft_wrap=True)


def _object_files(given: list[Path] | None) -> dict[str, Path]:
    """Object Files by key; the first look at each, so that a bad one is named before any work."""
    from objectfolder.benchmarks.datasets.observations import RECORD
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.workspace.layout import Build

    name = Build("any").object_file.name
    places = given or [Build("any").dir.parent]
    paths: list[Path] = []
    for place in places:
        found = sorted(place.rglob(name)) if place.is_dir() else [place] if given else []
        paths += [path for path in found if not (path.parent / RECORD).exists()]  # not those kept as observed
    if not paths:
        raise ObjectFolderError(f"no Object Files in {', '.join(map(str, places))}; build some, or name them")
    files: dict[str, Path] = {}
    for path in paths:
        key = ObjectFile.load(path).key
        if key in files:
            raise ObjectFolderError(
                f"{path} and {files[key]} are both of the object {key}; give each object once"
            )
        files[key] = path
    return files


def _observe(
    paths: dict[str, Path], params: "ObserveConfig", seed: int, folder: "Benchmarks", jobs: int
) -> dict[str, Path]:
    """Observe each object, several at a time; those that are observed already are left alone."""
    from objectfolder.benchmarks.datasets.sampling import are_sampled
    from objectfolder.engine.pool import in_processes
    from objectfolder.objectfile.file import ObjectFile

    wanted = (params.observations, params.resolution, seed)
    folders = {key: folder.observations(key) for key in paths}
    new = [
        (path, *wanted, folders[key])
        for key, path in paths.items()
        if not are_sampled(ObjectFile.load(path), *wanted, folders[key])
    ]
    if new:  # starting processes takes seconds
        for _ in tracked(in_processes(_observe_one, new, jobs), "observing objects", len(new)):
            pass
    return folders


def _grasp(
    paths: dict[str, Path], params: "GraspDataConfig", hulls: int, seed: int, folder: "Benchmarks", jobs: int
) -> dict[str, Path]:
    """Collect grasps of each object, several at a time; those that are there already are left alone."""
    from objectfolder.benchmarks.datasets.grasp_data import are_collected
    from objectfolder.benchmarks.datasets.grasps import RECORD
    from objectfolder.engine.pool import in_processes
    from objectfolder.envs.body import rigid_body
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.workspace.layout import Build

    wanted, folders = params, {key: folder.grasps(key) for key in paths}
    surfaces = {key: path.with_name(Build(key).surface.name) for key, path in paths.items()}
    lacking = [key for key, surface in surfaces.items() if not surface.is_file()]
    if lacking:
        _say(
            f"no true surface beside the Object File of {', '.join(lacking)}: touches are the Object Files' "
            "alone, without explicit ones to compare them with"
        )
    new = []
    for key, path in paths.items():
        if (folders[key] / RECORD).is_file():  # and so its hulls
            file = ObjectFile.load(path)
            body = rigid_body(file, cached_hulls(file, folder.hulls, hulls))
            if are_collected(file, body, wanted, seed, not lacking, folders[key]):
                continue
        new.append((path, None if lacking else surfaces[key], wanted, hulls, seed, folder))
    if new:
        for _ in tracked(in_processes(_grasp_one, new, jobs), "grasping objects", len(new)):
            pass
    return folders


def _grasp_one(
    path: Path, surface: Path | None, wanted: "GraspDataConfig", hulls: int, seed: int, folder: "Benchmarks"
) -> None:
    import torch
    from threadpoolctl import threadpool_limits

    from objectfolder.benchmarks.datasets.grasp_data import collect_grasps
    from objectfolder.envs.body import rigid_body
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.mesh.ply import read_surface
    from objectfolder.objectfile.file import ObjectFile

    torch.set_num_threads(1)
    with threadpool_limits(1):
        file = ObjectFile.load(path)
        body = rigid_body(file, cached_hulls(file, folder.hulls, hulls))
        truth = None if surface is None else read_surface(surface)
        start = time.perf_counter()
        collect_grasps(file, body, wanted, seed, folder.grasps(file.key), truth)
        took = time.perf_counter() - start
    _say(f"{file.key}: {wanted.grasps} grasps in {took:.0f} s, {wanted.grasps / took:.1f} per second")


def _observe_one(path: Path, count: int, resolution: int, seed: int, folder: Path) -> None:
    import torch

    from objectfolder.benchmarks.datasets.sampling import sample_observations
    from objectfolder.objectfile.file import ObjectFile

    torch.set_num_threads(1)
    sample_observations(ObjectFile.load(path), count, resolution, seed, folder)
