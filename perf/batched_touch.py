"""Touches in batches: `python perf/batched_touch.py KEY ... [--workspace DIR] [--json FILE]`.

Agreement of `BatchedTouch` with `ObjectFile.press` over the objects of a workspace, ms a touch in batches of
1, 64, 256 and 1,024 of the first of them, on CPU threads and on a GPU where there is one, next to single
presses and to the lookup of colours of Taxim's renderer in the same run, and what a GPU computes, reads and
starts at most.
A key that is not built there, such as mug, stands for an Object File of the package. Exits with 1 if a target
is missed.
Takes four minutes with twenty objects and the defaults; on a GPU it needs the extra batch, and no network.
"""

import argparse
import math
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from harness import ROOT, exit_with_verdict, fresh, parsed, print_rows, require, run_job, write_record
from rich.console import Console
from torch.multiprocessing.reductions import StorageWeakRef
from torch.utils._python_dispatch import TorchDispatchMode

from objectfolder import ObjectFile
from objectfolder.objectfile.samples import file_or_sample
from objectfolder.sim.batched_touch import BatchedTouch
from objectfolder.touch.batched_gel import GelBatch
from objectfolder.touch.batched_slip import SlipBatch
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import load_profile
from objectfolder.touch.taxim import BINS, color_table

SENSOR, BATCHES = "digit", (1, 64, 256, 1024)
TARGETS = {"worst_db": 40.0, "mean_db": 50.0, "force": 0.01, "flow": 0.05, "ratio": 0.6, "gpu_ms": 0.5}
MEMORY = 8e9  #: bytes, at most, of the largest batch
#: Of an H200: bytes/s, at the 70 % that long elementwise kernels reach, and flop/s; of an assumed 1e9 rays/s
#: by Warp; seconds of a kernel's launch.
H200 = {"bytes": 0.7 * 4.8e12, "flops": 60e12, "rays": 1e9, "launch": 5e-6}


def contacts(file: ObjectFile, count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Draw contacts as a user would, of which each second moves."""
    points, profile = file.sample_surface(count), load_profile(SENSOR)
    moves = np.arange(count) % 2
    return {
        "points": points,
        "normals": file.contact_normals(points),
        "angle": rng.uniform(0, 2 * np.pi, count),
        "depth": rng.uniform(*profile.press_depth, count),
        "shear": rng.uniform(-5e-4, 5e-4, (count, 2)) * moves[:, None],
        "twist": rng.uniform(-0.1, 0.1, count) * moves,
    }


def agreement(path: str, count: str) -> dict:
    """Compare a batch with single presses of an Object File, in this process."""
    torch.set_num_threads(1)
    file = ObjectFile.load(path)
    touch = BatchedTouch(file, SENSOR, _best_device())
    drawn = contacts(file, int(count), np.random.default_rng(0))
    names = ("points", "angle", "depth", "shear", "twist")
    singles = [
        file.press(**{name: drawn[name][k : k + 1] for name in names}, sensor=SENSOR)
        for k in range(int(count))
    ]
    found = touch.press(0, **drawn)
    images, force, flow = (
        np.concatenate([getattr(single, name) for single in singles])
        for name in ("images", "force", "marker_flow")
    )
    error = ((found.images.cpu().numpy().astype(float) - images) ** 2).mean((1, 2, 3)) / 255**2
    normal = found.wrench[:, 0].cpu().numpy()
    pressed = force > 0
    return {
        "object": file.key,
        "contacts": int(count),
        "obstructed": int((found.obstructed > 0).sum()),
        "untouched": int((~pressed).sum()),
        "mean_db": float(-10 * np.log10(max(error.mean(), 1e-12))),
        "worst_db": float(-10 * np.log10(max(error.max(), 1e-12))),
        "force": float(np.abs(normal[pressed] / force[pressed] - 1).max(initial=0)),
        "force_where_none": float(np.abs(normal[~pressed]).max(initial=0)),
        "flow": float(np.abs(found.marker_flow.cpu().numpy() - flow).max()),
        "residual": float(found.residual.max()),
    }


def speed(path: str, device: str, threads: str) -> dict:
    """Time batches of contacts of an Object File on a device, in this process; CPU seconds of a CPU."""
    torch.set_num_threads(int(threads))
    file = ObjectFile.load(path)
    made = time.perf_counter()
    touch = BatchedTouch(file, SENSOR, device, checks=False)
    row: dict[str, Any] = {"device": _name(device, int(threads)), "object": file.key}
    row["made_s"] = time.perf_counter() - made
    drawn = contacts(file, max(BATCHES), np.random.default_rng(0))
    if device == "cpu":
        names, few = ("points", "angle", "depth"), BATCHES[1]
        parts = [{name: drawn[name][k : k + 1] for name in names} for k in range(few)]
        row["single"] = _timed(lambda: [file.press(**part, sensor=SENSOR) for part in parts], device) / few
        row["taxim"] = _timed(taxim_lookup(touch, drawn, device), device) / few
    moved = {name: torch.as_tensor(of, device=device) for name, of in drawn.items()}
    still = {name: of for name, of in moved.items() if name not in ("shear", "twist")}
    for size in BATCHES:
        for name, given in (("press", still), ("sheared", moved)):
            part = {key: of[:size] for key, of in given.items()}
            row[f"{name}_{size}"] = _timed(lambda part=part: touch.press(0, **part), device, size < 99) / size
    row |= shares(touch, {name: of[: BATCHES[2]] for name, of in still.items()}, device)
    if "single" in row:
        row["ratio"] = row[f"press_{BATCHES[2]}"] / row["single"]
    row["bytes"] = _peak(device)
    return row


def taxim_lookup(touch: BatchedTouch, drawn: dict[str, np.ndarray], device: str) -> Callable[[], object]:
    """Return Taxim's lookup of colours of the gels' shapes, in torch, of the second batch."""
    few = {name: of[: BATCHES[1]] for name, of in drawn.items()}
    moved = touch.press(0, **few).displacement
    table = torch.from_numpy(color_table(touch.profile)).float().to(device)
    pitch, (height, width) = touch.profile.pixel_pitch, moved.shape[1:]
    y, x = torch.meshgrid(*(torch.arange(n, device=device).float() for n in (height, width)), indexing="ij")
    terms = torch.stack([x * x, y * y, x * y, x, y, torch.ones_like(x)], -1)
    background, step = touch.background, math.pi / 2 / (BINS - 1)

    def look_up() -> torch.Tensor:
        down, right = torch.gradient(moved, spacing=pitch, dim=(1, 2))
        slope = (torch.atan(torch.hypot(down, right)) / step).long()
        way = ((torch.atan2(down, right) + math.pi) / (4 * step)).long()
        change = (table[:, slope, way] * terms).sum(-1).permute(1, 2, 3, 0)
        return (background + change).round().clamp(0, 255).to(torch.uint8)

    return look_up


def shares(touch: BatchedTouch, part: dict[str, torch.Tensor], device: str) -> dict[str, float]:
    """Return the ms a touch of rays, gel and optics."""
    presses, count = touch._presses, len(part["points"])
    given: list = []
    cast = presses.heights.cast_heights
    presses.heights.cast_heights = lambda *contact: given.append(contact) or cast(*contact)  # type: ignore
    touch.press(0, **part)
    presses.heights.cast_heights = cast  # type: ignore[method-assign]
    heights = [cast(*contact)[0] for contact in given]
    displacements = [presses.gel.press(height)[0] for height in heights]
    jobs = {
        "rays": lambda: [cast(*contact) for contact in given],
        "gel": lambda: [presses.gel.press(height) for height in heights],
        "optics": lambda: [presses.optics.render(moved) for moved in displacements],
    }
    return {name: _timed(job, device, False) / count for name, job in jobs.items()}


class Counted(TorchDispatchMode):
    """Counts what operations start, read and write, compute and hold."""

    def __init__(self) -> None:
        super().__init__()
        self.kernels, self.bytes, self.flops, self.peak = 0, 0, 0.0, 0
        self._live: dict[StorageWeakRef, int] = {}

    def __torch_dispatch__(self, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        answer = operation(*args, **(kwargs or {}))
        if operation.is_view:
            return answer
        outputs = [
            v for v in (answer if isinstance(answer, list | tuple) else [answer]) if torch.is_tensor(v)
        ]
        inputs = [v for v in args if torch.is_tensor(v)]
        inputs += [v for of in args if isinstance(of, list | tuple) for v in of if torch.is_tensor(v)]
        self.kernels += 1
        size = sum(v.numel() * v.element_size() for v in (*inputs, *outputs))
        points = max(v.numel() for v in (*inputs, *outputs)) if outputs else 0
        transform = "fft" in operation.__name__
        # Two passes along each of two axes, at least, and 5 n log2 n operations of a transform.
        self.kernels, self.bytes = self.kernels + transform, self.bytes + size * (1 + transform)
        self.flops += points * (2.5 * 16 if transform else 1)
        for v in outputs:
            self._live[StorageWeakRef(v.untyped_storage())] = v.untyped_storage().nbytes()
        self._live = {ref: held for ref, held in self._live.items() if not ref.expired()}
        self.peak = max(self.peak, sum(self._live.values()))
        return answer


def predicted(count: int) -> dict[str, dict[str, float]]:
    """Count what a batch takes on a GPU, without one: gel, slip and optics on tensors without values."""
    profile, meta = load_profile(SENSOR), torch.device("meta")
    gel, optics = GelBatch(profile, meta), Optics(profile, meta)
    friction = SlipBatch(gel)
    height = torch.empty(count, profile.height, profile.width, device=meta)
    shear, twist = torch.empty(count, 2, device=meta), torch.empty(count, device=meta)
    rows: dict[str, dict[str, float]] = {}
    results: dict[str, Any] = {}

    def shear_all() -> Any:
        slips = friction.slip(results["gel"][1], shear, twist, twist)
        flow = gel.flow(slips.sideways, results["gel"][0])
        return friction.drag(height, results["gel"][1], slips.dragged, shear, twist), flow

    jobs = {
        "gel": lambda: gel.press(height),
        "optics": lambda: optics.render(results["gel"][0]),
        "shear": shear_all,
    }
    for name, job in jobs.items():
        with Counted() as counted:
            results[name] = job()
        row = {"kernels": counted.kernels, "bytes": counted.bytes / count, "flops": counted.flops / count}
        rows[name] = row | {"peak": counted.peak, "rays": 0.0}
    # Of every pixel one ray up to the base, one beyond it; both read about 2 KB of nodes and triangles.
    pixels = profile.height * profile.width
    rays = {
        "kernels": 20,
        "rays": 2.0 * pixels,
        "bytes": 12.0 * pixels,
        "flops": 0.0,
        "peak": 4.0 * count * pixels,
    }
    rows = {"rays": rays} | rows
    for row in rows.values():
        parts = row["bytes"] / H200["bytes"], row["flops"] / H200["flops"], row["rays"] / H200["rays"]
        row["ms"] = 1000 * max(sum(parts), row["kernels"] * H200["launch"] / count)
    return rows


def _timed(job: Callable[[], object], device: str, warm_up: bool = True) -> float:
    """Return ms of a job, after one to warm up if it is short, or on a GPU."""
    clock = time.perf_counter if device != "cpu" or torch.get_num_threads() > 1 else time.process_time
    if warm_up or device != "cpu":
        job()
        _wait(device)
    start = clock()
    job()
    _wait(device)
    return 1000 * (clock() - start)


def _wait(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize()


def _peak(device: str) -> int:
    if device != "cpu":
        return torch.cuda.max_memory_allocated()
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _best_device() -> str:
    return "cuda" if torch.cuda.is_available() else "cpu"


def _name(device: str, threads: int) -> str:
    if device != "cpu":
        return torch.cuda.get_device_name()
    return "one core" if threads == 1 else f"{threads} threads"


def missed_targets(rows: list[dict], speeds: list[dict], counts: dict[str, dict[str, float]]) -> list[str]:
    """Say which targets were missed."""
    found = [
        f"{row['object']}, {name}: {row[name]:.3g}, target {TARGETS[name]:g}"
        for row in rows
        for name, sign in (("worst_db", -1), ("mean_db", -1), ("force", 1), ("flow", 1))
        if sign * row[name] > sign * TARGETS[name]
    ]
    for row in speeds:
        if row["device"] == "one core" and row["ratio"] > TARGETS["ratio"]:
            found.append(
                f"{row['object']}: {row['ratio']:.2f} of a single press, target {TARGETS['ratio']:g}"
            )
        fast = row.get(f"press_{max(BATCHES)}", 0) <= TARGETS["gpu_ms"]
        if "core" not in row["device"] and "threads" not in row["device"] and not fast:
            found.append(
                f"{row['device']}: {row[f'press_{max(BATCHES)}']:.2f} ms, target {TARGETS['gpu_ms']:g} ms"
            )
    if max(row["peak"] for row in counts.values()) > MEMORY:
        found.append(f"memory above {MEMORY / 1e9:g} GB")
    return found


def main() -> None:
    run_job({"agreement": agreement, "speed": speed})
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("keys", nargs="+", help="objects; the first ones are timed")
    parser.add_argument("--workspace", type=Path, default=ROOT, help="holds build/")
    parser.add_argument("--contacts", type=int, default=100, help="of each object, that are compared")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, torch.get_num_threads()])
    parser.add_argument("--timed", type=int, default=3, help="number of objects that are timed")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    built = [given.workspace / "build" / key / "ObjectFile.safetensors" for key in given.keys]
    paths = [
        str(path if path.is_file() else file_or_sample(Path(key))) for key, path in zip(given.keys, built)
    ]
    console = Console()
    speeds, rows = [], []
    for path in paths[: given.timed]:
        for threads in sorted(set(given.threads)):
            speeds.append(require(fresh(__file__, "speed", path, "cpu", threads)))
        if torch.cuda.is_available():
            speeds.append(require(fresh(__file__, "speed", path, "cuda", 1)))
    head = {"object": ("object", ""), "device": ("on", "")}
    parts = {name: (name, ".2f") for name in ("rays", "gel", "optics", "taxim", "ratio")}
    for name, more in (("press", {"single": ("single", ".2f")}), ("sheared", {})):
        form = head | more | {f"{name}_{size}": (str(size), ".2f") for size in BATCHES}
        print_rows(speeds, f"{name}, ms a touch, by batch", form, console)
    print_rows(speeds, f"ms a touch, in a batch of {BATCHES[2]}", head | parts, console)
    counts = predicted(max(BATCHES))
    form = {"object": ("part", ""), "kernels": ("kernels", ".0f"), "bytes": ("bytes a touch", ".3g")}
    form |= {"flops": ("flops a touch", ".3g"), "peak": ("peak bytes", ".3g"), "ms": ("ms a touch", ".4f")}
    title = f"Counted for a GPU, a batch of {max(BATCHES)}"
    print_rows([{"object": name, **row} for name, row in counts.items()], title, form, console)
    for path in paths:
        rows.append(require(fresh(__file__, "agreement", path, given.contacts)))
        console.print(f"{rows[-1]}", markup=False, soft_wrap=True)
    missed = missed_targets(rows, speeds, counts)
    words = (
        "images 50 dB, worst 40; force 1 %; markers 0.05 pixels; on one core 0.6 of a single press; 0.5 ms "
    )
    record = {"agreement": rows, "speed": speeds, "gpu": counts}
    write_record(given.json, record, words + "on a GPU; 8 GB", missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
