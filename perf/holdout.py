"""Objects that the project has never seen: `python perf/holdout.py DIR --material wood [--json FILE]`.

Adds all meshes of a folder (each file, or each subfolder with a mesh; materials.csv in it gives each its own
material) to a workspace of its own, builds them with a preset and prints their scores beside trivial answers,
with means over the objects. Objects that cannot be added or built are rows, too. Run again, it continues.
"""

import argparse
from pathlib import Path
from statistics import mean
from typing import Any

from harness import parsed, write_record
from rich.console import Console
from rich.table import Table
from workspaces import OwnWorkspace, show_scores

from objectfolder.workspace.discover import discover

#: Figures of the report: sense, score, score of the trivial answer beside it, its name.
FIGURES = (
    ("vision", "psnr", "baseline_white", "white"),
    ("vision", "psnr_lit_foreground", None, ""),
    ("audio", "psnr", "baseline_silence", "silence"),
    ("audio", "gain_error", "baseline_nearest", "nearest point"),
    ("touch", "psnr", "baseline_mean_image", "mean image"),
)


def means(scores: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the means over objects of each figure and of its trivial answer; silent ones have no sound."""
    rows = []
    for sense, name, baseline, title in FIGURES:
        have = [metrics[sense] for metrics in scores.values() if name in metrics[sense]]
        if have:
            row = {"score": f"{sense} {name}", "mean": mean(h[name] for h in have), "objects": len(have)}
            if baseline:
                row |= {"beside": title, "baseline": mean(h[baseline] for h in have)}
            rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of meshes")
    parser.add_argument("--material", help="of the objects that materials.csv does not name")
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--workspace", type=Path, help="default: a folder beside the meshes, NAME.workspace")
    parser.add_argument("-j", "--jobs", type=int, default=1, help="stages at a time")
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parsed(parser)
    console = Console()
    folder = arguments.folder.resolve()
    workspace = OwnWorkspace(arguments.workspace or folder.with_name(f"{folder.name}.workspace"))
    workspace.run("preset", arguments.preset)
    keys = [candidate.key for candidate in discover(folder, arguments.material)]
    if set(keys) - set(workspace.params()["objects"]):
        options = ("--material", arguments.material) if arguments.material else ()
        workspace.run("add", folder, *options, check=False)
    added = [key for key in keys if key in workspace.params()["objects"]]
    scores = workspace.build(added, arguments.jobs)
    refused = [key for key in keys if key not in added]
    failed = [key for key in added if key not in scores]
    show_scores(scores, [*refused, *failed], console)
    table = Table("score", "mean", "beside", "its mean", "objects")
    rows = means(scores)
    for row in rows:
        beside = (row["beside"], f"{row['baseline']:.3g}") if "beside" in row else ("", "")
        table.add_row(row["score"], f"{row['mean']:.3g}", *beside, str(row["objects"]))
    console.print(table)
    missed = [f"{key} refused" for key in refused] + [f"{key} failed" for key in failed]
    record = {"preset": arguments.preset, "objects": scores, "means": rows}
    write_record(arguments.json, record, "every object is added and built", missed)
    raise SystemExit(bool(missed))


if __name__ == "__main__":
    main()
