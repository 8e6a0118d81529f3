"""Build: one owner of DVC's lock, many commands at a time."""

import bisect
import logging
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue

from dvc.exceptions import DvcException
from dvc.repo import Repo

from objectfolder.engine import failures
from objectfolder.engine.dvc import full_disk as disk
from objectfolder.engine.dvc import remote, steps
from objectfolder.engine.dvc.graph import Plan, plan
from objectfolder.engine.dvc.lockfile import LockFiles
from objectfolder.engine.dvc.repository import held, read_params
from objectfolder.engine.dvc.runcache import RunCache, remove_damaged
from objectfolder.engine.failures import LOGS, log_path
from objectfolder.engine.process import Outcome, describe, tail
from objectfolder.engine.resources import Machine, Needs, cores, needs_of
from objectfolder.engine.schedule import Schedule, object_groups
from objectfolder.engine.summary import (
    Finished,
    Listener,
    Lost,
    Planned,
    StageResult,
    Started,
    Status,
    Summary,
)
from objectfolder.engine.workers import Finished as FinishedQueue
from objectfolder.engine.workers import LocalWorkers, WorkerLost, Workers
from objectfolder.errors import ObjectFolderError

OBJECTS_PER_CORE = 2  # that are worked on at a time
#: How often a stage is started again when it was lost with its worker.
RESTARTS = 3
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Options:
    """How to build.

    Parameters
    ----------
    jobs : int, optional
        Cores that stages may use together; default: all of this process.
    force : bool
        Run every stage again, changed or not.
    keep_going : bool
        After a failure, go on with what does not depend on it; else start nothing more.
    timeout : float, optional
        Wall seconds after which a stage is killed, in place of the table's; 0 never.
    pull : bool
        Before anything runs, fetch from DVC's default remote what the lock file and the run cache know.
    wait : bool
        If another process uses the workspace, wait until it ends; else refuse.
    """

    jobs: int | None = None
    force: bool = False
    keep_going: bool = True
    timeout: float | None = None
    pull: bool = False
    wait: bool = False

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise ObjectFolderError(
                f"jobs is {self.jobs}, expected at least 1; use --jobs 1 for one at a time"
            )
        if self.timeout is not None and not self.timeout >= 0:
            raise ObjectFolderError(f"timeout is {self.timeout} s, expected 0 (never) or more")


#: Makes the workers of a build from the number of jobs and the queue for what they finish.
MakeWorkers = Callable[[int | None, FinishedQueue], Workers]


def local_workers(jobs: int | None, finished: FinishedQueue) -> Workers:
    """Run stages on this machine."""
    return LocalWorkers(Machine(jobs or cores()), finished)


def build(
    targets: Sequence[str] = (),
    options: Options = Options(),
    root: str | Path = ".",
    on_event: Listener = lambda event: None,
    make_workers: MakeWorkers = local_workers,
) -> Summary:
    """Bring targets and everything upstream of them up to date.

    A stage that fails blocks what depends on it; the rest goes on. On SIGINT or SIGTERM the running commands
    are killed and what had finished is kept.

    Parameters
    ----------
    targets : sequence of str
        Stage addresses, stage names, object keys or paths of outputs; none means everything.
    options : Options
        How to build.
    root : Path
        Workspace, the directory that holds ``dvc.yaml``.
    on_event : callable
        Called in this thread with every `Planned`, `Started`, `Lost` and
        `summary.Finished`.
    make_workers : callable
        Makes what runs the commands; default: this machine.

    Raises
    ------
    ObjectFolderError
        If the workspace is busy or cannot be read. A failed stage does not raise.
    """
    start = time.monotonic()
    root = Path(root).resolve()
    with held(root, options.wait) as (repo, lockfiles):
        disk.sweep(repo)
        try:
            wanted = plan(repo, root, targets)
        except DvcException as error:
            raise ObjectFolderError(f"DVC cannot read the pipeline in {root}: {error}") from error
        reached = options.pull and remote.fetch(repo, wanted.stages.values())
        repo.stage_cache = RunCache(repo, pull=reached)
        params = read_params(root)
        needs = {address: needs_of(address, params) for address in wanted.stages}
        if options.timeout is not None:
            limit = options.timeout or None
            needs = {address: replace(need, timeout=limit) for address, need in needs.items()}
        on_event(Planned({address: need.seconds for address, need in needs.items()}))
        logs = root / LOGS
        results = _Build(repo, wanted, needs, options, lockfiles, logs, on_event, make_workers).run()
    ordered = {address: results[address] for address in wanted.stages}
    return Summary(stages=ordered, seconds=time.monotonic() - start)


class _Interrupted(Exception):
    """A signal asked the build to stop; it is raised at a point where DVC's files are whole."""

    def __init__(self, number: int):
        super().__init__(number)
        self.number = number


class _Build:
    """State of one build. All of DVC is called from one thread; the workers only run commands."""

    def __init__(
        self,
        repo: Repo,
        wanted: Plan,
        needs: dict[str, Needs],
        options: Options,
        lockfiles: LockFiles,
        logs: Path,
        on_event: Listener,
        make_workers: MakeWorkers,
    ):
        self.repo = repo
        self.stages = wanted.stages
        self.needs = needs
        self.options = options
        self.logs = logs
        self.on_event = on_event
        self.results: dict[str, StageResult] = {}
        # Stages known to have changed, waiting for a free worker; the most urgent first.
        self.due: list[tuple[tuple[int, float, int], str]] = []
        self.running: set[str] = set()
        self.losses: Counter[str] = Counter()
        self.lockfiles = lockfiles
        self.finished: FinishedQueue = SimpleQueue()
        self.workers = make_workers(options.jobs, self.finished)
        self.schedule = Schedule(
            wanted.upstream,
            weight=lambda address: needs[address].seconds,
            group=object_groups(wanted.stages, OBJECTS_PER_CORE * self.workers.cores),
        )
        self.signal: int | None = None
        self.stopping = False
        self.unwritable = False

    def run(self) -> dict[str, StageResult]:
        """Run until nothing is left, and return the results by address."""
        with self._signals():
            try:
                self._loop()
            finally:
                self.stopping = True
                self.workers.kill()
                try:
                    self.workers.close()
                    self._collect_finished()  # what ended on its own just before the kill is kept
                finally:
                    self._flush()
        return self.results

    def _loop(self) -> None:
        while True:
            if self.signal is not None:
                raise _Interrupted(self.signal)
            if (address := self._pop_due()) is not None:
                self._start(address)
            elif (address := self.schedule.pop()) is not None:
                if address not in self.results:  # what a build that gave up has written off
                    self._examine(address)
            elif self.running:
                self._collect(timeout=None if self.unwritable else self.lockfiles.seconds_until_due())
            else:
                return
            self._collect_finished()
            self._flush_if_due()

    def _pop_due(self) -> str | None:
        """Take the most urgent stage that there is room for.

        What waits for a GPU lets others pass; what waits for a core or memory does not, or small stages
        would keep a large one waiting until the end.
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
        """Decide what a ready stage needs; only checks, so that it can be done ahead of a free worker."""
        stage = self.stages[address]
        try:
            if not steps.has_command(stage):
                self._pass_through(address)
            elif self.options.force or stage.changed():
                bisect.insort(self.due, (self.schedule.rank[address], address))
            else:
                self._succeed(StageResult(address, Status.SKIPPED))
        except (DvcException, OSError) as error:
            self._fail(StageResult(address, Status.FAILED, error=self._explain(error, address)))

    def _pass_through(self, address: str) -> None:
        """Let DVC handle a stage without a command itself: it verifies data, or downloads an import."""
        start = time.monotonic()
        stage = self.stages[address]
        if any(not out.exists for out in stage.outs):
            remove_damaged(stage.outs)
            stage.checkout(allow_missing=True)  # deleted data comes back from the cache
        if stage.reproduce(force=self.options.force) is None:
            self._succeed(StageResult(address, Status.SKIPPED))
            return
        self.lockfiles.add(stage)
        self._succeed(StageResult(address, Status.RAN, time.monotonic() - start))

    def _start(self, address: str) -> None:
        """Restore a changed stage from the run cache, or hand its command to a worker.

        Old outputs go only now that a worker is free, so that an interrupted build has removed few.
        """
        start = time.monotonic()
        stage = self.stages[address]
        log = self._log(address)
        try:
            if not self.options.force and steps.restore(stage):
                self.lockfiles.add(stage)
                self._succeed(StageResult(address, Status.RESTORED, time.monotonic() - start))
                return
            command = steps.prepare(stage, log, self.needs[address])
        except (DvcException, OSError) as error:
            self._fail(StageResult(address, Status.FAILED, error=self._explain(error, address)))
            return
        self.running.add(address)
        self.workers.submit(address, command, self.needs[address])
        self.on_event(Started(address, log))

    def _collect_finished(self) -> None:
        while not self.finished.empty():
            self._collect(timeout=0.0)

    def _collect(self, timeout: float | None) -> None:
        """Take one finished command from the workers and save what it wrote."""
        try:
            item = self.finished.get(timeout=timeout)
        except Empty:
            return
        if item is None:
            return
        address, outcome = item
        self.running.discard(address)
        self.workers.finish(address)
        if self.stopping and not (isinstance(outcome, Outcome) and outcome.code == 0):
            return  # killed by us: not a failure of the stage
        if isinstance(outcome, WorkerLost):
            self._lose(address, outcome)
            return
        log = self._log(address)
        if isinstance(outcome, Exception):
            error = f"cannot run the command: {self._explain(outcome, address)}"
            self._fail(StageResult(address, Status.FAILED, error=error))
            return
        error = describe(outcome)
        if error:
            error += self._hint(address, log)
        else:
            try:
                stage = self.stages[address]
                steps.save(stage)
                self.lockfiles.add(stage)
            except (DvcException, OSError) as problem:
                error = self._explain(problem, address)
        result = StageResult(
            address=address,
            status=Status.FAILED if error else Status.RAN,
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

    def _lose(self, address: str, loss: WorkerLost) -> None:
        """Put a stage whose worker is gone back among those to start, unless that keeps happening."""
        self.losses[address] += 1
        if self.losses[address] > RESTARTS:
            error = f"lost {self.losses[address]} times with its worker, the last time because {loss}"
            self._fail(StageResult(address, Status.FAILED, error=error))
            return
        bisect.insort(self.due, (self.schedule.rank[address], address))
        self.on_event(Lost(address, str(loss)))

    def _flush_if_due(self) -> None:
        """Write what has waited; what cannot be written is tried again at the end, what runs goes on."""
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
                f"cannot write dvc.lock: {self._explain(error)}; what has finished is in DVC's cache: build "
                "again once it can be written, and none of that runs twice"
            ) from error

    def _explain(self, error: BaseException, address: str | None = None) -> str:
        """Give an error's message and the cause that DVC often keeps to itself; name a full disk."""
        cause = f": {error.__cause__}" if isinstance(error, DvcException) and error.__cause__ else ""
        text = f"{error}{cause}"
        if disk.is_shortage(error):
            text += f": {disk.describe(*disk.fullest(self._disks(address)))}; make space and build again"
            disk.sweep(self.repo)
        return text

    def _hint(self, address: str, log: Path) -> str:
        """Name the full disk, if that may be why a command has failed."""
        path, free, total = disk.fullest(self._disks(address))
        if free >= disk.LOW and not disk.mentions_shortage(tail(log)):
            return ""
        return f"; {disk.describe(path, free, total)}; make space and build again"

    def _disks(self, address: str | None) -> list[Path]:
        outs = self.stages[address].outs if address else ()
        cache = Path(self.repo.cache.local.path)
        return [*(Path(out.fs_path) for out in outs), self.logs, cache, Path(self.repo.tmp_dir)]

    def _log(self, address: str) -> Path:
        return log_path(self.logs, address)

    def _succeed(self, result: StageResult) -> None:
        failures.forget(self.logs, result.address)
        self.schedule.finish(result.address)
        self._report(result)

    def _fail(self, result: StageResult) -> None:
        failures.record(self.logs, self.stages[result.address], result)
        self._report(result)
        for address in self.schedule.downstream(result.address):
            if address not in self.results:
                self._report(StageResult(address, Status.BLOCKED, error=f"needs {result.address}"))
        if not self.options.keep_going:
            self._give_up(result.address)

    def _give_up(self, cause: str) -> None:
        """Start nothing more; what runs may end."""
        self.due.clear()
        while self.schedule.pop() is not None:
            pass
        for address in self.stages:
            if address not in self.results and address not in self.running:
                self._report(StageResult(address, Status.BLOCKED, error=f"not started after {cause} failed"))

    def _report(self, result: StageResult) -> None:
        self.results[result.address] = result
        self.on_event(Finished(result))

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Turn the first signal into a clean stop; a second one stops at once."""
        if threading.current_thread() is not threading.main_thread():
            yield  # only the main thread may handle signals; its handler is the caller's business
            return

        def handle(number: int, frame: object) -> None:
            if self.signal is not None:
                raise KeyboardInterrupt
            self.signal = number
            self.finished.put(None)

        # A signal that is ignored (nohup, background jobs) stays ignored.
        heeded = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
        before = {number: signal.signal(number, handle) for number in heeded}
        try:
            yield
        except _Interrupted as interrupted:
            if interrupted.number == signal.SIGINT:
                raise KeyboardInterrupt from None
            raise SystemExit(128 + interrupted.number) from None
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
