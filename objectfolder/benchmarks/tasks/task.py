"""What a benchmark task declares, once: ``TASK`` in the module of its name in ``benchmarks/tasks``.

Its stage, its command, its section and its table follow from that. Declarations are read without torch.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, cast

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.models.settings import EncodeConfig
from objectfolder.benchmarks.reporting.published import Published, beside, tested_objects
from objectfolder.benchmarks.reporting.tables import Table, describe_uncertain
from objectfolder.workspace.params import PARAMS_FILE, read, settings, shared

if TYPE_CHECKING:
    import numpy as np

Config = TypeVar("Config")
Scores = dict[str, Any]  #: contents of a result file


@dataclass(frozen=True)
class TaskParams(Generic[Config]):
    """Parameters of a task."""

    settings: Config  #: the task's section
    encode: EncodeConfig | None  #: None if the task has no encoders
    seed: int

    def one_seed(self) -> "TaskParams[Config]":
        """Return them for one training: what each of the seeds depends on."""
        return replace(self, settings=replace(cast(Any, self.settings), seeds=1))


@dataclass(frozen=True)
class Objects:
    """Objects of a split, known before they are sampled."""

    keys: Sequence[str]  #: in label order
    labels: "np.ndarray"  #: (rows,) int64, the object of each row
    materials: Sequence[str] = ()  #: of the objects, as far as a task asks for them


def accept(*given: Any) -> None:
    """Check nothing."""


@dataclass(frozen=True)
class Variant:
    """Another task of the same command, chosen by an option."""

    option: str
    values: tuple[str, str] | tuple[bool, bool]  #: the task's own, which is the default, and the other's
    task: "Task"
    help: str


@dataclass(frozen=True, kw_only=True)
class Task:
    """A benchmark task."""

    name: str  #: of its stage, command and list in ``benchmarks``, and prefix of its result files
    help: str  #: of its command, Markdown
    settings: type[Any]  #: dataclass of its section in ``params.yaml``
    #: ``MODULE:FUNCTION`` that trains and scores. It takes an `objectfolder.benchmarks.tasks.job.Job` or, of
    #: single objects, an `objectfolder.benchmarks.tasks.job.ObjectJob`, and returns the scores, with the
    #: ``seconds`` taken, and rows of training curves.
    training: str
    columns: tuple[str, ...]  #: of the training curves
    table: Callable[..., Table]  #: of a split and its scores or, of single objects, of scores by key
    published: tuple[Published, ...] = ()  #: figures to put beside them
    page: str  #: that describes it: heading of docs/protocols.md
    splits: tuple[str, ...] = ()  #: empty for a task on single objects
    samples: Literal["observations", "close_ups", "grasps"] | None = None  #: None: it asks the Object File
    robot: bool = False  #: whether the object is simulated, and so needs convex hulls
    encodes: tuple[str, ...] = ()  #: modalities that it makes encoders for
    trains_nets: bool = True  #: on a device; policies of robots are trained on the CPU
    single_threaded: bool = False  #: so that several objects are best run side by side
    #: Raises ObjectFolderError if the task cannot run: of a `Split` and its `Objects` or, for single objects,
    #: of nothing.
    check: Callable[..., Any] = accept
    variant: Variant | None = None
    former: tuple[str, ...] = field(default=())  #: earlier names of its command, which still work

    def load(self) -> Callable[[Any], tuple[Scores, list[list[Any]]]]:
        """Import the function that trains and scores, and all that it needs."""
        module, _, name = self.training.partition(":")
        return cast(Any, getattr(import_module(module), name))

    def params(
        self, values: Mapping[str, Any] | None = None, path: str | Path = PARAMS_FILE
    ) -> TaskParams[Any]:
        """Return the task's parameters.

        They are of ``values``, the contents of ``params.yaml`` perhaps with a preset merged into it, or read
        from ``path``, which errors name. Raises ObjectFolderError if a section is missing or wrong.
        """
        values = read(path) if values is None else dict(values)
        encode = settings(EncodeConfig, values, path) if self.trains_nets else None
        return TaskParams(settings(self.settings, values, path), encode, shared(values, path).seed)

    def tables(self, scores: Mapping[str, Scores], published: bool = True) -> list[Table]:
        """Lay out scores by split, a table each, or by object, all in one; with ``published`` figures.

        Raises ObjectFolderError if an earlier version wrote them.
        """
        add = self.with_published if published and self.published else lambda table, *_: table
        try:
            if not self.splits:
                return [add(self.table(scores), None, {})]
            return [
                add(_with_left_out(self.table(split, found), found), split, found)
                for split, found in scores.items()
            ]
        except KeyError as error:
            raise ObjectFolderError(
                f"{self.name}, {', '.join(scores)}: it lacks {error}, so it is of an earlier version; "
                "run it again"
            ) from error

    def with_published(self, table: Table, split: str | None, scores: Mapping[str, Any]) -> Table:
        """Put published figures beside a table, given the ``objects`` and ``rows`` of its scores."""
        for published in self.published:
            if published.split == split:
                table = beside(table, published, tested_objects(split, scores) if split else None)
        return table


def _with_left_out(table: Table, scores: Scores) -> Table:
    """Name the objects that were left out below a table."""
    left_out = scores.get("uncertain")
    return replace(table, note=f"{table.note} Objects {describe_uncertain(left_out)}.") if left_out else table


def find_task(name: str) -> Task:
    """Return the task of a name in `objectfolder.workspace.stages.BENCHMARKS`."""
    task: Task = import_module(f"objectfolder.benchmarks.tasks.{name}").TASK
    return task
