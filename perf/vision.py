"""Vision, object by object: `python perf/vision.py COMMAND [--workspace DIR] [KEY ...]`.

Every figure comes from a fresh process with one thread; seconds are CPU seconds. `renderers` (needs
`objectfolder build render_views`) draws the same views with every renderer that is installed: ms per image,
peak memory, and how far apart the pictures are. `training` (needs voxelize as well) trains the surface net
with the workspace's params.yaml; it scores the test views once, at the end. `query` (needs pack) times the
views of the Object File, beside a net of the paper's size. `noise` (needs pack) scores the Object File
against noisy test views and against ones with many samples. Exits with 1 if a target is missed.
"""

import argparse
import lzma
import resource
import tempfile
from functools import partial
from pathlib import Path

import harness
import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from objectfolder.base.arrays import read_npz, write_npz, write_png
from objectfolder.base.figures import tile
from objectfolder.base.metrics import psnr
from objectfolder.base.seeding import torch_generator
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.reading.load import AS_STORED, load_mesh
from objectfolder.nets.fit import Session
from objectfolder.objectfile.file import ObjectFile
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at, sphere_points
from objectfolder.vision.color import MIN_FOREGROUND_ALPHA, find_lit_foreground, on_white
from objectfolder.vision.evaluation import evaluate_vision
from objectfolder.vision.net_settings import VisionConfig
from objectfolder.vision.osf_net import OsfNet
from objectfolder.vision.query import LitCameras, view_images
from objectfolder.vision.renderers.registry import RENDERERS, make_renderer
from objectfolder.vision.scene import Scene
from objectfolder.vision.settings import RenderViewsConfig
from objectfolder.vision.surface_net import SurfaceNet
from objectfolder.vision.surface_training import train_surface
from objectfolder.vision.truth import Frames, render_frames
from objectfolder.vision.view import draw as draw_surface
from objectfolder.vision.volume import Rays
from objectfolder.workspace import params
from objectfolder.workspace.layout import SPLITS, Build

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "build" / "perf"
REFERENCE = "mitsuba"
TRAIN_VIEWS, TRAIN_SAMPLES, TEST_SAMPLES = 500, 16, 64
MAX_GROUND_TRUTH_SECONDS = 240.0  # of TRAIN_VIEWS views at TRAIN_SAMPLES
MAX_RENDERING_MB = 1024.0
REACHED_DB = 40.0  # of validation views: when training gets there is a figure
MAX_TRAINING_SECONDS = 60.0
MAX_TRAINING_MB = 3072.0
MIN_DB = {"psnr": 41.0, "psnr_worst": 34.0, "psnr_lit_foreground": 32.0}  # of test views
MAX_QUERY_MS = {"ms_single": 25.0, "ms_adaptive": 40.0}  # of a view at 256 x 256
CONVERGED_SAMPLES, NOISE_SEEDS = 512, 3
MAX_NOISE_DB = (0.1, 0.2)
TARGETS = {
    "renderers": f"mitsuba: {MAX_GROUND_TRUTH_SECONDS:g} s for {TRAIN_VIEWS} views; "
    f"all: {MAX_RENDERING_MB:g} MB",
    "training": f"{MAX_TRAINING_SECONDS:g} s, {MAX_TRAINING_MB:g} MB, "
    + ", ".join(f"{name} {limit:g} dB" for name, limit in MIN_DB.items()),
    "query": ", ".join(f"{name} {limit:g}" for name, limit in MAX_QUERY_MS.items()),
    "noise": f"{MAX_NOISE_DB[0]:g} dB from the score at {CONVERGED_SAMPLES} samples in the mean, "
    f"{MAX_NOISE_DB[1]:g} dB at most",
}
OSF_SAMPLES = (64, 128)  # the paper's (supplementary E), as is the shape
OSF_SHAPE = {"width": 256, "depth": 8, "branch_width": 128, "branch_depth": 4}
OSF_OCTAVES = {"point_octaves": 10, "direction_octaves": 4}
OSF_ROWS = 2  # of pixels that are timed
SHOWN = 6  # views in a picture


def cpu_seconds() -> float:
    """Of this process and those that it has started, as far as they have ended."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usage)


def peak_mb() -> float:
    return max(
        resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )


def draw(workspace: str, key: str, name: str, views: str, out: str) -> dict:
    """Render views in this process; the images go to a file.

    A renderer may work in another process, whose CPU time is known at its end: each number of samples gets
    its own renderer, and what it takes to start one is rendered apart and subtracted.
    """
    count = int(views)
    scene = Scene(load_mesh(Build(key, workspace).visual, "y", AS_STORED))
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


def train(workspace: str, key: str) -> dict:
    """Train the surface net in this process, then score it as it is stored.

    While it trains, PSNR is that of the validation loss in whole views: pooled, without the pixels at
    silhouettes and shadow edges, which the loss leaves out. In the end validation images, tiles or views, are
    scored before and after storing, and the test views once, as `evaluate` scores them.
    """
    torch.set_num_threads(1)
    build, values = Build(key, workspace), params.read(Path(workspace) / "params.yaml")
    config = params.settings(VisionConfig, values)
    views = {split: read_npz(build.views(split)) for split in SPLITS}
    # The loss is a mean over pixels that are covered fully; the background of whole views has no error.
    covered = float((views["test"]["rgba"][..., 3] >= MIN_FOREGROUND_ALPHA).mean())
    distances = read_npz(build.sdf, "values", "band")
    surface, scene = (
        Isosurface(DistanceGrid.from_arrays(distances)),
        Scene(load_mesh(build.visual, "y", AS_STORED)),
    )
    row: dict = {"object": key, "train_views": len(views["train"]["rgba"])}

    def report(point) -> None:
        row["steps"], row["seconds"] = point.step, cpu_seconds()
        if "steps_reached" not in row and psnr(covered * point.val_loss) >= REACHED_DB:
            row["steps_reached"], row["seconds_reached"] = row["steps"], row["seconds"]

    generator = torch_generator(values["seed"], key, "train_vision")
    net, _ = train_surface(
        surface, scene, views["train"], views["val"], config, Session(generator, report=report)
    )
    row |= {"seconds": cpu_seconds(), "peak_mb": peak_mb()}
    tensors, header = net.to_tensors()
    stored = SurfaceNet.from_tensors(tensors, header)
    row["net_kb"] = sum(t.nbytes for t in tensors.values()) / 1000
    row["geometry_kb"] = len(lzma.compress(distances["values"].tobytes())) / 1000

    def score(net: SurfaceNet, split: str) -> dict:
        return evaluate_vision(Shaded(surface, net), views[split])

    # Pooled: a mean over tiles would be that of the many without the object.
    row |= {"psnr_val": score(net, "val")["psnr_pooled"]}
    row |= {"psnr_val_stored": score(stored, "val")["psnr_pooled"]}
    return row | score(stored, "test")


class Shaded:
    """A surface and its net, which are viewed as an Object File."""

    def __init__(self, surface: Isosurface, net: SurfaceNet):
        self._drawer = partial(draw_surface, surface, net.shader(surface))

    def view(self, pose: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
        return view_images(self._drawer, LitCameras.checked(pose, light, (), intrinsics))


def noise(workspace: str, key: str) -> dict:
    """Score the views of an Object File in this process, against test views of few and of many samples."""
    torch.set_num_threads(1)
    build, config = (
        Build(key, workspace),
        params.settings(RenderViewsConfig, params.read(Path(workspace) / "params.yaml")),
    )
    scene = Scene(load_mesh(build.visual, "y", AS_STORED))
    renderer, whole = make_renderer(config.renderer, scene), Intrinsics.square(config.resolution)
    frames = Frames.views(config.test, whole, np.random.default_rng(0))
    file = ObjectFile.load(build.object_file)
    answers = file.view(frames.camera_to_world, frames.light, intrinsics=whole)

    def score(samples: int, seed: int, with_noise: bool = True) -> dict:
        views = render_frames(renderer, frames, samples, np.random.default_rng(seed), halves=True)
        if not with_noise:
            del views["noise"]
        return evaluate_vision(Answers(answers), views)

    expected = score(CONVERGED_SAMPLES, 0)
    found = [score(config.test_samples, 1 + seed) for seed in range(NOISE_SEEDS)]
    row = {"object": key, "samples": config.test_samples, "converged": expected["psnr"]}
    row |= {"lit_converged": expected["psnr_lit_foreground"]}
    for seed, scores in enumerate(found):
        row |= {f"difference_{seed}": scores["psnr"] - expected["psnr"]}
    row |= {"difference": float(np.mean([scores["psnr"] for scores in found])) - expected["psnr"]}
    lit = float(np.mean([scores["psnr_lit_foreground"] for scores in found]))
    row |= {"lit_difference": lit - expected["psnr_lit_foreground"]}
    row |= {"standard_error": float(np.mean([scores["psnr_standard_error"] for scores in found]))}
    row |= {"with_noise": score(config.test_samples, 1, with_noise=False)["psnr"] - expected["psnr"]}
    return row | {"noise": found[0]["noise_floor"], "views_at_least": found[0]["views_at_least"]}


class Answers:
    """Views that are drawn already, one after another."""

    def __init__(self, images: np.ndarray):
        self._images = iter(images)

    def view(self, pose: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
        return next(self._images)[None]


def query(workspace: str, key: str, count: str) -> dict:
    """Load an Object File and time its views in this process."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    cameras, lights = sphere_points(int(count), 2.5, rng), sphere_points(int(count), 1.0, rng)
    start = cpu_seconds()
    file = ObjectFile.load(Build(key, workspace).object_file)
    file.view(cameras[:1], lights[:1], resolution=1)  # extracts the surface
    row = {"object": key, "net": file.header["vision"]["kind"], "load_ms": 1000 * (cpu_seconds() - start)}
    for name, supersample in (("ms_single", False), ("ms_adaptive", True)):
        file.view(cameras[:1], lights[:1], supersample=supersample)
        start = cpu_seconds()
        file.view(cameras, lights, supersample=supersample)
        row[name] = 1000 * (cpu_seconds() - start) / len(cameras)
    return row | {"peak_mb": peak_mb()}


def query_osf() -> dict:
    """Time a net of the paper's size on a few rows of pixels in the middle of a view, in this process.

    It is untrained, and every ray through the cube costs the same: the view has as many times more of them.
    """
    torch.set_num_threads(1)
    torch.manual_seed(0)
    net = OsfNet(*OSF_SAMPLES, **OSF_SHAPE, **OSF_OCTAVES).eval()
    whole = Intrinsics()
    part = Intrinsics(whole.width, OSF_ROWS, whole.focal, center=(whole.cx, OSF_ROWS / 2))
    pose, light = look_at(np.array([2.0, 1.0, 1.2]))[0], np.array([0.5, 0.5, 0.7])
    rays = [rays_in_cube(pose, intrinsics) for intrinsics in (part, whole)]
    net.picture(pose, light, Intrinsics(8, 1, whole.focal))
    start = cpu_seconds()
    net.picture(pose, light, part)
    seconds = (cpu_seconds() - start) * rays[1] / rays[0]
    row = {"object": "any", "net": "osf", "rays_timed": rays[0], "rays": rays[1]}
    return row | {"ms_single": 1000 * seconds, "peak_mb": peak_mb()}


def rays_in_cube(pose: np.ndarray, intrinsics: Intrinsics) -> int:
    """How many pixels' rays a volume net has to look along."""
    rows, columns = np.mgrid[: intrinsics.height, : intrinsics.width] + 0.5
    rays = camera_rays(pose, intrinsics, np.stack([columns.ravel(), rows.ravel()], 1))
    met = Rays.through_cube(*map(torch.from_numpy, rays), BOUND)
    return int((met.far > met.near).sum())


def compare(truth: np.ndarray, other: np.ndarray) -> dict:
    """How far images (N, H, W, 4) are from the reference's, on white, in sRGB.

    Foreground is what either covers, lit foreground what the reference covers and lights.
    """
    a, b = (on_white(torch.from_numpy(x)).numpy().astype(np.float64) for x in (truth, other))
    foreground = (truth[..., 3] > 0) | (other[..., 3] > 0)
    lit = find_lit_foreground(truth)
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
            row = harness.fresh(__file__, "draw", workspace, key, name, count, out)
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


JOBS = {"draw": draw, "train": train, "query": query, "query_osf": query_osf, "noise": noise}


def show_renderers(rows: list[dict], console: Console) -> None:
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


TRAINING = {
    "object": ("object", ""),
    "train_views": ("images", ""),
    "steps_reached": ("steps to 40 dB", ""),
    "seconds_reached": ("CPU s", ".1f"),
    "steps": ("steps in all", ""),
    "seconds": ("CPU s", ".1f"),
    "peak_mb": ("peak MB", ".0f"),
    "net_kb": ("net kB", ".0f"),
    "geometry_kb": ("grid kB", ".0f"),
    "psnr_val": ("val. dB", ".2f"),
    "psnr_val_stored": ("stored", ".2f"),
    "psnr": ("test dB", ".2f"),
    "psnr_worst": ("worst", ".1f"),
    "psnr_lit_foreground": ("lit", ".1f"),
    "noise_floor": ("noise", ".1f"),
    "noise_floor_lit": ("lit noise", ".1f"),
    "baseline_white": ("white", ".1f"),
}
QUERY = {
    "object": ("object", ""),
    "net": ("net", ""),
    "load_ms": ("load ms", ".0f"),
    "ms_single": ("ms, 1 sample", ".1f"),
    "ms_adaptive": ("ms, adaptive", ".1f"),
    "peak_mb": ("peak MB", ".0f"),
}
NOISE = {
    "object": ("object", ""),
    "samples": ("samples", ""),
    "converged": (f"dB, {CONVERGED_SAMPLES} samples", ".2f"),
    **{f"difference_{seed}": (f"seed {seed}", "+.2f") for seed in range(NOISE_SEEDS)},
    "standard_error": ("std. error", ".2f"),
    "views_at_least": ("at least", ""),
    "with_noise": ("with noise", "+.2f"),
    "noise": ("noise dB", ".1f"),
    "lit_converged": ("lit dB", ".2f"),
    "lit_difference": ("lit", "+.2f"),
}


def show_query(rows: list[dict], console: Console) -> None:
    harness.print_rows(rows, "CPU ms per view of 256 x 256", QUERY, console)
    for row in (row for row in rows if "rays" in row):
        timed = f"{row['rays_timed']} of {row['rays']} rays timed, extrapolated"
        console.print(f"osf: the paper's size, untrained; {timed}", markup=False, soft_wrap=True)


def misses_training(rows: list[dict]) -> list[str]:
    """Targets that are missed; an object that fails misses."""
    missed = harness.failures(rows) + harness.beyond(rows, {"seconds": MAX_TRAINING_SECONDS}, "s")
    missed += harness.beyond(rows, {"peak_mb": MAX_TRAINING_MB}, "MB")
    return missed + harness.beyond(rows, MIN_DB, "dB", least=True)


def misses_noise(rows: list[dict]) -> list[str]:
    """Targets that are missed: the mean over all scores, and each score."""
    scored = [row for row in rows if "difference" in row]
    names = [f"difference_{seed}" for seed in range(NOISE_SEEDS)]
    mean = float(np.mean([row[name] for row in scored for name in names])) if scored else np.nan
    missed = harness.failures(rows)
    missed += [f"mean: {mean:+.2f} dB, target {MAX_NOISE_DB[0]:g} dB"] if abs(mean) > MAX_NOISE_DB[0] else []
    for row in scored:
        worst = max((row[name] for name in names), key=abs)
        if abs(worst) > MAX_NOISE_DB[1]:
            missed.append(f"{row['object']}: {worst:+.2f} dB, target {MAX_NOISE_DB[1]:g} dB")
    return missed


def misses_query(rows: list[dict]) -> list[str]:
    """Targets that are missed; the net of the paper's size has none."""
    rows = [row for row in rows if row.get("net") != "osf"]
    return harness.failures(rows) + harness.beyond(rows, MAX_QUERY_MS, "ms")


def misses_renderers(rows: list[dict]) -> list[str]:
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
    harness.run_job(JOBS)
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, text in (
        ("renderers", "time and compare the renderers"),
        ("training", "time the training of the surface net"),
        ("query", "time views of Object Files"),
        ("noise", "score Object Files against noisy and converged views"),
    ):
        command = commands.add_parser(name, help=text)
        harness.add_objects(command)
        if name in ("renderers", "query"):
            command.add_argument("--views", type=int, default=12, help="drawn by each")
    arguments = harness.parsed(parser)
    workspace, command, keys = arguments.workspace, arguments.command, harness.chosen_objects(arguments)
    console = Console(width=max(Console().width, 180))
    if command == "renderers":
        rows = [row for key in keys for row in renderers(workspace, key, arguments.views)]
        missed = misses_renderers(rows)
        show_renderers(rows, console)
    elif command == "training":
        rows = [{"object": key} | harness.fresh(__file__, "train", workspace, key) for key in keys]
        missed = misses_training(rows)
        harness.print_rows(rows, "Training of the surface net, and its PSNR", TRAINING, console)
    elif command == "noise":
        rows = [{"object": key} | harness.fresh(__file__, "noise", workspace, key) for key in keys]
        missed = misses_noise(rows)
        harness.print_rows(rows, "PSNR of views against noisy and converged ones", NOISE, console)
    else:
        asked = [(key, harness.fresh(__file__, "query", workspace, key, arguments.views)) for key in keys]
        rows = [{"object": key} | row for key, row in asked]
        rows.append({"object": "any", "net": "osf"} | harness.fresh(__file__, "query_osf"))
        missed = misses_query(rows)
        show_query(rows, console)
    harness.write_record(arguments.json, {command: rows}, TARGETS[command], missed)
    harness.exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
