"""Parameters of the benchmark tasks, from ``params.yaml``."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from objectfolder.benchmarks.models.settings import EncodeConfig
from objectfolder.workspace.params import PARAMS_FILE, read, settings, shared

Config = TypeVar("Config")


@dataclass(frozen=True)
class TaskParams(Generic[Config]):
    """Parameters of a task over the observations or grasps of many objects."""

    settings: Config  #: the task's section
    encode: EncodeConfig
    seed: int

    def one_seed(self) -> "TaskParams[Config]":
        """Return them for one training: what each of the seeds depends on."""
        return replace(self, settings=replace(cast(Any, self.settings), seeds=1))


@dataclass(frozen=True)
class RobotParams(Generic[Config]):
    """Parameters of a task of a robot with one object."""

    settings: Config  #: the task's section
    seed: int

    def one_seed(self) -> "RobotParams[Config]":
        """Return them for one training: what each of the seeds depends on."""
        return replace(self, settings=replace(cast(Any, self.settings), seeds=1))


def splits_of(task: str) -> tuple[str, ...]:
    """Return the splits of a task; a class absent from training cannot be recognized."""
    return ("seen",) if task == "recognize" else ("seen", "unseen")


def task_params(
    config: type[Config], values: dict[str, Any] | None = None, path: str | Path = PARAMS_FILE
) -> TaskParams[Config]:
    """Return the parameters of a task.

    Parameters
    ----------
    config : type
        Dataclass of the task's section.
    values : dict, optional
        Contents of ``params.yaml``, perhaps with a preset merged into it. Default: read from ``path``.
    path : path
        Named in errors.

    Raises
    ------
    ObjectFolderError
        If a section is missing or wrong.
    """
    values = read(path) if values is None else values
    return TaskParams(
        settings(config, values, path), settings(EncodeConfig, values, path), shared(values, path).seed
    )


def robot_params(
    config: type[Config], values: dict[str, Any] | None = None, path: str | Path = PARAMS_FILE
) -> RobotParams[Config]:
    """Return the parameters of a robot's task; otherwise as `task_params`."""
    values = read(path) if values is None else values
    return RobotParams(settings(config, values, path), shared(values, path).seed)


def object_keys(task: str, path: str | Path = PARAMS_FILE) -> tuple[str, ...]:
    """Return the objects that a task's stage reads."""
    values = read(path)
    return tuple(values["benchmarks"]["grasp_data"] if task == "grasp_stability" else values["objects"])
