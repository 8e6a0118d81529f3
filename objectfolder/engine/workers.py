"""Workers that run stage commands: their interface, and threads of this process."""

import signal
import threading
from contextlib import suppress
from dataclasses import replace
from queue import SimpleQueue
from typing import Protocol

from objectfolder.engine.process import Children, Command, CommandResult, NotStarted
from objectfolder.engine.resources import Machine, Needs
from objectfolder.engine.warm import Starter, is_stage

#: Results of workers: address and outcome, or the error instead of one. None only wakes up the engine.
FinishedQueue = SimpleQueue[tuple[str, CommandResult | Exception] | None]


class WorkerLost(Exception):
    """A command was lost with its worker or node and can be started again."""


class Workers(Protocol):
    """Interface of workers, which run commands and put ``(address, outcome)`` into a queue."""

    @property
    def cores(self) -> int:
        """Cores for all commands together."""

    def room(self, needs: Needs) -> str:
        """Return the resource that a command must wait for: ``cpu``, ``memory`` or ``gpu``; empty if none."""

    def submit(self, address: str, command: Command, needs: Needs) -> None:
        """Start a command; call only when there is room."""

    def finish(self, address: str) -> None:
        """Release the resources of a command, after its outcome was read."""

    def kill(self) -> None:
        """Kill all running commands, and start no more."""

    def close(self) -> None:
        """Wait until all outcomes are in the queue, then release all resources."""


class LocalWorkers:
    """Workers on this machine: one thread per command.

    ``machine``: resources to use; ``finished``: queue for outcomes.
    """

    def __init__(self, machine: Machine, finished: FinishedQueue):
        self.machine = machine
        self.finished = finished
        self.children = Children()
        self._starter: Starter | None = None
        self._threads: dict[str, threading.Thread] = {}

    @property
    def cores(self) -> int:
        """Cores for all commands together."""
        return self.machine.cores

    def room(self, needs: Needs) -> str:
        """Return the resource that a command must wait for."""
        return self.machine.room(needs)

    def submit(self, address: str, command: Command, needs: Needs) -> None:
        """Start a command in a thread that outlives it, as `Children.run` requires."""
        gpus = self.machine.take(address, needs)
        if self.machine.has_gpus:
            # Hide all GPUs that are not reserved for this stage.
            visible = {"CUDA_VISIBLE_DEVICES": ",".join(gpus) or "-1"}
            command = replace(command, env={**command.env, **visible})
        arguments = address, command, self._warm(command, needs)
        thread = threading.Thread(target=self._work, args=arguments, name=address, daemon=True)
        self._threads[address] = thread
        thread.start()

    def finish(self, address: str) -> None:
        """Release the resources of a command."""
        self._threads.pop(address).join()
        self.machine.give(address)

    def kill(self) -> None:
        """Kill all running commands with their child processes."""
        self.children.kill()
        if self._starter:
            self._starter.kill()

    def close(self) -> None:
        """Wait for the threads."""
        for thread in self._threads.values():
            thread.join()
        if self._starter:
            self._starter.close()

    def _warm(self, command: Command, needs: Needs) -> Starter | None:
        """Return what starts a command warm; None if it must start cold.

        Libraries set the number of their threads, and look for GPUs, once in a process.
        """
        if needs.cpus > 1 or needs.gpus or not is_stage(command):
            return None
        if not self._starter:
            with suppress(OSError):  # no more processes, say; the command itself will fail with it
                self._starter = Starter(command.env)
        return self._starter

    def _work(self, address: str, command: Command, starter: Starter | None) -> None:
        try:
            outcome: CommandResult | Exception = self._run(command, starter)
        except Exception as error:  # without an outcome the engine would wait forever
            outcome = error
        self.finished.put((address, outcome))

    def _run(self, command: Command, starter: Starter | None) -> CommandResult:
        if starter and starter.usable:
            try:
                result = self.children.run(command, starter.start)
            except NotStarted as reason:
                starter.give_up(reason)
            else:
                if result.code == -signal.SIGKILL and not starter.alive:
                    starter.give_up("the process that had imported them died")
                    raise WorkerLost("the process that started it died")
                return result
        return self.children.run(command)
