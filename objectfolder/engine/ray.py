"""Workers on a Ray cluster whose nodes share the file system of the workspace."""

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

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import install_command
from objectfolder.engine import node
from objectfolder.engine.build import MakeWorkers
from objectfolder.engine.process import Command, CommandResult
from objectfolder.engine.records import LOGS
from objectfolder.engine.resources import Needs
from objectfolder.engine.workers import FinishedQueue, WorkerLost

#: Seconds between two queries for the nodes of the cluster.
PERIOD = 1.0
#: Seconds for a node to start a worker and check the workspace.
PROBE_TIMEOUT = 60.0
#: Seconds for killed commands to end.
KILL_TIMEOUT = 30.0
CONNECT_TIMEOUT = 5.0
MARKER = "cluster-{}.tmp"
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Node:
    """Cluster node that can run stages."""

    id: str  #: node id of Ray
    name: str  #: host name and address
    #: Total resources, free or taken.
    cpus: int
    gpus: int
    memory_mb: int

    def has(self, needs: Needs) -> bool:
        """Return whether the total resources of this node suffice for a stage."""
        return needs.cpus <= self.cpus and needs.gpus <= self.gpus and needs.memory_mb <= self.memory_mb


def fit_to_nodes(needs: Needs, nodes: Sequence[Node], jobs: int | None = None) -> Needs:
    """Reduce the needs of a stage to the resources of the best-fitting node, so that no stage waits forever.

    Nodes are compared by GPUs first, then cores, then memory. Without GPUs, stages run on the CPU.
    """
    cpus = needs.cpus if jobs is None else min(needs.cpus, jobs)
    gpus = needs.gpus if needs.gpus <= 1 else round(needs.gpus)  # Ray allows fractions of one GPU only
    reduced = (
        (min(gpus, place.gpus), min(cpus, place.cpus), min(needs.memory_mb, place.memory_mb))
        for place in nodes
    )
    gpus, cpus, memory_mb = max(reduced)
    return replace(needs, cpus=cpus, gpus=gpus, memory_mb=memory_mb)


def ray_workers(address: str = "auto") -> MakeWorkers:
    """Return a factory of workers on a running Ray cluster.

    Parameters
    ----------
    address : str
        ``HOST:PORT`` of the head node; ``auto``: ``RAY_ADDRESS``, or the cluster of this machine. This
        machine must be a node of the cluster (``ray start --address HOST:PORT --num-cpus 0`` adds it as a
        node that runs no stages).

    Returns
    -------
    callable
        Value of the argument ``make_workers`` of `objectfolder.engine.build.build`. It raises
        `ObjectFolderError` if Ray is not installed, no cluster answers, the versions of Python or Ray
        differ, or a node does not see the workspace.
    """

    def make(jobs: int | None, finished: FinishedQueue) -> RayWorkers:
        return RayWorkers(address, jobs, finished, Path.cwd())  # a build works in its workspace

    return make


class RayWorkers:
    """Workers on a Ray cluster; Ray chooses the node of each command.

    When this process ends, for whatever reason, its commands end too: Ray kills the workers of a dead driver,
    and each command dies with its worker.

    ``address``: address of the cluster; see `ray_workers`. ``jobs``: cores to use in the whole cluster;
    default: all. ``finished``: queue for outcomes. A command that was lost with its worker yields a
    `WorkerLost`. ``workspace``: folder that must be visible on all nodes. Raises what `ray_workers` says.
    """

    def __init__(self, address: str, jobs: int | None, finished: FinishedQueue, workspace: Path):
        self.ray = _connect(address)
        self._head = str(self.ray.get_runtime_context().gcs_address)
        self._lost_head = False
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
        """Cores for all commands together."""
        cpus = sum(place.cpus for place in self._nodes)
        return min(cpus, self.jobs or cpus)

    def room(self, needs: Needs) -> str:
        """Return the resource that a command must wait for in the cluster as a whole."""
        nodes = self._nodes  # `_watch` replaces the attribute
        if not self._taken or not nodes:
            return ""  # without nodes, `submit` raises an error
        wanted = fit_to_nodes(needs, nodes, self.jobs)
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

        Raises ObjectFolderError if no node is left.
        """
        self._nodes = self._find_nodes()
        wanted = fit_to_nodes(needs, self._nodes, self.jobs)
        task = self.ray.remote(node.run).options(
            name=address,
            num_cpus=wanted.cpus,
            num_gpus=wanted.gpus,
            memory=wanted.memory_mb * 2**20,
            max_retries=0,  # the engine restarts it, after removing partial outputs
        )
        reference = task.remote(command, wanted.cpus, self._marker)
        self._taken[address] = wanted
        self._refs[address] = reference
        self._ended[address] = threading.Event()
        reference.future().add_done_callback(partial(self._done, address, self._ended[address]))

    def finish(self, address: str) -> None:
        """Release the resources of a command."""
        del self._taken[address], self._refs[address], self._ended[address]

    def kill(self) -> None:
        """Kill all running commands by killing their workers."""
        for reference in self._refs.values():
            self.ray.cancel(reference, force=True)

    def close(self) -> None:
        """Wait for the commands to end, then disconnect from the cluster."""
        deadline = time.monotonic() + KILL_TIMEOUT
        for ended in self._ended.values():
            ended.wait(max(0.0, deadline - time.monotonic()))
        self._closing.set()
        self._watcher.join()
        self._disconnect()

    def _done(self, address: str, ended: threading.Event, future: "Future[CommandResult]") -> None:
        """Report the outcome of a command; called in a thread of Ray."""
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
        """Update the list of nodes periodically, and cancel commands that no remaining node can run."""
        while not self._closing.wait(PERIOD):
            self._look_for_head()
            try:
                self._nodes = self._find_nodes()
            except ObjectFolderError:
                self._nodes = []
            for address, wanted in list(self._taken.items()):
                reference = self._refs.get(address)
                if reference is not None and not any(place.has(wanted) for place in self._nodes):
                    self.ray.cancel(reference, force=True)

    def _look_for_head(self) -> None:
        """Warn once if the head node is gone: Ray then ends this process, which can say nothing more."""
        try:
            _knock(self._head)
        except OSError:
            if not self._lost_head:
                self._lost_head = True
                _log.warning(
                    "the head node of the Ray cluster at %s does not answer; unless it comes back within a "
                    "minute, Ray ends this build; start the cluster again, and build again: what has "
                    "finished is kept",
                    self._head,
                )
        else:
            self._lost_head = False

    def _mark(self) -> None:
        self._marker.parent.mkdir(parents=True, exist_ok=True)
        self._marker.touch(exist_ok=False)  # follows no link

    def _probe(self) -> None:
        """Check that every node can run the engine's code and sees the workspace."""
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
        """Return the problem of a node; empty if there is none."""
        from ray.exceptions import GetTimeoutError, RayError, RayTaskError

        try:
            self.ray.get(look, timeout=0)
        except GetTimeoutError:
            return f"node {place.name} did not answer within {PROBE_TIMEOUT:.0f} s; see its Ray logs"
        except RayTaskError as error:
            cause = _cause(error)
            if isinstance(cause, node.NotShared):
                return str(cause)
            return (
                f"node {place.name} cannot run the engine's code ({_last_line(cause)}); "
                "install objectfolder there, in the Python environment of `ray start`"
            )
        except RayError as error:
            return f"node {place.name}: {_describe(error)}"
        return ""

    def _disconnect(self) -> None:
        self._marker.unlink(missing_ok=True)
        self.ray.shutdown()


def _connect(address: str) -> Any:
    """Connect this process to a running cluster without log output; return the module ``ray``."""
    try:
        import ray
        from ray._private import worker
        from ray._private.services import canonicalize_bootstrap_address_or_die
    except ModuleNotFoundError as error:
        raise ObjectFolderError(
            f"{error.name} is not installed; `--engine ray` needs: {install_command('ray')}"
        ) from error
    given = os.environ.get("RAY_ADDRESS", address) if address == "auto" else address
    if "://" in given:
        raise ObjectFolderError(
            f"Ray address {given}: Ray Client is not supported, because stages would outlive the client; "
            "make this machine a node (ray start --address HOST:PORT --num-cpus 0) and give HOST:PORT"
        )
    # Ray reports dead workers on standard output even with `log_to_driver=False`.
    worker._worker_logs_enabled = False
    try:
        found = canonicalize_bootstrap_address_or_die(given)
        _knock(found)
        with _keep_signals():
            ray.init(found, log_to_driver=False, logging_level=logging.CRITICAL)
    except (ConnectionError, OSError, ValueError) as error:
        raise ObjectFolderError(
            f"no Ray cluster answers at {given!r} ({error}); start one with `ray start --head`, and give its "
            "--address HOST:PORT on a machine that is a node of it"
        ) from error
    except RuntimeError as error:  # the versions of Ray and Python must match to the patch level
        raise ObjectFolderError(
            f"cannot join the Ray cluster at {given}: {error}\n"
            "start Ray on all nodes from environments with the same versions"
        ) from error
    return ray


def _knock(address: str) -> None:
    """Check that the address accepts connections: Ray would wait two minutes and then exit the process."""
    host, _, port = address.rpartition(":")
    with socket.create_connection((host.strip("[]"), int(port)), CONNECT_TIMEOUT):
        pass


@contextmanager
def _keep_signals() -> Iterator[None]:
    """Restore the handler of SIGTERM, which Ray replaces."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, handler)


def _failure(error: BaseException) -> Exception:
    from ray.exceptions import RayTaskError, TaskCancelledError

    if isinstance(error, RayTaskError):
        return _cause(error)
    if isinstance(error, TaskCancelledError):
        # Cancelled by `_watch`; outcomes after `kill` are not read.
        return WorkerLost("no remaining node has the resources that it needs")
    return WorkerLost(_describe(error))


def _cause(error: Any) -> Exception:
    cause = getattr(error, "cause", None)
    return cause if isinstance(cause, Exception) else error


def _last_line(error: BaseException) -> str:
    return next((line for line in reversed(str(error).splitlines()) if line.strip()), type(error).__name__)


def _describe(error: BaseException) -> str:
    """Describe the loss of a worker in one line."""
    known = {
        "WorkerCrashedError": "its worker died",
        "NodeDiedError": "its node died",
        "LocalRayletDiedError": "the Ray node of this machine died; start it again (`ray start`)",
        "OutOfMemoryError": "its node ran out of memory, and Ray killed it",
    }
    name = type(error).__name__
    return known.get(name) or f"{name}: {_last_line(error)}"
