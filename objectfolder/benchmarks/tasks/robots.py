"""Run a robot's task with one object."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from objectfolder.benchmarks.datasets.samples import object_digest
from objectfolder.benchmarks.params import RobotParams
from objectfolder.benchmarks.tasks.running import Report, Task
from objectfolder.envs.body import RigidBody, rigid_body
from objectfolder.envs.hulls import hulls_digest
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.code_digests import code_digest
from objectfolder.workspace.layout import Benchmarks

if TYPE_CHECKING:
    import trimesh

Config = TypeVar("Config")


@dataclass(frozen=True)
class RobotJob(Generic[Config]):
    """Train and score policies of a robot with one object; ``report`` gets a line about each part."""

    task: str  #: name of the task
    file: ObjectFile
    body: RigidBody  #: of the same object
    params: Config  #: the task's section of ``params.yaml``
    seed: int
    #: Folder of checkpoints and of files to keep. An interrupted call resumes from it, so it must be empty or
    #: of a call with the same arguments.
    progress: Path
    report: Callable[[str], None] = lambda line: None
    threads: int = 1  #: of the simulation; results do not depend on it


@dataclass(frozen=True)
class ObjectRun:
    """Run of a robot's task with one object; see `objectfolder.benchmarks.tasks.running.run_benchmark`."""

    task: Task
    file: ObjectFile
    hulls: "Sequence[trimesh.Trimesh]"
    params: RobotParams[Any]
    folder: Benchmarks
    threads: int = 1  #: of the simulation; results do not depend on it

    @property
    def part(self) -> str:
        """Object key, which names the result files."""
        return self.file.key

    def identity(self) -> tuple[Any, ...]:
        """Return everything that the result of each seed depends on."""
        params, hulls = self.params.one_seed(), hulls_digest(self.hulls)
        return object_digest(self.file), hulls, params, code_digest(self.task.run)

    def job(self, progress: Path, report: Report) -> RobotJob[Any]:
        """Return the argument of the task."""
        body = rigid_body(self.file, self.hulls)
        settings, seed = self.params.settings, self.params.seed
        return RobotJob(self.task.name, self.file, body, settings, seed, progress, report, self.threads)

    def description(self) -> dict[str, Any]:
        """Return entries to add to the scores."""
        return {}
