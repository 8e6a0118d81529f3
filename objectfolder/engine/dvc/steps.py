"""What ``dvc repro`` does with one stage, taken apart so that the command can run elsewhere.

The order is DVC's (``Stage.reproduce``, ``Stage.run``, ``run_stage``) and matters: dependencies must not be
saved before `restore`, or the run cache would take the old outputs for those of the new dependencies.
"""

from pathlib import Path

from dvc.stage import Stage
from dvc.stage.cache import RunCacheNotFoundError
from dvc.stage.run import prepare_kwargs

from objectfolder.engine.process import Command, environment
from objectfolder.engine.resources import Needs


def has_command(stage: Stage) -> bool:
    """Whether the stage runs a command; if not, it is data (``dvc add``), an import, or frozen."""
    return bool(stage.cmd) and not stage.frozen


def restore(stage: Stage) -> bool:
    """Remove the old outputs and bring the right ones back from the run cache, if it has them."""
    stage.remove_outs(ignore_remove=False, force=False)
    try:
        stage.repo.stage_cache.restore(stage)
    except RunCacheNotFoundError:
        return False
    save(stage)
    return True


def prepare(stage: Stage, log: Path, needs: Needs) -> Command:
    """Get a stage ready to run: old outputs removed, dependencies hashed."""
    stage.remove_outs(ignore_remove=False, force=False)
    stage.save_deps()
    base = prepare_kwargs(stage)
    lines = stage.cmd if isinstance(stage.cmd, list) else stage.cmd.splitlines()
    return Command(
        lines=lines,
        cwd=Path(stage.wdir),
        env=environment(base["env"], needs.cpus),
        log=log,
        timeout=needs.timeout,
    )


def save(stage: Stage) -> None:
    """Hash what a command has written and put it into DVC's cache and run cache."""
    plain = (out for out in stage.outs if not (out.is_metric or out.is_plot))
    run_cache = all(out.use_cache for out in plain)
    # Unlike DVC, not the dependencies: what changed while the command ran must count as changed.
    stage.save_outs()
    stage.md5 = stage.compute_md5()
    if run_cache:
        stage.repo.stage_cache.save(stage)
    stage.commit()
