"""Thin, boxy and scanned objects at preset standard: `python perf/standard.py DIR [--scans FOLDER]`.

Adds the ten objects of catalogs/thin.yaml and the real meshes of FOLDER (one `mesh.*` in each subfolder,
those of perf/modal_reference.py) to a workspace of its own in DIR, builds them and prints their scores. An
object takes about ten CPU minutes. Run again, it continues. Rows of other objects in the file of `--json` are
kept. Exits with 1 if a target is missed.
"""

import argparse
from pathlib import Path
from typing import Any

from harness import ROOT, exit_with_verdict, parsed, write_record
from modal_reference import REAL
from rich.console import Console
from workspaces import OwnWorkspace, show_scores

from objectfolder.base.io import read_json
from objectfolder.base.yamlfile import read_yaml

THIN = ROOT / "catalogs/thin.yaml"
SEEN, FELT, GAIN_ERROR = 40.0, 43.0, 0.02  #: dB, dB, share
WINGED = ("gso_bunny_racer", "toy_airplane", "tin_glider")
BYTES = 1.3e6  #: of the Object Files of these, whose wings ask for fine grids


def misses(scores: dict[str, dict[str, Any]]) -> list[str]:
    """Return the objects beyond a target, with the figures that are."""
    missed = []
    for key, row in scores.items():
        seen, felt = row["vision"]["psnr_pooled"], row["touch"]["psnr"]
        error, size = row["audio"]["gain_error"], row["file_bytes"]
        beyond = [
            text
            for text, bad in (
                (f"seen {seen:.1f} dB", seen < SEEN),
                (f"felt {felt:.1f} dB", felt < FELT),
                (f"gain error {100 * error:.1f} %", error > GAIN_ERROR),
                (f"{size / 1e6:.2f} MB", key in WINGED and size > BYTES),
            )
            if bad
        ]
        if beyond:
            missed.append(f"{key}: {', '.join(beyond)}")
    return missed


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("workspace", type=Path, help="folder to build in")
    parser.add_argument("names", nargs="*", help="objects (default: all)")
    parser.add_argument("--scans", type=Path, help="folder of the real meshes")
    parser.add_argument("-j", "--jobs", type=int, default=1, help="stages at a time")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    console = Console()
    thin = list(read_yaml(THIN)["procedural"])
    names = arguments.names or [*thin, *(REAL if arguments.scans else ())]
    if unknown := [name for name in names if name not in {*thin, *(REAL if arguments.scans else ())}]:
        parser.error(f"unknown objects: {', '.join(unknown)}")
    workspace = OwnWorkspace(arguments.workspace)
    workspace.run("preset", "standard")
    workspace.edit({"render_views.renderer": "mitsuba-llvm", "modal.allow_uncertain": True})  # the racer
    if set(thin) - set(workspace.params()["objects"]):
        workspace.run("add", THIN)
    for name in names:
        if name not in workspace.params()["objects"]:
            material, scale = REAL[name]
            mesh = next((arguments.scans.resolve() / name).glob("mesh.*"))
            workspace.run("add", mesh, "--name", name, "--material", material, "--scale", scale)
    scores = workspace.build(names, arguments.jobs)
    failed = [name for name in names if name not in scores]
    show_scores(scores, failed, console)
    scores = {name: row | {"commit": workspace.commit()} for name, row in scores.items()}
    if arguments.json and arguments.json.exists():
        scores = read_json(arguments.json)["objects"] | scores
    missed = [f"{name} failed" for name in failed] + misses(scores)
    targets = (
        f"seen at least {SEEN:g} dB, felt at least {FELT:g} dB, gain error at most {GAIN_ERROR:.0%}, "
        f"files of toys with wings at most {BYTES / 1e6:g} MB"
    )
    record = {"preset": "standard", "seed": 0, "objects": dict(sorted(scores.items()))}
    write_record(arguments.json, record, targets, missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
