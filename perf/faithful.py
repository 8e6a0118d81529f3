"""Table 2 of the paper for two families of nets: `python perf/faithful.py --workspace DIR bell mug die`.

Builds objects with preset faithful-small in a workspace of its own: first with the paper's nets, then with
the default nets on the same views, modes and touches. Prints their scores on held-out data beside trivial
answers, with means over the objects, and how far the paper's nets were trained. Run again, it continues; a
killed training does, too.

Options give the paper's nets fewer steps than the preset, and score fewer answers, where there is less time.
"""

import argparse
import csv
import json
import re
import time
from pathlib import Path
from statistics import mean
from typing import Any

import torch
from harness import parsed, write_record
from rich.console import Console
from rich.table import Table
from workspaces import OwnWorkspace

from objectfolder.base.arrays import read_npz
from objectfolder.base.io import read_json, write_json
from objectfolder.benchmarks.reporting.published import PSNR
from objectfolder.engine.records import recall_costs
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.nets.positional import PointwiseNetwork, train_in
from objectfolder.vision.cameras import camera_rays, image_intrinsics
from objectfolder.vision.osf_net import OsfNet, pixel_centres
from objectfolder.vision.visual_hull import visual_hull
from objectfolder.vision.volume import Rays
from objectfolder.workspace.layout import MODALITIES, Build

PRESET = "faithful-small"
#: Of each sense: the section of the paper's net, its name and the default net's, the trivial answer's score.
NETS = {
    "vision": ("osf", "surface", "baseline_white"),
    "audio": ("spectrogram", "gains", "baseline_silence"),
    "touch": ("image", "geometric", "baseline_mean_image"),
}
PAPER_STEPS = 500_000  #: of preset faithful; the supplementary states none
PAPER_BATCH = {"vision": 1024, "audio": 16384, "touch": 16384}  #: rays, bins and pixels of faithful's steps
FAMILIES = ("paper", "default")
ROWS = 2048  #: of a pass that is timed


def family_nets(family: str) -> dict[str, str]:
    """Return the settings that choose a family of nets."""
    return {f"train_{sense}.net": NETS[sense][family == "default"] for sense in MODALITIES}


def hours(folder: Path, sense: str, key: str, family: str) -> float:
    """Return the CPU hours of a training, from its log.

    That of a default net has phases that its log does not time: theirs are those of the whole stage.
    """
    stage = f"train_{sense}"
    cost = recall_costs(folder, key).get(stage)
    if family == "default" and cost:
        return cost.cpu_seconds / 3600
    log = (folder / "build" / ".logs" / f"{stage}@{key}.log").read_text()
    return float(re.findall(r"([\d.]+) s$", log, re.MULTILINE)[-1]) / 3600


def trained(workspace: OwnWorkspace, family: str, keys: list[str], jobs: int) -> dict[str, Any]:
    """Build the objects with a family of nets; return scores, hours and curves, kept in the workspace."""
    kept = workspace.folder / "perf-faithful" / f"{family}.json"
    identity = json.dumps(workspace.params(), sort_keys=True, default=str)
    found = read_json(kept) if kept.is_file() else {}
    if found.get("identity") != identity:
        found = {"identity": identity, "objects": {}}
    missing = [key for key in keys if key not in found["objects"]]
    for key in missing:  # one by one: what is built is kept
        scores = workspace.build([key], jobs)
        if key in scores:
            build = Build(key, workspace.folder)
            found["objects"][key] = {
                "scores": scores[key],
                "hours": {sense: hours(workspace.folder, sense, key, family) for sense in MODALITIES},
                "curves": {sense: curve(build.curve(sense)) for sense in MODALITIES},
            }
            write_json(kept, found)
    return dict(found["objects"])


def curve(path: Path) -> list[list[float]]:
    """Return the rows of a training curve: step, training loss, validation loss."""
    with path.open() as stream:
        return [[float(value) for value in row] for row in list(csv.reader(stream))[1:]]


def rows_of(objects: dict[str, dict[str, Any]], batch: dict[str, int]) -> list[dict[str, Any]]:
    """Return the table: a row for each sense and object, and for the mean over the objects that both have."""
    keys = [key for key in objects["paper"] if key in objects["default"]]
    rows = []
    for sense in MODALITIES:
        trivial = NETS[sense][2]
        found = []
        for key in keys:
            paper, default = (objects[family][key] for family in FAMILIES)
            steps = int(paper["curves"][sense][-1][0])
            found.append(
                {
                    "sense": sense,
                    "object": key,
                    "paper_net": paper["scores"][sense]["psnr"],
                    "default_net": default["scores"][sense]["psnr"],
                    "trivial": paper["scores"][sense][trivial],
                    "steps": steps,
                    "of_papers_steps": steps / PAPER_STEPS,
                    "drawn": steps * batch[sense],
                    "of_papers_drawn": steps * batch[sense] / (PAPER_STEPS * PAPER_BATCH[sense]),
                    "hours": paper["hours"][sense],
                    "default_hours": default["hours"][sense],
                }
            )
        rows += found
        if found:
            numbers = [name for name in found[0] if name not in ("sense", "object")]
            rows.append(
                {"sense": sense, "object": "mean"}
                | {name: mean(row[name] for row in found) for name in numbers}
            )
            rows[-1]["paper"] = PSNR.figures[sense][0]
    return rows


def speed() -> dict[str, float]:
    """Return the CPU microseconds of a forward and a backward pass of the paper's 8 x 256 layers, per row."""
    torch.set_num_threads(1)
    net, found = PointwiseNetwork(256, 8, 10, 10, outputs=3), {}
    for precision in ("float32", "bfloat16"):
        train_in(net, precision)
        times = []
        for _ in range(12):
            start = time.process_time()
            net(torch.rand(ROWS, 5)).square().sum().backward()
            times.append(time.process_time() - start)
        found[precision] = 1e6 * min(times) / ROWS
    return found


def step_seconds(workspace: OwnWorkspace, key: str, values: dict[str, Any]) -> dict[str, float]:
    """Return the CPU seconds of a step of an untrained VisionNet, with the preset's hull and without."""
    osf = values["train_vision"]["osf"]
    names = ("width", "depth", "branch_width", "branch_depth", "point_octaves", "direction_octaves")
    shape = {name: osf[name] for name in ("coarse_samples", "fine_samples", *names)}
    views = read_npz(
        Build(key, workspace.folder).views("train"), "rgba", "camera_to_world", "light", "focal", "center"
    )
    intrinsics = image_intrinsics(views)[0]
    found = camera_rays(views["camera_to_world"][0], intrinsics, pixel_centres(intrinsics))
    rays = Rays.through_cube(*map(torch.from_numpy, found), BOUND)
    rays = rays[rays.far > rays.near]
    light = torch.from_numpy(views["light"][:1].astype("float32")).expand(64, 3)
    torch.set_num_threads(1)
    times = {}
    for cells in (0, osf["hull_cells"]):
        net, generator = OsfNet(hull_cells=cells, **shape), torch.Generator().manual_seed(0)
        if net.hull is not None:
            net.hull = torch.from_numpy(visual_hull(views, cells, BOUND))
        train_in(net, osf["precision"])
        taken = []
        for _ in range(8):
            drawn = torch.randint(len(rays.near), (64,), generator=generator)
            start = time.process_time()
            sum(seen.sum() for seen in net(rays[drawn], light, generator)).backward()
            taken.append(time.process_time() - start)
        times["with" if cells else "without"] = sum(taken[2:]) / len(taken[2:]) * osf["batch"] / 64
    return times


def draw(objects: dict[str, dict[str, Any]], path: Path) -> None:
    """Draw the validation losses of the paper's nets over their steps, one panel for each sense."""
    from objectfolder.base.figures import page, save_page

    sheet = page(9.6, 2.8, "")
    for place, sense in enumerate(MODALITIES, 1):
        axes = sheet.add_subplot(1, 3, place)
        for key, found in objects.items():
            axes.plot(*zip(*[(row[0], row[2]) for row in found["curves"][sense]]), label=key)
        axes.set(
            title=f"{sense}: {NETS[sense][0]}",
            xlabel="step",
            yscale="log",
            ylabel="validation loss" if place == 1 else "",
        )
    sheet.legend(*axes.get_legend_handles_labels(), loc="outside right center")
    save_page(sheet, path)


def show(rows: list[dict[str, Any]], console: Console) -> None:
    names = (
        "sense",
        "object",
        "paper_net",
        "default_net",
        "trivial",
        "of_papers_steps",
        "hours",
        "default_hours",
    )
    table = Table(*names)
    for row in rows:
        table.add_row(
            *(f"{row[name]:.3g}" if isinstance(row[name], float) else str(row[name]) for name in names)
        )
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("keys", nargs="+", help="objects of catalogs/starter.yaml")
    parser.add_argument("--workspace", type=Path, required=True, help="made if it does not exist")
    parser.add_argument("-j", "--jobs", type=int, default=1, help="stages at a time")
    for sense in MODALITIES:
        parser.add_argument(f"--{sense}-steps", type=int, help="of the paper's net; default: the preset's")
    parser.add_argument("--rays", type=int, help="in a step of VisionNet; default: the preset's")
    parser.add_argument("--views", type=int, help="held-out views that are scored; default: the preset's")
    parser.add_argument("--impacts", type=int, help="held-out sounds that are scored; default: the preset's")
    parser.add_argument("--touches", type=int, help="held-out touches that are scored; default: the preset's")
    parser.add_argument("--trained-on", help="the device, where another machine trained the checkpoints")
    parser.add_argument("--picture", type=Path, help="draw the learning curves here")
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parsed(parser)
    workspace = OwnWorkspace(arguments.workspace)
    workspace.run("add", "catalogs/starter.yaml")
    workspace.run("preset", PRESET)
    chosen = {f"train_{s}.{NETS[s][0]}.steps": getattr(arguments, f"{s}_steps") for s in MODALITIES}
    chosen |= {"render_views.test": arguments.views, "evaluate.impacts": arguments.impacts}
    chosen |= {"render_touch.test": arguments.touches, "train_vision.osf.batch": arguments.rays}
    workspace.edit({place: value for place, value in chosen.items() if value is not None})
    objects = {}
    for family in FAMILIES:
        workspace.edit(family_nets(family))
        objects[family] = trained(workspace, family, arguments.keys, arguments.jobs)
    values = workspace.params()
    batch = {sense: values[f"train_{sense}"][NETS[sense][0]]["batch"] for sense in MODALITIES}
    rows = rows_of(objects, batch)
    show(rows, Console())
    if arguments.picture:
        draw(objects["paper"], arguments.picture)
    failed = [f"{key} failed" for key in arguments.keys if any(key not in objects[f] for f in FAMILIES)]
    missed = failed + [
        f"{row['sense']} {row['paper_net']:.1f} dB, the paper has {row['paper']}"
        for row in rows
        if row["object"] == "mean" and row["paper_net"] < row["paper"]
    ]
    scored = {"views": values["render_views"]["test"], "impacts": values["evaluate"]["impacts"]}
    scored |= {"touches": values["render_touch"]["test"]}
    record: dict[str, Any] = {"preset": PRESET, "scored": scored, "rows": rows}
    if arguments.trained_on:
        record["trained_on"] = arguments.trained_on
    record |= {"rays": batch["vision"], "paper_steps": PAPER_STEPS}
    record |= {"speed": speed(), "workspace_commit": workspace.commit()}
    record["vision_step"] = {key: step_seconds(workspace, key, values) for key in objects["paper"]}
    least = " / ".join(PSNR.cells(sense)[0] for sense in PSNR.figures)
    write_record(arguments.json, record, f"mean of the paper's nets: {least} dB", missed)
    raise SystemExit(bool(missed))


if __name__ == "__main__":
    main()
