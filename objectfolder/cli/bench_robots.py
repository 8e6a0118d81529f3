"""What ``objectfolder bench`` does with a robot: stability, grasping, reach."""

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from objectfolder.cli.bench import (
    DeviceOption,
    EncoderOption,
    FilesArgument,
    OutOption,
    PresetOption,
    SeedsOption,
    SplitOption,
    ThreadsOption,
    WeightsOption,
    _object_files,
    _print,
    _run,
    _say,
)
from objectfolder.cli.console import console
from objectfolder.errors import ObjectFolderError

if TYPE_CHECKING:
    from objectfolder.benchmarks.layout import Benchmarks
    from objectfolder.benchmarks.params import RobotParams


def stability(
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
    """Will the object be held, from a view of the grasp, what both fingers feel, or both?

    Grasps are simulated first and kept in OUT/grasps. Where surface.ply lies beside the Object Files, as a
    build leaves it, the same touches are simulated from it and compared (implicit against explicit).

    `objectfolder bench stability --preset quick`
    """
    _run("grasp_stability", files, preset, out, split, seeds, encoder, weights, threads, device)


def grasping(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    seeds: SeedsOption = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Of the simulation; default: all cores. Figures stay the same.")
    ] = None,
) -> None:
    """Learn to grasp an object by touch: TRPO in ObjectFolder/Grasp-v0.

    Success over fresh rollouts of policies that feel, that know the opening of the jaws alone, and that are
    blind; beside random actions and doing nothing. Curves, a policy and a film stay in OUT.

    `objectfolder bench grasping --preset quick build/tonic_bottle`
    """
    from objectfolder.benchmarks.reporting.tables import grasping_table
    from objectfolder.io import read_json

    params, hulls, folder = _asked("grasp_policy", preset, out, seeds)
    paths = _object_files(files)
    for file in paths.values():
        _grasping_one(file, hulls, params, folder, threads or os.cpu_count() or 1)
    _print(grasping_table({key: read_json(folder.result("grasp_policy", key)) for key in paths}))
    for key in paths:
        result, curve, film = (
            place("grasp_policy", key) for place in (folder.result, folder.curve, folder.film)
        )
        console.print(f"{result}  curves: {curve}  film: {film}", soft_wrap=True)


def reach(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    seeds: SeedsOption = None,
    metaworld: Annotated[
        bool, typer.Option("--metaworld", help="The Sawyer arm of Meta-World, where that is installed.")
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1, help="Objects side by side, each on one thread; default: as many as there are cores."
        ),
    ] = None,
) -> None:
    """Move a gripper to a goal, with an object in between: Meta-World's reach, and PPO.

    Success at the last step and at any time, on goals that no training met; beside a controller, random
    actions, and doing nothing. Curves, policies and films stay in OUT.

    `objectfolder bench reach --preset quick build/mug build/bowl build/die`
    """
    from objectfolder.benchmarks.reporting.tables import reach_table
    from objectfolder.engine.pool import in_processes
    from objectfolder.io import read_json

    task = "metaworld_reach" if metaworld else "reach"
    params, hulls, folder = _asked("reach", preset, out, seeds)
    paths = _object_files(files)
    calls = [(task, file, hulls, params, folder) for file in paths.values()]
    jobs = jobs or os.cpu_count() or 1
    if min(jobs, len(calls)) > 1:
        for _ in in_processes(_reach_one, calls, jobs):
            pass
    else:
        for call in calls:
            _reach_one(*call)
    _print(reach_table({key: read_json(folder.result(task, key)) for key in paths}))
    for key in paths:
        result, curve = folder.result(task, key), folder.curve(task, key)
        console.print(f"{result}  curves: {curve}", soft_wrap=True)


def _asked(
    stage: str, preset: str | None, out: Path | None, seeds: int | None
) -> tuple["RobotParams[Any]", int, "Benchmarks"]:
    """Parameters of a robot's task, the greatest number of hulls, and where results go."""
    from objectfolder.benchmarks.layout import Benchmarks
    from objectfolder.benchmarks.params import robot_params
    from objectfolder.workspace import params as objects
    from objectfolder.workspace.presets import read_preset

    values, path = objects.read(), Path(objects.PARAMS_FILE)
    if preset is not None:
        sections, path = read_preset(preset)
        values |= sections
    if seeds is not None:
        values[stage] = {**(values.get(stage) or {}), "seeds": seeds}
    hulls = objects.settings(objects.section_config("decompose"), values, path).hulls
    folder = Benchmarks(out if out is not None else Path("benchmarks") / (preset or "own"))
    return robot_params(objects.section_config(stage), values, path), hulls, folder


def _grasping_one(
    path: Path, hulls: int, params: "RobotParams[Any]", folder: "Benchmarks", threads: int
) -> None:
    """Run the task with one object, and write what it took beside the results."""
    import torch
    from threadpoolctl import threadpool_limits

    from objectfolder.benchmarks.tasks.grasp_policy import run_grasp_policy
    from objectfolder.benchmarks.tasks.running import machine
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.io import write_json
    from objectfolder.objectfile.file import ObjectFile

    torch.set_num_threads(1)
    before = time.process_time()
    with threadpool_limits(1):
        file = ObjectFile.load(path)
        try:
            parts = cached_hulls(file, folder.hulls, hulls)
            seconds = run_grasp_policy(path, parts, params, folder, _say, threads)
        except ObjectFolderError as error:
            raise ObjectFolderError(f"{path}: {error}") from error
    took: dict[str, Any] = {"seconds": seconds, "cpu_seconds": time.process_time() - before}
    write_json(
        folder.machine("grasp_policy", file.key), took | {"threads": threads, "machine": machine("cpu")}
    )


def _reach_one(task: str, path: Path, hulls: int, params: "RobotParams[Any]", folder: "Benchmarks") -> None:
    """Run the task with one object, and write what it took beside the results."""
    import torch
    from threadpoolctl import threadpool_limits

    from objectfolder.benchmarks.tasks.reach import run_reach
    from objectfolder.benchmarks.tasks.running import machine
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.io import write_json
    from objectfolder.objectfile.file import ObjectFile

    torch.set_num_threads(1)
    before = time.process_time()
    with threadpool_limits(1):
        file = ObjectFile.load(path)
        seconds = run_reach(path, cached_hulls(file, folder.hulls, hulls), params, folder, _say, task)
    took = {"seconds": seconds, "cpu_seconds": time.process_time() - before, "threads": 1}
    write_json(folder.machine(task, file.key), took | {"machine": machine("cpu")})
