"""Pools of worker processes that end with their parent."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

from objectfolder.engine.supervisor import die_with

_Result = TypeVar("_Result")


def process_pool(jobs: int | None) -> ProcessPoolExecutor:
    """Return a pool of ``jobs`` spawned processes; default: one per core.

    Without `die_with`, workers of a killed parent would finish their task and then wait forever.
    """
    return ProcessPoolExecutor(jobs, get_context("spawn"), initializer=die_with, initargs=(os.getpid(),))


def in_processes(
    call: Callable[..., _Result], arguments: list[tuple[Any, ...]], jobs: int
) -> Iterator[_Result]:
    """Call a function with each tuple of arguments in parallel; yield results in the order they finish."""
    with process_pool(min(jobs, len(arguments))) as pool:
        waiting = [pool.submit(call, *given) for given in arguments]
        try:
            for done in as_completed(waiting):
                yield done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
