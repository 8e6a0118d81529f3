"""Helpers of the measuring scripts: jobs in fresh single-threaded processes, JSON records, verdicts."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from objectfolder.errors import ObjectFolderError
from objectfolder.io import write_text

LIBRARIES = ("OMP", "OPENBLAS", "MKL", "IGL")
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in LIBRARIES}


def fresh(script: str, job: str, *arguments: object) -> dict:
    """Run a job of a script in a new single-threaded process.

    Returns
    -------
    What the job returns, or the reason under ``failed``.
    """
    done = subprocess.run(
        [sys.executable, script, "--job", job, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, **ONE_THREAD},
    )
    if done.returncode:
        return {"failed": (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]}
    return json.loads(done.stdout.splitlines()[-1])


def require(row: dict) -> dict:
    """Return a row, or end the script if its job failed."""
    return sys.exit(row["failed"]) if "failed" in row else row


def run_job(jobs: Mapping[str, Callable[..., dict]]) -> None:
    """In a process that `fresh` started, run the job, print its result and exit."""
    if sys.argv[1:2] == ["--job"]:
        name, *arguments = sys.argv[2:]
        try:
            print(json.dumps(jobs[name](*arguments)))
        except ObjectFolderError as error:
            sys.exit(str(error))
        sys.exit()


def write_record(path: Path | None, record: Mapping[str, Any] | list) -> None:
    """Write figures for docs/results.md, one row per line, if a path is given."""
    if path:
        write_text(path, encoded(record) + "\n")


def encoded(value: Any, indent: str = "") -> str:
    """Return JSON in which lists and mappings of scalars stay on one line."""
    nested = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    if not any(isinstance(item, Mapping | list) for item in nested):
        return json.dumps(value, ensure_ascii=False)
    inner = indent + "  "
    if isinstance(value, Mapping):
        items = [f"{json.dumps(name)}: {encoded(item, inner)}" for name, item in value.items()]
        return "{\n" + ",\n".join(inner + item for item in items) + f"\n{indent}}}"
    return "[\n" + ",\n".join(inner + encoded(item, inner) for item in value) + f"\n{indent}]"


def exit_with_verdict(missed: Sequence[str], console: Console) -> None:
    """Print the missed targets and exit with 1 if there are any."""
    console.print("targets: " + ("; ".join(missed) or "met"), markup=False, soft_wrap=True)
    sys.exit(bool(missed))
