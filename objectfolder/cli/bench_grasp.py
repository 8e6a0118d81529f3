"""The commands ``objectfolder bench stability`` and ``objectfolder bench grasping``."""

import os
import time
from pathlib import Path
from types import SimpleNamespace
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
    from objectfolder import params as objects
    from objectfolder.artifacts import read_json
    from objectfolder.benchmarks.layout import Benchmarks
    from objectfolder.benchmarks.params import robot_params
    from objectfolder.benchmarks.tables import grasping_table
    from objectfolder.catalog import read_preset

    values, path = objects.read(), Path(objects.PARAMS_FILE)
    if preset is not None:
        sections, path = read_preset(preset)
        values |= sections
    if seeds is not None:
        values["grasp_policy"] = {**(values.get("grasp_policy") or {}), "seeds": seeds}
    params = robot_params("grasp_policy", values, path)
    hulls = robot_params("decompose", values, path).section.hulls
    folder = Benchmarks(out if out is not None else Path("benchmarks") / (preset or "own"))
    paths = _object_files(files)
    for file in paths.values():
        _grasping_one(file, hulls, params, folder, threads or os.cpu_count() or 1)
    _print(grasping_table({key: read_json(folder.result("grasp_policy", key)) for key in paths}))
    for key in paths:
        result, curve, film = (
            place("grasp_policy", key) for place in (folder.result, folder.curve, folder.film)
        )
        console.print(f"{result}  curves: {curve}  film: {film}", soft_wrap=True)


def _grasping_one(
    path: Path, hulls: int, params: SimpleNamespace, folder: "Benchmarks", threads: int
) -> None:
    """Run the task with one object, and write what it took beside the results."""
    import torch
    from threadpoolctl import threadpool_limits

    from objectfolder.artifacts import write_json
    from objectfolder.benchmarks.grasp_policy import run_grasp_policy
    from objectfolder.benchmarks.running import machine
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.objectfile import ObjectFile

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
