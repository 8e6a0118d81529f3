"""Robot commands of ``objectfolder bench``: stability, grasping, reach."""

from typing import Annotated

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
    print_scores,
    run_on_splits,
)
from objectfolder.cli.console import print_line


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
    """Predict whether a grasp will hold, from a view of it, the touches of both fingers, or both.

    Grasps are simulated first and kept in OUT/grasps. If surface.ply lies beside the Object Files, as after a
    build, the same touches are also simulated on it for comparison (implicit against explicit).

    `objectfolder bench stability --preset quick`
    """
    from objectfolder.benchmarks.run import BenchmarkOptions
    from objectfolder.benchmarks.tasks.grasp_stability import GRASP_STABILITY

    options = BenchmarkOptions(
        files=files,
        preset=preset,
        out=out,
        splits=split,
        seeds=seeds,
        encoder=encoder,
        weights=weights,
        threads=threads,
        device=device,
    )
    run_on_splits(GRASP_STABILITY, options)


def grasping(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    seeds: SeedsOption = None,
    threads: Annotated[
        int | None,
        typer.Option(min=1, help="Simulation threads; default: all cores. Results do not depend on it."),
    ] = None,
) -> None:
    """Learn to grasp an object by touch: TRPO in ObjectFolder/Grasp-v0.

    Success rates over new rollouts of policies that observe touch, only the jaw opening, or neither; next to
    random actions and no action. Training curves, a policy and an animation are written to OUT.

    `objectfolder bench grasping --preset quick build/tonic_bottle`
    """
    from objectfolder.benchmarks.reporting.tables import grasping_table
    from objectfolder.benchmarks.run import BenchmarkOptions, run_on_objects
    from objectfolder.benchmarks.tasks.grasp_policy import GRASP_POLICY

    options = BenchmarkOptions(files=files, preset=preset, out=out, seeds=seeds, threads=threads)
    scores = run_on_objects(GRASP_POLICY, options, print_line)
    print_scores(grasping_table(scores))
    folder = options.folder
    for key in scores:
        result, curve, film = (
            path(GRASP_POLICY.name, key) for path in (folder.result, folder.curve, folder.film)
        )
        print_line(f"{result}  curves: {curve}" + (f"  film: {film}" if film.is_file() else ""))


def reach(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    seeds: SeedsOption = None,
    metaworld: Annotated[
        bool, typer.Option("--metaworld", help="Use the Sawyer arm of Meta-World, which must be installed.")
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Objects in parallel, one thread each; default: the number of cores."),
    ] = None,
) -> None:
    """Move a gripper to a goal past an object: the reach task of Meta-World, with PPO.

    Success rates at the last step and at any time, on goals not used in training; next to a controller,
    random actions and no action. Training curves, policies and animations are written to OUT.

    `objectfolder bench reach --preset quick build/mug build/bell`
    """
    from objectfolder.benchmarks.reporting.tables import reach_table
    from objectfolder.benchmarks.run import BenchmarkOptions, run_on_objects
    from objectfolder.benchmarks.tasks.reach import METAWORLD_REACH, REACH, environment_class
    from objectfolder.engine.resources import cores

    task = METAWORLD_REACH if metaworld else REACH
    environment_class(task.name)  # fails before any work if Meta-World is not installed
    options = BenchmarkOptions(files=files, preset=preset, out=out, seeds=seeds, threads=1)
    scores = run_on_objects(task, options, print_line, jobs or cores())
    print_scores(reach_table(scores))
    for key in scores:
        print_line(f"{options.folder.result(task.name, key)}  curves: {options.folder.curve(task.name, key)}")
