"""The command ``objectfolder bench reach``."""

import os
import time
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated

import typer

from objectfolder.cli.bench import (
    FilesArgument,
    OutOption,
    PresetOption,
    SeedsOption,
    _in_processes,
    _object_files,
    _print,
    _say,
)
from objectfolder.cli.console import console

if TYPE_CHECKING:
    from objectfolder.benchmarks.layout import Benchmarks


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
    from objectfolder import params as objects
    from objectfolder.artifacts import read_json
    from objectfolder.benchmarks.layout import Benchmarks
    from objectfolder.benchmarks.params import reach_params
    from objectfolder.benchmarks.tables import reach_table
    from objectfolder.catalog import read_preset

    values, path = objects.read(), Path(objects.PARAMS_FILE)
    if preset is not None:
        sections, path = read_preset(preset)
        values |= sections
    if seeds is not None:
        values["reach"] = {**(values.get("reach") or {}), "seeds": seeds}
    task = "reach_metaworld" if metaworld else "reach"
    params = reach_params(values, path)
    folder = Benchmarks(out if out is not None else Path("benchmarks") / (preset or "own"))
    paths = _object_files(files)
    calls = [(task, file, params, folder) for file in paths.values()]
    jobs = jobs or os.cpu_count() or 1
    if min(jobs, len(calls)) > 1:
        for _ in _in_processes(_reach_one, calls, jobs):
            pass
    else:
        for call in calls:
            _reach_one(*call)
    _print(reach_table({key: read_json(folder.result(task, key)) for key in paths}))
    for key in paths:
        result, curve = folder.result(task, key), folder.curve(task, key)
        console.print(f"{result}  curves: {curve}", soft_wrap=True)


def _reach_one(task: str, path: Path, params: SimpleNamespace, folder: "Benchmarks") -> None:
    """Run the task with one object, and write what it took beside the results."""
    import torch
    from threadpoolctl import threadpool_limits

    from objectfolder.artifacts import write_json
    from objectfolder.benchmarks.reach import run_reach
    from objectfolder.benchmarks.running import machine
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.objectfile import ObjectFile

    torch.set_num_threads(1)
    before = time.process_time()
    with threadpool_limits(1):
        file = ObjectFile.load(path)
        seconds = run_reach(path, cached_hulls(file, folder.hulls), params, folder, _say, task)
    took = {"seconds": seconds, "cpu_seconds": time.process_time() - before, "threads": 1}
    write_json(folder.machine(task, file.key), took | {"machine": machine("cpu")})
