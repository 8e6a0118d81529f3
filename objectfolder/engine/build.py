"""Parallel build: one thread calls DVC, workers run the commands of stages."""

import bisect
import logging
import py_compile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.util import cache_from_source
from pathlib import Path
from queue import Empty, SimpleQueue

from objectfolder.base import disk
from objectfolder.base.errors import ObjectFolderError
from objectfolder.engine.dvc import remote, steps
from objectfolder.engine.dvc.graph import StageGraph, stage_graph
from objectfolder.engine.dvc.inputs import Stamps, hold_params
from objectfolder.engine.dvc.recorded import other_files
from objectfolder.engine.dvc.repository import (
    OpenRepository,
    open_repository,
    read_params,
    remove_partial_outputs,
)
from objectfolder.engine.journal import JOURNAL, Journal
from objectfolder.engine.process import (
    Command,
    CommandResult,
    await_end,
    describe_result,
    stage_environment,
    tail,
)
from objectfolder.engine.records import (
    LOGS,
    forget_cost,
    forget_failure,
    log_path,
    record_cost,
    record_failure,
)
from objectfolder.engine.resources import Machine, Needs, cores, needs_of
from objectfolder.engine.schedule import Schedule, object_groups
from objectfolder.engine.signals import StopSignals
from objectfolder.engine.summary import (
    Disturbed,
    Event,
    Finished,
    Listener,
    Lost,
    Planned,
    StageOutcome,
    StageResult,
    Started,
    Stopping,
    Summary,
)
from objectfolder.engine.unchanged import remember
from objectfolder.engine.workers import FinishedQueue, LocalWorkers, WorkerLost, Workers
from objectfolder.workspace.code_digests import PACKAGES
from objectfolder.workspace.installed import check_installed
from objectfolder.workspace.template import note_foreign_code

#: Objects in progress at a time, per core.
OBJECTS_PER_CORE = 2
#: Restarts of a stage whose worker was lost, or whose inputs changed while it ran.
RESTARTS = 3
MAX_TIMEOUT = 1e8  #: time limit of a stage, s
_log = logging.getLogger(__name__)
#: Creates the workers of a build from the number of jobs and the queue for their results.
MakeWorkers = Callable[[int | None, FinishedQueue], Workers]
#: Offset in a ``.pyc`` file of the flags; 0: compared by time and size of the source.
FLAGS = slice(4, 8)


@dataclass(frozen=True)
class BuildOptions:
    """Options of a build."""

    jobs: int | None = None  #: cores that stages may use together; default: all of this process
    force: bool = False  #: run every stage, even if it is up to date
    #: After a failure, continue with stages that do not depend on it; otherwise start no more stages.
    keep_going: bool = True
    #: Wall seconds after which a stage is killed; default: see `objectfolder.engine.resources.NEEDS`; 0:
    #: never.
    timeout: float | None = None
    pull: bool = False  #: first download recorded outputs and saved runs from DVC's default remote
    wait: bool = False  #: if another process uses the workspace, wait until it ends; otherwise refuse
    #: If nothing is to do, note it for `objectfolder.engine.unchanged.recall`, unless anything has changed
    #: since this time, ns since 1970.
    remember: int | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise ObjectFolderError(
                f"jobs is {self.jobs}, expected at least 1; use --jobs 1 to run one stage at a time"
            )
        if self.timeout is not None and not 0 <= self.timeout <= MAX_TIMEOUT:
            raise ObjectFolderError(f"timeout is {self.timeout} s, expected 0 (never) to {MAX_TIMEOUT:g}")


def local_workers(jobs: int | None, finished: FinishedQueue) -> Workers:
    """Return workers on this machine."""
    return LocalWorkers(Machine(jobs or cores()), finished)


def build(
    targets: Sequence[str] = (),
    options: BuildOptions = BuildOptions(),
    root: str | Path = ".",
    on_event: Listener = lambda event: None,
    make_workers: MakeWorkers = local_workers,
) -> Summary:
    """Bring targets and everything upstream of them up to date.

    A failed stage blocks its downstream stages; the others continue. On SIGINT or SIGTERM the running
    commands are killed and finished stages are kept.

    Parameters
    ----------
    targets : sequence of str
        Stage addresses, stage names, object keys or paths of outputs; default: everything.
    options : BuildOptions
    root : Path
        Workspace, the directory that holds ``dvc.yaml``.
    on_event : callable
        Called in this thread with every event.
    make_workers : callable
        Creates the workers that run the commands; default: on this machine.

    Raises
    ------
    ObjectFolderError
        If the workspace is busy or cannot be read, or is of another version of the package. Failed stages are
        reported in the summary.
    """
    start = time.monotonic()
    with (
        open_repository(root, options.wait) as repository,
        Journal(repository.own_files / JOURNAL.name) as journal,
    ):

        def tell(event: Event) -> None:
            journal.add(event)
            on_event(event)

        check_installed(repository.root)
        repository.remove_partial_files()
        for half in (repository.root / LOGS).glob("*.tmp*"):
            half.unlink(missing_ok=True)  # left by a killed engine
        graph = stage_graph(repository, targets)
        remove_partial_outputs(graph.stages.values())
        graphs = {Path(stage.path) for stage in graph.stages.values() if stage.cmd}
        note_foreign_code(repository.root, graphs, repository.own_files)
        held = hold_params(graph.stages.values(), repository.root, repository.own_files)
        reached = options.pull and remote.pull_build(repository.repo, graph.stages.values())
        repository.use_run_cache(pull=reached)
        params = read_params(repository.root)
        needs = {address: needs_of(address, params) for address in graph.stages}
        if options.timeout is not None:
            limit = options.timeout or None
            needs = {address: replace(need, timeout=limit) for address, need in needs.items()}
        tell(Planned({address: need.seconds for address, need in needs.items()}))
        results = _Build(repository, graph, held, needs, options, tell, make_workers).run()
        if options.remember and all(result.status is StageOutcome.SKIPPED for result in results.values()):
            others = other_files(repository, graph.stages.values())
            if others is not None:
                remember(targets, repository.root, graph.stages, others, options.remember)
    ordered = {address: results[address] for address in graph.stages}
    return Summary(stages=ordered, seconds=time.monotonic() - start)


class _Build:
    """State of one build. DVC is called from one thread only; workers run the commands."""

    def __init__(
        self,
        repository: OpenRepository,
        graph: StageGraph,
        held: Mapping[str, str],
        needs: dict[str, Needs],
        options: BuildOptions,
        on_event: Listener,
        make_workers: MakeWorkers,
    ):
        self.repository = repository
        self.stages = graph.stages
        self.held = held
        self.needs = needs
        self.options = options
        self.logs = repository.root / LOGS
        self.on_event = on_event
        self.results: dict[str, StageResult] = {}
        # Changed stages that wait for a free worker, most urgent first.
        self.due: list[tuple[tuple[int, float, int], str]] = []
        # Running stages, with the files that they read.
        self.running: dict[str, Stamps] = {}
        self.restarts: Counter[str] = Counter()
        self.lockfiles = repository.lockfiles
        self.finished: FinishedQueue = SimpleQueue()
        self.workers = make_workers(options.jobs, self.finished)
        self.schedule = Schedule(
            graph.upstream,
            weight=lambda address: needs[address].seconds,
            group=object_groups(graph.stages, OBJECTS_PER_CORE * self.workers.cores),
        )
        self.signals = StopSignals(lambda: self.finished.put(None), lambda: on_event(Stopping()))
        self.checked = False
        self.compared = False
        self.stopping = False
        self.unwritable = False

    def run(self) -> dict[str, StageResult]:
        """Run all stages and return their results by address."""
        with self.signals.catch():
            try:
                self._loop()
            finally:
                self.stopping = True
                self.workers.kill()
                with suppress(ObjectFolderError):  # it is tried again, and then said
                    self._flush()  # now: Ray ends this process while it leaves a cluster without a head
                try:
                    self.workers.close()
                    self._collect_finished()  # keep what ended before the kill
                finally:
                    self._flush()
        return self.results

    def _loop(self) -> None:
        while True:
            self.signals.raise_if_caught()  # DVC's files are consistent here
            if (address := self._pop_due()) is not None:
                self._start(address)
            elif (address := self.schedule.pop()) is not None:
                if address not in self.results:  # not blocked by --fail-fast
                    self._examine(address)
            elif self.running:
                self._collect(timeout=None if self.unwritable else self.lockfiles.seconds_until_due())
            else:
                return
            self._collect_finished()
            self._flush_if_due()

    def _pop_due(self) -> str | None:
        """Take the most urgent stage that fits the free resources.

        Stages may overtake one that waits for a GPU, but not one that waits for cores or memory: small
        stages would delay a large one until the end.
        """
        for place, (_, address) in enumerate(self.due):
            lacking = self.workers.room(self.needs[address])
            if not lacking:
                del self.due[place]
                return address
            if lacking != "gpu":
                return None
        return None

    def _examine(self, address: str) -> None:
        """Check whether a ready stage must run; needs no free worker."""
        stage = self.stages[address]
        try:
            if not steps.has_command(stage):
                self._pass_through(address)
            elif self.options.force or steps.has_changed(stage):
                bisect.insort(self.due, (self.schedule.rank[address], address))
            else:
                self._succeed(StageResult(address, StageOutcome.SKIPPED))
        except (ObjectFolderError, OSError) as error:
            self._fail(StageResult(address, StageOutcome.FAILED, error=self._explain(error, address)))

    def _pass_through(self, address: str) -> None:
        """Let DVC handle a stage without a command."""
        start = time.monotonic()
        stage = self.stages[address]
        if not steps.update_data(stage, self.options.force):
            self._succeed(StageResult(address, StageOutcome.SKIPPED))
            return
        self.lockfiles.add(stage)
        self._succeed(StageResult(address, StageOutcome.RAN, time.monotonic() - start))

    def _start(self, address: str) -> None:
        """Restore a changed stage from the run cache, or submit its command to a worker.

        Old outputs are removed only once a worker is free, so that an interrupted build has removed few.
        """
        start = time.monotonic()
        stage = self.stages[address]
        log = self._log(address)
        if not self.checked:  # not before: a build with nothing to do need not write
            self.repository.check_cache()
            self.checked = True
        try:
            await_end(log, self.signals.raise_if_caught)
            if not self.options.force and steps.restore_run(stage):
                self.lockfiles.add(stage)
                forget_cost(self.logs, address)
                self._succeed(StageResult(address, StageOutcome.RESTORED, time.monotonic() - start))
                return
            shell = steps.prepare_run(stage)
        except (ObjectFolderError, OSError) as error:
            self._fail(StageResult(address, StageOutcome.FAILED, error=self._explain(error, address)))
            return
        needs = self.needs[address]
        env = stage_environment({**shell.env, **self.held}, needs.cpus)
        self.running[address] = shell.inputs
        if not self.compared:  # not before: a build with nothing to do need not look
            compare_by_content(self.repository.root)
            self.compared = True
        self.workers.submit(address, Command(shell.lines, shell.cwd, env, log, needs.timeout), needs)
        self.on_event(Started(address, log))

    def _collect_finished(self) -> None:
        while not self.finished.empty():
            self._collect(timeout=0.0)

    def _collect(self, timeout: float | None) -> None:
        """Take one finished command from the workers and save its outputs."""
        try:
            item = self.finished.get(timeout=timeout)
        except Empty:
            return
        if item is None:
            return
        address, outcome = item
        inputs = self.running.pop(address)
        self.workers.finish(address)
        if self.stopping and not (isinstance(outcome, CommandResult) and outcome.code == 0):
            return  # killed by this build, not a failure of the stage
        if isinstance(outcome, WorkerLost):
            self._run_again(Lost(address, str(outcome)), f"lost with its worker: {outcome}")
            return
        if files := steps.changed_inputs(self.stages[address], inputs):
            names = ", ".join(files)
            self._run_again(
                Disturbed(address, files), f"{names} changed while it ran; stop what writes there"
            )
            return
        log = self._log(address)
        if isinstance(outcome, Exception):
            error = f"cannot run the command: {self._explain(outcome, address)}"
            self._fail(StageResult(address, StageOutcome.FAILED, error=error))
            return
        error = describe_result(outcome)
        if error:
            error += self._hint(address, log)
        else:
            try:
                stage = self.stages[address]
                steps.save_run(stage)
                self.lockfiles.add(stage)
                record_cost(self.logs, address, outcome)
            except (ObjectFolderError, OSError) as problem:
                error = self._explain(problem, address)
        result = StageResult(
            address=address,
            status=StageOutcome.FAILED if error else StageOutcome.RAN,
            seconds=outcome.seconds,
            peak_mb=outcome.peak_mb,
            log=log,
            error=error,
            tail=tail(log) if error else (),
        )
        if error:
            self._fail(result)
        else:
            self._succeed(result)

    def _run_again(self, event: Lost | Disturbed, reason: str) -> None:
        """Queue a stage again whose run does not count, up to `RESTARTS` times."""
        address = event.address
        if self.stopping:
            return
        self.restarts[address] += 1
        if self.restarts[address] > RESTARTS:
            error = f"none of its {self.restarts[address]} runs counts; of the last, {reason}"
            self._fail(StageResult(address, StageOutcome.FAILED, error=error))
            return
        bisect.insort(self.due, (self.schedule.rank[address], address))
        self.on_event(event)

    def _flush_if_due(self) -> None:
        """Write the lock file if due; if that fails, continue and try again at the end."""
        if self.unwritable:
            return
        try:
            self.lockfiles.flush_if_due()
        except (OSError, ObjectFolderError) as error:
            self.unwritable = True
            _log.warning("cannot write the lock file: %s; trying again at the end of the build", error)

    def _flush(self) -> None:
        try:
            self.lockfiles.flush()
        except (OSError, ObjectFolderError) as error:
            raise ObjectFolderError(
                f"cannot write dvc.lock: {self._explain(error)}; build again once it can be written; "
                "finished stages are in DVC's cache and will not run again"
            ) from error

    def _explain(self, error: BaseException, address: str | None = None) -> str:
        """Return the message of an error; name the disk if it is full, and free what DVC left there."""
        if isinstance(error, FileNotFoundError) and error.filename:
            return f"{error.filename} does not exist; put it there, or fetch it: `dvc pull`"
        if not disk.is_shortage(error):
            return str(error)
        text = f"{error}: {disk.describe_full(disk.find_fullest(self._disks(address))[0])}"
        self.repository.remove_partial_files()
        return text

    def _hint(self, address: str, log: Path) -> str:
        """Name the full disk if that may be why a command failed."""
        path, free = disk.find_fullest(self._disks(address))
        full = free < disk.FULL_BELOW or disk.mentions_shortage(tail(log))
        return f"; {disk.describe_full(path)}" if full else ""

    def _disks(self, address: str | None) -> list[Path]:
        outs = steps.output_paths(self.stages[address]) if address else []
        return [*outs, self.logs, self.repository.cache, self.repository.tmp]

    def _log(self, address: str) -> Path:
        return log_path(self.logs, address)

    def _succeed(self, result: StageResult) -> None:
        forget_failure(self.logs, result.address)
        self.schedule.finish(result.address)
        self._report(result)

    def _fail(self, result: StageResult) -> None:
        record_failure(self.logs, result, steps.input_state(self.stages[result.address]))
        self._report(result)
        for address in self.schedule.downstream(result.address):
            if address not in self.results:
                self._report(StageResult(address, StageOutcome.BLOCKED, error=f"needs {result.address}"))
        if not self.options.keep_going:
            self._give_up(result.address)

    def _give_up(self, cause: str) -> None:
        """Start no more stages; running ones may finish."""
        self.due.clear()
        while self.schedule.pop() is not None:
            pass
        for address in self.stages:
            if address not in self.results and address not in self.running:
                self._report(
                    StageResult(address, StageOutcome.BLOCKED, error=f"not started after {cause} failed")
                )

    def _report(self, result: StageResult) -> None:
        self.results[result.address] = result
        self.on_event(Finished(result))


def compare_by_content(root: Path) -> None:
    """Compile again what Python would compare with its source by size and time alone.

    The time counts whole seconds: after an edit that keeps the size, a stage could run the old code. Python
    keeps the kind of comparison when it compiles an edited module again.

    ``root``: directory that contains the packages of the project.
    """
    for source in (path for package in PACKAGES for path in (root / package).rglob("*.py")):
        compiled = cache_from_source(str(source))
        with suppress(OSError):  # never imported, or a read-only directory
            if not any(Path(compiled).read_bytes()[FLAGS]):
                mode = py_compile.PycInvalidationMode.CHECKED_HASH
                py_compile.compile(str(source), compiled, invalidation_mode=mode, quiet=2)
