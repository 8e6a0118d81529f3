"""Workspaces in which measuring scripts build objects: a clone of the repository, with a preset."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from harness import ROOT
from rich.console import Console
from rich.table import Table
from ruamel.yaml import YAML

from objectfolder.base.io import read_json
from objectfolder.objectfile.evaluation import summary_row
from objectfolder.workspace.layout import Build

_COMMAND = "from objectfolder.cli import main; main()"


class OwnWorkspace:
    """A clone of the committed state of the repository; an existing one is used again as it is.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path):
        self.folder = folder.resolve()
        if not (self.folder / "dvc.yaml").is_file():
            subprocess.run(["git", "clone", "--quiet", ROOT, self.folder], check=True)
            self.edit({"objects": {}, "procedural": {}})

    def run(self, *arguments: object, check: bool = True) -> int:
        """Run `objectfolder` with the clone's code; return its exit status."""
        environment = {**os.environ, "PYTHONPATH": str(self.folder)}
        command = [sys.executable, "-c", _COMMAND, *map(str, arguments)]
        return subprocess.run(command, cwd=self.folder, env=environment, check=check).returncode

    def commit(self) -> str:
        """Return the commit of the clone's code."""
        command = ["git", "-C", str(self.folder), "rev-parse", "--short=7", "HEAD"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    def params(self) -> dict[str, Any]:
        """Return the content of params.yaml."""
        content: dict[str, Any] = YAML(typ="safe").load(self.folder / "params.yaml")
        return content

    def edit(self, changes: dict[str, Any]) -> None:
        """Set values in params.yaml, by the path of the field with dots between names."""
        yaml = YAML()
        path = self.folder / "params.yaml"
        document = yaml.load(path)
        for place, value in changes.items():
            *outer, last = place.split(".")
            section = document
            for name in outer:
                section = section[name]
            section[last] = value
        yaml.dump(document, path)

    def build(self, keys: Sequence[str], jobs: int) -> dict[str, dict[str, Any]]:
        """Build objects; return the scores of those that succeeded."""
        for key in keys:
            Build(key, self.folder).metrics.unlink(missing_ok=True)  # restored if it is up to date
        self.run("build", *keys, "--keep-going", "-j", jobs, check=False)
        found = {key: Build(key, self.folder).metrics for key in keys}
        return {key: read_json(path) for key, path in found.items() if path.is_file()}


def show_scores(scores: dict[str, dict[str, Any]], failed: Sequence[str], console: Console) -> None:
    """Print the table of scores at the end of a build, with a row for each object that failed."""
    rows = [summary_row(key, metrics) for key, metrics in scores.items()]
    table = Table(*(rows[0] if rows else ("object",)))
    for row in rows:
        table.add_row(*row.values())
    for key in failed:
        table.add_row(key, "failed")
    console.print(table)
