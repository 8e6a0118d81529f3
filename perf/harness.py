"""Helpers of the measuring scripts: jobs in fresh single-threaded processes, JSON records, verdicts."""

import argparse
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_text

ROOT = Path(__file__).parents[1]
LIBRARIES = ("OMP", "OPENBLAS", "MKL", "IGL")
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in LIBRARIES}


def fresh(script: str, job: str, *arguments: object) -> dict:
    """Run a job of a script in a new single-threaded process; return its result, or why under ``failed``."""
    command = [sys.executable, script, "--job", job, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | ONE_THREAD)
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


def parsed(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Parse the command line; without arguments, print the usage and exit with 2, as nothing was measured."""
    if len(sys.argv) == 1:
        parser.print_help(sys.stderr)
        sys.exit(2)
    return parser.parse_args()


def add_objects(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a script that measures objects of a workspace; see `chosen_objects`."""
    parser.add_argument("keys", nargs="*", help="objects (default: all of params.yaml)")
    parser.add_argument("--workspace", type=Path, default=ROOT, help="holds params.yaml and build/")
    parser.add_argument("--json", type=Path, help="file for the figures")


def chosen_objects(arguments: argparse.Namespace) -> list[str]:
    """Return the objects of `add_objects`."""
    from objectfolder.workspace import params  # not for jobs

    return arguments.keys or list(params.read(arguments.workspace / "params.yaml")["objects"])


def print_rows(rows: list[dict], title: str, form: dict[str, tuple[str, str]], console: Console) -> None:
    """Print a table of the rows that did not fail.

    ``form``: from the name of a figure to its title and its format; a row without it has a dash.
    """
    table = Table(title=title)
    for head, _ in form.values():
        table.add_column(head, justify="left" if head in ("object", "net") else "right", no_wrap=True)
    for row in (row for row in rows if "failed" not in row):
        table.add_row(*(format(row[name], how) if name in row else "-" for name, (_, how) in form.items()))
    console.print(table)


def failures(rows: list[dict]) -> list[str]:
    """Say which rows failed."""
    return [f"{row['object']}: {row['failed']}" for row in rows if "failed" in row]


def beyond(rows: list[dict], limits: Mapping[str, float], unit: str, least: bool = False) -> list[str]:
    """Say which figures exceed their limits, or with ``least`` do not reach them."""
    sign = -1 if least else 1
    return [
        f"{row['object']}, {name}: {row[name]:.4g} {unit}, target {limit:g} {unit}"
        for row in rows
        for name, limit in limits.items()
        if sign * (row.get(name, limit) - limit) > 0
    ]


def write_record(
    path: Path | None, record: Mapping[str, Any] | list, targets: str = "", missed: Sequence[str] = ()
) -> None:
    """Write figures for docs/results.md, with the run that measured them, if a path is given.

    Rows of a list get the name ``rows``. ``targets``: in words, if there are any; ``missed``: what missed its
    target, and by how much.
    """
    if path:
        rows = record if isinstance(record, Mapping) else {"rows": record}
        rewrite(path, {"run": this_run(), "targets": targets, "missed": list(missed)} | dict(rows))


def rewrite(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record as it is, one row per line."""
    write_text(path, encoded(record) + "\n")


def this_run() -> dict[str, str]:
    """Return the command line, commit, machine and date (UTC) of this process.

    A ``+`` after the commit stands for changes that are not committed. Folders outside the repository are
    given by their names.
    """
    from objectfolder.benchmarks.tasks.running import machine  # imports torch, which jobs may not need

    def git(*arguments: str) -> str:
        found = subprocess.run(["git", "-C", ROOT, *arguments], capture_output=True, text=True)
        return found.stdout.strip() if found.returncode == 0 else ""

    words = [str(Path(sys.argv[0]).resolve()), *sys.argv[1:]]
    shown = [_shown(word, Path(word)) for word in words]
    changed = "+" if git("status", "--porcelain", "--untracked-files=no") else ""
    return {
        "command": shlex.join(["python", *shown]),
        "commit": (git("rev-parse", "--short=7", "HEAD") or "unknown") + changed,
        "machine": machine("cpu"),
        "date": datetime.now(UTC).date().isoformat(),
    }


def _shown(word: str, place: Path) -> str:
    if not place.is_absolute():
        return word
    return str(place.relative_to(ROOT)) if place.is_relative_to(ROOT) else place.name


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
