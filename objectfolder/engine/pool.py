"""Processes that share what one command computes of many objects, and end with it."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

from objectfolder.engine.supervisor import die_with


def process_pool(jobs: int | None) -> ProcessPoolExecutor:
    """Return fresh processes, ``jobs`` or as many as there are cores.

    Without `die_with`, one whose parent was killed would finish its task, for nobody, and wait for ever.
    """
    return ProcessPoolExecutor(jobs, get_context("spawn"), initializer=die_with, initargs=(os.getpid(),))


def in_processes(call: Callable[..., None], arguments: list[tuple[Any, ...]], jobs: int) -> Iterator[None]:
    """Call a function with each of the arguments, several at a time; give an item for each that is done."""
    with process_pool(min(jobs, len(arguments))) as pool:
        waiting = [pool.submit(call, *given) for given in arguments]
        try:
            for done in as_completed(waiting):
                yield done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
