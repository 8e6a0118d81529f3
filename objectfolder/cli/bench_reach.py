"""The command ``objectfolder bench reach``."""

import os
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

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
from objectfolder.errors import ObjectFolderError


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
    asked: dict[str, Any] = {} if seeds is None else {"seeds": seeds}
    if metaworld:
        asked["simulator"] = "metaworld"
    values["reach"] = {**(values.get("reach") or {}), **asked}
    params = reach_params(values, path)
    folder = Benchmarks(out if out is not None else Path("benchmarks") / (preset or "own"))
    paths = _object_files(files)
    calls = [(file, params, folder) for file in paths.values()]
    jobs = jobs or os.cpu_count() or 1
    if min(jobs, len(calls)) > 1:
        for _ in _in_processes(_reach_one, calls, jobs):
            pass
    else:
        for call in calls:
            _reach_one(*call)
    _print(reach_table({key: read_json(folder.result("reach", key)) for key in paths}))
    for key in paths:
        result, curve, film = (path("reach", key) for path in (folder.result, folder.curve, folder.film))
        console.print(f"{result}  curves: {curve}  film: {film}", soft_wrap=True)


def _reach_one(path: Path, params: SimpleNamespace, folder: Any) -> None:
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
        try:
            seconds = run_reach(path, cached_hulls(file, folder.hulls), params, folder, _say)
        except ObjectFolderError as error:
            raise ObjectFolderError(f"{path}: {error}") from error
    took = {"seconds": seconds, "cpu_seconds": time.process_time() - before, "threads": 1}
    write_json(folder.machine("reach", file.key), took | {"machine": machine("cpu")})
