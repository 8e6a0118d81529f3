"""Two commits, the same objects: `python perf/compare.py DIR BEFORE AFTER KEY ... --from ARCHIVES`.

Fetches the objects of catalogs/real.yaml into a workspace in DIR for each commit, builds both at preset quick
at the same time, with one job each, so that they share what else the machine does, and prints CPU seconds by
stage with their ratio, and both scores of each object. Run again, it continues.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from harness import ONE_THREAD, ROOT, parsed, write_record
from rich.console import Console
from rich.table import Table

from objectfolder.base.io import read_json

SCORES = {
    "vision": ("vision", "psnr", "dB", 1),
    "lit": ("vision", "psnr_lit_foreground", "dB", 1),
    "touch": ("touch", "psnr", "dB", 1),
    "gain error": ("audio", "gain_error", "%", 100),
}


def run(code: Path, workspace: Path, *arguments: object) -> subprocess.Popen:
    """Start `objectfolder` with the code of a checkout, in a workspace."""
    command = [sys.executable, "-c", "from objectfolder.cli import main; main()", *map(str, arguments)]
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(code)}
    return subprocess.Popen(command, cwd=workspace, env=environment, stdout=sys.stderr)


def prepare(folder: Path, commit: str, keys: list[str], archives: Path, renderer: str) -> tuple[Path, Path]:
    """Return a checkout of a commit, and a workspace with the objects; existing ones as they are."""
    code, workspace = folder / f"code-{commit}", folder / commit
    if not code.exists():
        subprocess.run(["git", "-C", ROOT, "worktree", "add", "--detach", code, commit], check=True)
    if not workspace.exists():
        workspace.mkdir(parents=True)
        run(code, workspace, "init", ".").wait()
        fetched = "fetch", "--catalogue", ROOT / "catalogs/real.yaml", "--from", archives, *keys
        if run(code, workspace, *fetched).wait():
            sys.exit(f"the objects could not be fetched from {archives}")
        values = workspace / "params.yaml"
        values.write_text(values.read_text().replace("renderer: mitsuba\n", f"renderer: {renderer}\n"))
    return code, workspace


def costs(workspace: Path, keys: list[str]) -> dict[str, float]:
    """Return the mean CPU seconds of the objects by stage."""
    total: dict[str, float] = {}
    for path in sorted((workspace / "build/.logs").glob("*@*.cost")):
        stage, key = path.stem.split("@")
        if key in keys:
            total[stage] = total.get(stage, 0.0) + read_json(path)["cpu_seconds"] / len(keys)
    return total


def scores(workspace: Path, key: str) -> dict[str, Any]:
    """Return the scores of an object, and its lowest frequencies in Hz."""
    metrics = read_json(workspace / "metrics" / f"{key}.json")
    found = {name: metrics[sense][score] * by for name, (sense, score, _, by) in SCORES.items()}
    return found | {"lowest_hz": read_json(workspace / "build" / key / "modal.json")["lowest_hz"]}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder to build in")
    parser.add_argument("before", help="commit")
    parser.add_argument("after", help="commit")
    parser.add_argument("keys", nargs="+", help="objects of catalogs/real.yaml")
    parser.add_argument("--from", dest="archives", type=Path, required=True, help="their archives")
    parser.add_argument("--renderer", default="mitsuba", help="of both (default: %(default)s)")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    folder, keys, console = arguments.folder.resolve(), arguments.keys, Console(width=120)
    names = {"before": arguments.before, "after": arguments.after}
    places = {
        name: prepare(folder, commit, keys, arguments.archives.resolve(), arguments.renderer)
        for name, commit in names.items()
    }
    builds = [run(*place, "build", "-j", 1) for place in places.values()]
    ends = [build.wait() for build in builds]
    if any(ends):
        sys.exit("a build failed")
    spent = {name: costs(workspace, keys) for name, (_, workspace) in places.items()}
    rows = [{"stage": stage} | {n: spent[n].get(stage, 0.0) for n in names} for stage in spent["before"]]
    rows.sort(key=lambda row: -row["before"])
    rows.append({"stage": "all"} | {name: sum(spent[name].values()) for name in names})
    table = Table("stage", "before", "after", "ratio", title=f"CPU s, mean of {len(keys)} objects")
    for row in rows:
        row["ratio"] = row["after"] / row["before"]
        table.add_row(row["stage"], *(f"{row[name]:.1f}" for name in names), f"{row['ratio']:.2f}")
    console.print(table)
    scored = []
    table = Table("object", *SCORES, "frequencies, %", title="before -> after")
    for key in keys:
        before, after = (scores(workspace, key) for _, workspace in places.values())
        low, moved = (np.array(each.pop("lowest_hz")) for each in (before, after))
        change = 100 * float(np.abs(moved / low - 1).max(initial=0)) if len(moved) == len(low) else np.nan
        scored.append({"object": key, "before": before, "after": after, "frequencies": change})
        table.add_row(key, *(f"{before[n]:.2f} -> {after[n]:.2f}" for n in SCORES), f"{change:.2f}")
    console.print(table)
    write_record(arguments.json, {"names": names, "stages": rows, "scores": scored})


if __name__ == "__main__":
    main()
