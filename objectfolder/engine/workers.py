"""Who runs the commands of stages: threads of this process here, a cluster in `objectfolder.engine.ray`."""

import threading
from dataclasses import replace
from queue import SimpleQueue
from typing import Protocol

from objectfolder.engine.process import Children, Command, CommandResult
from objectfolder.engine.resources import Machine, Needs

#: What workers hand back: an outcome, or why there is none. None only wakes the engine up.
FinishedQueue = SimpleQueue[tuple[str, CommandResult | Exception] | None]


class WorkerLost(Exception):
    """A command ended with the worker or node that ran it, through no fault of its own."""


class Workers(Protocol):
    """Run commands and put ``(address, outcome)`` into a queue."""

    @property
    def cores(self) -> int:
        """Cores that commands may use together."""

    def room(self, needs: Needs) -> str:
        """What a command would have to wait for: ``cpu``, ``memory``, ``gpu`` or nothing (empty)."""

    def submit(self, address: str, command: Command, needs: Needs) -> None:
        """Start a command; called only when there is room."""

    def finish(self, address: str) -> None:
        """Take note that the outcome of a command was seen: its room is free again."""

    def kill(self) -> None:
        """Kill what runs, and start nothing more."""

    def close(self) -> None:
        """Wait until all outcomes are in the queue, and let go of what was held."""


class LocalWorkers:
    """Run commands on this machine, each watched by a thread.

    Parameters
    ----------
    machine : Machine
        What may be used.
    finished : SimpleQueue
        Where outcomes go.
    """

    def __init__(self, machine: Machine, finished: FinishedQueue):
        self.machine = machine
        self.finished = finished
        self.children = Children()
        self._threads: dict[str, threading.Thread] = {}

    @property
    def cores(self) -> int:
        """Cores that commands may use together."""
        return self.machine.cores

    def room(self, needs: Needs) -> str:
        """What a command would have to wait for."""
        return self.machine.room(needs)

    def submit(self, address: str, command: Command, needs: Needs) -> None:
        """Start a command in a thread of its own, which outlives it, as `Children.run` requires."""
        gpus = self.machine.take(address, needs)
        if self.machine.has_gpus:
            # A stage sees the GPUs that it was given, and none if it did not ask.
            visible = {"CUDA_VISIBLE_DEVICES": ",".join(gpus) or "-1"}
            command = replace(command, env={**command.env, **visible})
        thread = threading.Thread(target=self._work, args=(address, command), name=address, daemon=True)
        self._threads[address] = thread
        thread.start()

    def finish(self, address: str) -> None:
        """Free what a command held."""
        self._threads.pop(address).join()
        self.machine.give(address)

    def kill(self) -> None:
        """Kill every running command with all its processes."""
        self.children.kill()

    def close(self) -> None:
        """Wait for the threads."""
        for thread in self._threads.values():
            thread.join()

    def _work(self, address: str, command: Command) -> None:
        try:
            self.finished.put((address, self.children.run(command)))
        except Exception as error:  # the engine must hear of everything, or it would wait forever
            self.finished.put((address, error))
