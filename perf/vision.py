"""Vision, object by object: `python perf/vision.py renderers [--workspace DIR] [KEY ...]`.

Needs `objectfolder build render_views`. `renderers` draws the same views with every renderer that is
installed, each in a fresh process with one thread: CPU ms per image, peak memory, and how far apart the
pictures are. Seconds are CPU seconds. Exits with 1 if a target is missed.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from objectfolder import params
from objectfolder.artifacts import Build, atomic, read_npz, write_npz, write_png
from objectfolder.contact_sheet import tile
from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.load import load_mesh
from objectfolder.metrics import psnr
from objectfolder.vision.cameras import Intrinsics, look_at, sphere_points
from objectfolder.vision.color import on_white
from objectfolder.vision.renderers.registry import RENDERERS, make_renderer
from objectfolder.vision.scene import Scene

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "build" / "perf"
REFERENCE = "mitsuba"
TRAIN_VIEWS, TRAIN_SAMPLES, TEST_SAMPLES = 500, 16, 64
MAX_GROUND_TRUTH_SECONDS = 240.0  # of TRAIN_VIEWS views at TRAIN_SAMPLES
MAX_RENDERING_MB = 1024.0
SHOWN = 6  # views in a picture
LIT = 0.01  # radiance, relative to white
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def cpu_seconds() -> float:
    """Of this process and those that it has started, as far as they have ended."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usage)


def peak_mb() -> float:
    return max(
        resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )


def draw(workspace: Path, key: str, name: str, count: int, out: Path) -> dict:
    """Render views in this process; the images go to a file.

    A renderer may work in another process, whose CPU time is known at its end: each number of samples gets
    its own renderer, and what it takes to start one is rendered apart and subtracted.
    """
    scene = Scene(load_mesh(Build(key, workspace).visual, up="y"))
    rng = np.random.default_rng(0)
    poses, lights = look_at(sphere_points(count, 2.5, rng)), sphere_points(count, 1.0, rng)
    intrinsics, row, images = Intrinsics(), {"object": key, "renderer": name}, []

    def seconds(samples: int, views: int) -> float:
        start = cpu_seconds()
        renderer = make_renderer(name, scene)
        row["version"] = renderer.version
        images[:] = [
            renderer.render(poses[i], lights[i], intrinsics, samples, i) for i in [0, *range(views)]
        ][1:]  # the first one compiles and uploads
        del renderer
        return cpu_seconds() - start

    seconds(TRAIN_SAMPLES, 0)  # loads libraries and compiles kernels
    for samples in (TRAIN_SAMPLES, TEST_SAMPLES):
        started = seconds(samples, 0)
        row[f"ms_{samples}"] = 1000 * (seconds(samples, count) - started) / count
    write_npz(out, rgba=np.stack(images))
    return row | {"peak_mb": peak_mb()}


def compare(truth: np.ndarray, other: np.ndarray) -> dict:
    """How far images (N, H, W, 4) are from the reference's, on white, in sRGB.

    Foreground is what either covers, lit foreground what the reference covers and lights.
    """
    a, b = (on_white(torch.from_numpy(x)).numpy().astype(np.float64) for x in (truth, other))
    foreground = (truth[..., 3] > 0) | (other[..., 3] > 0)
    lit = (truth[..., 3] >= 0.999) & (truth[..., :3].max(-1) > LIT)
    squared = (a - b) ** 2
    return {
        "psnr_foreground": float(psnr(squared[foreground].mean())),
        "psnr_lit_foreground": float(psnr(squared[lit].mean())),
        "difference_foreground": float((b - a)[foreground].mean()),
        "difference_lit_foreground": float((b - a)[lit].mean()),
        "alpha_apart": float(np.abs(truth[..., 3] - other[..., 3]).mean()),
    }


def renderers(workspace: Path, key: str, count: int) -> list[dict]:
    """Rows of every renderer; those that cannot run here say why. Writes a picture of those that can."""
    rows, drawn = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for name in RENDERERS:
            out = Path(folder) / f"{name}.npz"
            row = fresh("draw", str(workspace), key, name, str(count), str(out))
            if out.exists():
                drawn[name] = read_npz(out, "rgba")["rgba"]
            rows.append({"object": key, "renderer": name, **row})
    for row in rows:
        if {row["renderer"], REFERENCE} <= drawn.keys() and row["renderer"] != REFERENCE:
            row |= compare(drawn[REFERENCE], drawn[row["renderer"]])
    # A row of views for each renderer, then its errors, four times enlarged.
    shown = {name: on_white(torch.from_numpy(rgba[:SHOWN])).numpy() for name, rgba in drawn.items()}
    sheets = list(shown.values())
    sheets += [
        1 - np.clip(4 * np.abs(image - shown[REFERENCE]), 0, 1)
        for name, image in shown.items()
        if name != REFERENCE and REFERENCE in shown
    ]
    picture = (np.concatenate(sheets) * 255).round().astype(np.uint8)
    write_png(PICTURES / f"renderers_{key}.png", tile(picture, columns=min(SHOWN, count)))
    return rows


def fresh(job: str, *arguments: str) -> dict:
    """Run a job of this file in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "job", job, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **dict.fromkeys(THREADS, "1")},
    )
    if done.returncode:
        return {"failed": (done.stderr.strip().splitlines() or [f"ended with {done.returncode}"])[-1]}
    return json.loads(done.stdout.splitlines()[-1])


def run_job(job: str, *arguments: str) -> None:
    """Child's side of `fresh`."""
    workspace, key, name, count, out = arguments
    try:
        print(json.dumps({"draw": draw}[job](Path(workspace), key, name, int(count), Path(out))))
    except ObjectFolderError as error:
        sys.exit(str(error))


def show(rows: list[dict], console: Console) -> None:
    table = Table(title=f"Renderers at 256 x 256; PSNR against {REFERENCE} at {TEST_SAMPLES} samples")
    titles = ("object", "renderer", f"CPU ms, {TRAIN_SAMPLES}", f"CPU ms, {TEST_SAMPLES}", "peak MB")
    for title in (*titles, "foreground dB", "lit dB", "mean diff.", "lit diff."):
        table.add_column(title, justify="left" if title in titles[:2] else "right", no_wrap=True)
    for row in (row for row in rows if "failed" not in row):
        shown = [row["object"], row["version"]]
        shown += [f"{row[f'ms_{samples}']:.0f}" for samples in (TRAIN_SAMPLES, TEST_SAMPLES)]
        shown += [f"{row['peak_mb']:.0f}"]
        if "psnr_foreground" in row:
            shown += [f"{row['psnr_foreground']:.1f}", f"{row['psnr_lit_foreground']:.1f}"]
            shown += [f"{row['difference_foreground']:+.4f}", f"{row['difference_lit_foreground']:+.4f}"]
        table.add_row(*shown)
    console.print(table)
    for name, reason in {row["renderer"]: row["failed"] for row in rows if "failed" in row}.items():
        console.print(f"left out: {name}: {reason}", markup=False, soft_wrap=True)


def misses(rows: list[dict]) -> list[str]:
    """Targets that are missed; a renderer that is not installed is none, but the default one is."""
    missed = []
    for row in rows:
        where = f"{row['object']}, {row['renderer']}"
        if "failed" in row:
            missed += [f"{where}: {row['failed']}"] if row["renderer"] == REFERENCE else []
            continue
        seconds = TRAIN_VIEWS * row[f"ms_{TRAIN_SAMPLES}"] / 1000
        if row["renderer"] == REFERENCE and seconds > MAX_GROUND_TRUTH_SECONDS:
            missed.append(f"{where}: {seconds:.0f} s, target {MAX_GROUND_TRUTH_SECONDS:g} s")
        if row["peak_mb"] > MAX_RENDERING_MB:
            missed.append(f"{where}: {row['peak_mb']:.0f} MB, target {MAX_RENDERING_MB:g} MB")
    return missed


def main() -> None:
    if sys.argv[1:2] == ["job"]:  # from `fresh`
        run_job(*sys.argv[2:])
        return
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    command = commands.add_parser("renderers", help="time and compare the renderers")
    command.add_argument("keys", nargs="*", help="objects (default: all of params.yaml)")
    command.add_argument("--workspace", type=Path, default=ROOT, help="holds params.yaml and build/")
    command.add_argument("--views", type=int, default=12, help="rendered by each")
    command.add_argument("--json", type=Path, help="also write the figures here")
    arguments = parser.parse_args()
    keys = arguments.keys or list(params.read(arguments.workspace / "params.yaml")["objects"])
    console = Console(width=max(Console().width, 140))
    rows = [row for key in keys for row in renderers(arguments.workspace, key, arguments.views)]
    show(rows, console)
    if arguments.json:
        with atomic(arguments.json) as path:
            path.write_text(json.dumps({"renderers": rows}, indent=2) + "\n")
    missed = misses(rows)
    console.print("targets: " + ("; ".join(missed) or "met"), markup=False, soft_wrap=True)
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
