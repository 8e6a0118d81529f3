"""The edge of the pipeline: each stage reads declared inputs, calls the library, writes declared outputs."""

import argparse
import inspect
import logging
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rich.progress import track
from threadpoolctl import threadpool_limits

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.terminal import Terminal, guard_streams
from objectfolder.workspace.installed import check_installed

_console = Terminal(stderr=True)


def run(
    stage: Callable[[str], None], description: str | None, of: str = "object key, as in params.yaml"
) -> None:
    """Run a stage for the object, or the split of a benchmark, that the command line names.

    A stage has one thread, so that the same inputs give the same bytes whatever runs beside it.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("key", help=of)
    key = parser.parse_args().key
    logging.basicConfig(level=logging.INFO)
    guard_streams()
    try:
        check_installed()
        with threadpool_limits(1):
            if "torch" in sys.modules:
                sys.modules["torch"].set_num_threads(1)
            stage(key)
    except ObjectFolderError as error:
        sys.exit(f"{Path(inspect.getfile(stage)).stem} {key}: {error}")


def progress(description: str) -> Callable[[Iterable[Any]], Iterable[Any]]:
    """Return a function that wraps an iteration in a progress bar, if the output is a terminal."""
    return lambda items: track(items, description, console=_console, disable=not _console.is_terminal)


def log_point(point: Any) -> None:
    """Print one point of a training curve."""
    print(
        f"step {point.step:6d}  train {point.train_loss:.3e}  val {point.val_loss:.3e}  "
        f"{point.seconds:6.1f} s",
        flush=True,
    )
