"""Run the commands of stages on the nodes of a Ray cluster that share the workspace's file system."""

import logging
import os
import signal
import socket
import threading
import time
import uuid
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from objectfolder.engine import node
from objectfolder.engine.build import MakeWorkers
from objectfolder.engine.failures import LOGS
from objectfolder.engine.process import Command, CommandResult
from objectfolder.engine.resources import Needs
from objectfolder.engine.workers import FinishedQueue, WorkerLost
from objectfolder.errors import ObjectFolderError

#: Seconds between two looks at which nodes there are.
PERIOD = 1.0
#: Seconds that a node may take to start a worker and look for the workspace.
PROBE_TIMEOUT = 60.0
#: Seconds that killed commands may take to end.
KILL_TIMEOUT = 30.0
CONNECT_TIMEOUT = 5.0
MARKER = "cluster-{}.tmp"


@dataclass(frozen=True)
class Node:
    """A node of the cluster that can run stages.

    Parameters
    ----------
    id : str
        Ray's name for it.
    name : str
        Host name and address.
    cpus, gpus, memory_mb : int
        What it has in all, free or not.
    """

    id: str
    name: str
    cpus: int
    gpus: int
    memory_mb: int

    def has(self, needs: Needs) -> bool:
        """Whether a stage could ever run here."""
        return needs.cpus <= self.cpus and needs.gpus <= self.gpus and needs.memory_mb <= self.memory_mb


def fitted(needs: Needs, nodes: Sequence[Node], jobs: int | None = None) -> Needs:
    """Reduce needs to what one node has, so that no stage waits forever.

    That node is the one that comes closest: in GPUs first, then cores, then memory. Without any GPU in the
    cluster, a stage that can use one runs on the CPU.
    """
    cpus = needs.cpus if jobs is None else min(needs.cpus, jobs)
    gpus = needs.gpus if needs.gpus <= 1 else round(needs.gpus)  # Ray shares one GPU, but not several
    reduced = (
        (min(gpus, place.gpus), min(cpus, place.cpus), min(needs.memory_mb, place.memory_mb))
        for place in nodes
    )
    gpus, cpus, memory_mb = max(reduced)
    return replace(needs, cpus=cpus, gpus=gpus, memory_mb=memory_mb)


def ray_workers(address: str = "auto") -> MakeWorkers:
    """Give what makes the workers of a build on a running Ray cluster.

    Parameters
    ----------
    address : str
        ``HOST:PORT`` of the head node; ``auto`` takes ``RAY_ADDRESS``, or the cluster that this machine is
        a node of. This machine must be a node of it (``ray start --address HOST:PORT --num-cpus 0`` makes
        it one that runs nothing).

    Returns
    -------
    callable
        For the argument ``make_workers`` of `objectfolder.engine.build.build`. It raises `ObjectFolderError`
        if Ray is not installed, no cluster answers, the versions of Python or Ray differ, or a node
        does not see the workspace.
    """

    def make(jobs: int | None, finished: FinishedQueue) -> RayWorkers:
        return RayWorkers(address, jobs, finished, Path.cwd())  # a build works in its workspace

    return make


class RayWorkers:
    """Run commands on a Ray cluster, on the nodes that Ray chooses.

    The end of this process, of whatever kind, ends its commands: Ray kills the workers of a dead driver, and
    each command dies with its worker.

    Parameters
    ----------
    address : str
        Of the cluster; see `ray_workers`.
    jobs : int, optional
        Cores to use in the whole cluster; default: all.
    finished : SimpleQueue
        Where outcomes go. A command that was lost with its worker gives a `WorkerLost`.
    workspace : Path
        Folder that all nodes must see.

    Raises
    ------
    ObjectFolderError
        See `ray_workers`.
    """

    def __init__(self, address: str, jobs: int | None, finished: FinishedQueue, workspace: Path):
        self.ray = _connect(address)
        self.jobs = jobs
        self.finished = finished
        self._taken: dict[str, Needs] = {}
        self._refs: dict[str, Any] = {}
        self._ended: dict[str, threading.Event] = {}
        self._closing = threading.Event()
        self._marker = workspace / LOGS / MARKER.format(uuid.uuid4().hex)
        try:
            self._mark()
            self._nodes = self._find_nodes()
            self._probe()
        except BaseException:
            self._disconnect()
            raise
        self._watcher = threading.Thread(target=self._watch, name="ray nodes", daemon=True)
        self._watcher.start()

    @property
    def cores(self) -> int:
        """Cores that commands may use together."""
        cpus = sum(place.cpus for place in self._nodes)
        return min(cpus, self.jobs or cpus)

    def room(self, needs: Needs) -> str:
        """What a command would have to wait for in the cluster as a whole; Ray chooses the node."""
        nodes = self._nodes  # which `_watch` replaces
        if not self._taken or not nodes:
            return ""  # without nodes, `submit` says what is wrong
        wanted = fitted(needs, nodes, self.jobs)
        taken = self._taken.values()
        if sum(other.cpus for other in taken) + wanted.cpus > self.cores:
            return "cpu"
        memory_mb = sum(place.memory_mb for place in nodes)
        if sum(other.memory_mb for other in taken) + wanted.memory_mb > memory_mb:
            return "memory"
        gpus = sum(place.gpus for place in nodes)
        short = sum(other.gpus for other in taken) + wanted.gpus > gpus + 1e-9
        return "gpu" if wanted.gpus and short else ""

    def submit(self, address: str, command: Command, needs: Needs) -> None:
        """Hand a command to Ray.

        Raises
        ------
        ObjectFolderError
            If no node is left.
        """
        self._nodes = self._find_nodes()
        wanted = fitted(needs, self._nodes, self.jobs)
        task = self.ray.remote(node.run).options(
            name=address,
            num_cpus=wanted.cpus,
            num_gpus=wanted.gpus,
            memory=wanted.memory_mb * 2**20,
            max_retries=0,  # the engine starts it again, after it has removed what the lost one left behind
        )
        reference = task.remote(command, wanted.cpus, self._marker)
        self._taken[address] = wanted
        self._refs[address] = reference
        self._ended[address] = threading.Event()
        reference.future().add_done_callback(partial(self._done, address, self._ended[address]))

    def finish(self, address: str) -> None:
        """Free what a command held."""
        del self._taken[address], self._refs[address], self._ended[address]

    def kill(self) -> None:
        """Kill every running command, by killing its worker."""
        for reference in self._refs.values():
            self.ray.cancel(reference, force=True)

    def close(self) -> None:
        """Wait until the commands have ended, and leave the cluster."""
        deadline = time.monotonic() + KILL_TIMEOUT
        for ended in self._ended.values():
            ended.wait(max(0.0, deadline - time.monotonic()))
        self._closing.set()
        self._watcher.join()
        self._disconnect()

    def _done(self, address: str, ended: threading.Event, future: "Future[CommandResult]") -> None:
        """Report a command; called in a thread of Ray's."""
        error = future.exception()
        self.finished.put((address, future.result() if error is None else _failure(error)))
        ended.set()

    def _find_nodes(self) -> list[Node]:
        nodes = [
            Node(
                id=entry["NodeID"],
                name=f"{entry['NodeManagerHostname']} ({entry['NodeManagerAddress']})",
                cpus=int(entry["Resources"].get("CPU", 0)),
                gpus=int(entry["Resources"].get("GPU", 0)),
                memory_mb=int(entry["Resources"].get("memory", 0) / 2**20),
            )
            for entry in self.ray.nodes()
            if entry["Alive"]
        ]
        nodes = [place for place in nodes if place.cpus]
        if not nodes:
            raise ObjectFolderError(
                "the Ray cluster has no node with a core for stages; add one with "
                "`ray start --address HOST:PORT`, and build again: what has finished is kept"
            )
        return nodes

    def _watch(self) -> None:
        """Look which nodes there are, and take back what waits for a node that is gone."""
        while not self._closing.wait(PERIOD):
            try:
                self._nodes = self._find_nodes()
            except ObjectFolderError:
                self._nodes = []
            for address, wanted in list(self._taken.items()):
                reference = self._refs.get(address)
                if reference is not None and not any(place.has(wanted) for place in self._nodes):
                    self.ray.cancel(reference, force=True)

    def _mark(self) -> None:
        self._marker.parent.mkdir(parents=True, exist_ok=True)
        for stale in self._marker.parent.glob(MARKER.format("*")):
            stale.unlink()  # of an engine that was killed; this one owns the workspace
        self._marker.touch()

    def _probe(self) -> None:
        """Make sure that every node can run the engine's code and sees the workspace."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        check = self.ray.remote(node.check_workspace)
        looks = [
            check.options(
                num_cpus=0,
                max_retries=0,
                scheduling_strategy=NodeAffinitySchedulingStrategy(place.id, soft=False),
            ).remote(self._marker)
            for place in self._nodes
        ]
        self.ray.wait(looks, num_returns=len(looks), timeout=PROBE_TIMEOUT)
        problems = filter(None, map(self._problem, self._nodes, looks))
        if text := "\n".join(dict.fromkeys(problems)):
            raise ObjectFolderError(text)

    def _problem(self, place: Node, look: Any) -> str:
        """What is wrong with a node; empty if nothing."""
        from ray.exceptions import GetTimeoutError, RayError, RayTaskError

        try:
            self.ray.get(look, timeout=0)
        except GetTimeoutError:
            return f"node {place.name} has not answered for {PROBE_TIMEOUT:.0f} s; see its Ray logs"
        except RayTaskError as error:
            cause = _cause(error)
            if isinstance(cause, node.NotShared):
                return str(cause)
            return (
                f"node {place.name} cannot run the engine's code ({_last_line(cause)}); "
                "install objectfolder there, for the Python that runs `ray start`"
            )
        except RayError as error:
            return f"node {place.name}: {_describe(error)}"
        return ""

    def _disconnect(self) -> None:
        self._marker.unlink(missing_ok=True)
        self.ray.shutdown()


def _connect(address: str) -> Any:
    """Connect this process to a running cluster, quietly; returns Ray."""
    try:
        import ray
        from ray._private import worker
        from ray._private.services import canonicalize_bootstrap_address_or_die
    except ModuleNotFoundError as error:
        raise ObjectFolderError(
            f"{error.name} is not installed; `--engine ray` needs: pip install 'objectfolder[ray]'"
        ) from error
    given = os.environ.get("RAY_ADDRESS", address) if address == "auto" else address
    if "://" in given:
        raise ObjectFolderError(
            f"Ray address {given}: clients from outside are not supported, their stages would outlive them; "
            "make this machine a node (ray start --address HOST:PORT --num-cpus 0) and give HOST:PORT"
        )
    # Ray tells the driver of dead workers on standard output, whatever `log_to_driver` says.
    worker._worker_logs_enabled = False
    try:
        found = canonicalize_bootstrap_address_or_die(given)
        _knock(found)
        with _own_signals():
            ray.init(found, log_to_driver=False, logging_level=logging.CRITICAL)
    except (ConnectionError, OSError, ValueError) as error:
        raise ObjectFolderError(
            f"no Ray cluster answers at {given!r} ({error}); start one with `ray start --head`, and give its "
            "--address HOST:PORT on a machine that is a node of it"
        ) from error
    except RuntimeError as error:  # Ray insists on its own and Python's version, to the patch level
        raise ObjectFolderError(
            f"cannot join the Ray cluster at {given}: {error}\n"
            "start Ray on all nodes from environments with the same versions"
        ) from error
    return ray


def _knock(address: str) -> None:
    """Ask whether anyone listens: Ray itself waits for two minutes and then ends the process."""
    host, _, port = address.rpartition(":")
    with socket.create_connection((host.strip("[]"), int(port)), CONNECT_TIMEOUT):
        pass


@contextmanager
def _own_signals() -> Iterator[None]:
    """Keep the handler of SIGTERM, which Ray replaces."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, handler)


def _failure(error: BaseException) -> Exception:
    """What the engine is to hear of a command that has no outcome."""
    from ray.exceptions import RayTaskError, TaskCancelledError

    if isinstance(error, RayTaskError):
        return _cause(error)
    if isinstance(error, TaskCancelledError):
        # By `_watch`; what `kill` cancels nobody asks about any more.
        return WorkerLost("no node is left that has what it needs")
    return WorkerLost(_describe(error))


def _cause(error: Any) -> Exception:
    """What a task itself raised on its node."""
    cause = getattr(error, "cause", None)
    return cause if isinstance(cause, Exception) else error


def _last_line(error: BaseException) -> str:
    """Reduce a message that holds a traceback to what happened."""
    return next((line for line in reversed(str(error).splitlines()) if line.strip()), type(error).__name__)


def _describe(error: BaseException) -> str:
    """Say in a line what became of a worker."""
    known = {
        "WorkerCrashedError": "its worker died",
        "NodeDiedError": "its node died",
        "OutOfMemoryError": "its node ran out of memory, and Ray killed it",
    }
    name = type(error).__name__
    return known.get(name) or f"{name}: {_last_line(error)}"
