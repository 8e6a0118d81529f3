"""What the measuring scripts share: fresh single-threaded processes, JSON records, verdicts on targets."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from objectfolder.io import write_text

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class JobError(Exception):
    """A job's process failed."""


def fresh(script: str, job: str, *arguments: object) -> dict:
    """Run ``script --job JOB ARGUMENTS`` in a new single-threaded process and return the JSON it prints."""
    done = subprocess.run(
        [sys.executable, script, "--job", job, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, **ONE_THREAD},
    )
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["failed"])[-1]
        raise JobError(f"{job} {' '.join(map(str, arguments))}: {reason}")
    return json.loads(done.stdout.splitlines()[-1])


def fresh_row(script: str, job: str, key: str, *arguments: object) -> dict:
    """Return the row of an object, measured in a new process; a crash is part of the row."""
    try:
        return {"object": key, **fresh(script, job, *arguments)}
    except JobError as error:
        return {"object": key, "failed": str(error)}


def write_record(path: Path | None, record: Mapping[str, Any]) -> None:
    """Write the figures for docs/results.md, one row per line, if a path is given."""
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


def exit_with_verdict(missed: Sequence[str], count: int, console: Console) -> None:
    """Print the missed targets and exit with 1 if there are any."""
    verdict = "; ".join(missed) or f"met by all {count}"
    console.print(f"targets: {verdict}", markup=False, soft_wrap=True)
    sys.exit(bool(missed))
