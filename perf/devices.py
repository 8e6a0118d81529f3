"""Queries on a CPU and on a GPU: `python perf/devices.py FILE ... [--json FILE]`.

Median wall times of one thread for single queries and for batches, with the nets of an Object File on each
device, and how far the answers of the two differ: in dB for pictures, relative for sounds. Rays are cast and
meshes are pressed on the CPU in any case. A name, such as mug, stands for an Object File that comes with the
package. Exits with 1 if answers differ more than rounding explains.
"""

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from harness import exit_with_verdict, parsed, write_record
from rich.console import Console
from rich.table import Table

from objectfolder import ObjectFile
from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.tasks.running import machine
from objectfolder.vision.cameras import sphere_points

BATCH, REPEATS = 64, 5
PATIENCE = 10.0  #: seconds for the repetitions of one query
PICTURES = 45.0  #: dB, least agreement of pictures: half a grey level of 255 is 54 dB
SOUNDS = 1e-3  #: largest relative difference of sounds


def timed(ask: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    """Return the median wall seconds of a query after one to warm up, fewer of slow ones, and its answer."""
    times: list[float] = []
    while len(times) <= REPEATS and sum(times) < PATIENCE:
        start = time.perf_counter()
        answer = ask()
        times.append(time.perf_counter() - start)
    return median(times[1:] or times), answer


def answers(path: str, device: str, resolution: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the times of an Object File's queries on a device, and what they answered."""
    file = ObjectFile.load(path, device=device) if Path(path).is_file() else sample(path, device)
    rng = np.random.default_rng(0)
    camera, light = sphere_points(1, 2.5, rng), sphere_points(1, 1.0, rng)
    points, forces = file.sample_surface(BATCH), rng.standard_normal((BATCH, 3))
    queries: dict[str, Callable[[], np.ndarray]] = {
        "view": lambda: file.view(camera, light, resolution, supersample=False),
        "impact": lambda: file.impact(points[:1], forces[:1]),
        "impacts": lambda: file.impact(points, forces),
        "touch": lambda: file.touch(points[:1]),
        "touches": lambda: file.touch(points),
    }
    found = {name: timed(ask) for name, ask in queries.items()}
    times = {name: 1000 * took for name, (took, _) in found.items()}
    times["impacts"], times["touches"] = times["impacts"] / BATCH, times["touches"] / BATCH
    kinds = ", ".join(file.header[sense]["kind"] for sense in ("vision", "audio", "touch"))
    row = {"object": file.key, "nets": kinds, "device": machine(device), "resolution": resolution}
    return row | times, {name: answer for name, (_, answer) in found.items()}


def sample(name: str, device: str) -> ObjectFile:
    """Return an Object File of the package with its nets on a device."""
    file = ObjectFile.sample(name)
    return ObjectFile(file.header, file.tensors, name, device)


def agreement(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the PSNR of pictures in dB, and the largest difference of sounds relative to the loudest."""
    found = {}
    for name in ("view", "touches"):
        a, b = (np.asarray(answer[name], np.float64) for answer in (one, other))
        scale = 255.0 if one[name].dtype == np.uint8 else 1.0
        error = float(np.square((a - b) / scale).mean())
        found[name] = -10 * math.log10(error) if error else math.inf
    a, b = (np.asarray(answer["impacts"], np.float64) for answer in (one, other))
    found["impacts"] = float(np.abs(a - b).max() / np.abs(a).max())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", help="Object Files, or names of those of the package")
    parser.add_argument("--resolution", type=int, default=256, help="of the view, pixels; default: 256")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    if not torch.cuda.is_available():
        raise SystemExit("perf/devices.py needs a GPU and a torch built for it (`objectfolder doctor`)")
    torch.set_num_threads(1)
    rows, missed = [], []
    for path in arguments.files:
        try:
            (cpu, first), (gpu, second) = (
                answers(path, device, arguments.resolution) for device in ("cpu", "cuda")
            )
        except ObjectFolderError as error:
            raise SystemExit(str(error)) from error
        alike = agreement(first, second)
        missed += [
            f"{cpu['object']}: {name} agree to {alike[name]:.1f} dB, expected {PICTURES:g}"
            for name in ("view", "touches")
            if alike[name] < PICTURES
        ]
        if alike["impacts"] > SOUNDS:
            missed.append(f"{cpu['object']}: sounds differ by {alike['impacts']:.2g}, expected {SOUNDS:g}")
        rows.append({"cpu": cpu, "gpu": gpu, "agreement": alike})
    console = Console(width=max(Console().width, 130))
    names = ("view", "impact", "impacts", "touch", "touches")
    table = Table("object", "nets", "device", *names, title="Wall ms per query; the plural: in batches of 64")
    for row in rows:
        for place in ("cpu", "gpu"):
            shown = row[place]
            table.add_row(
                shown["object"],
                shown["nets"],
                shown["device"],
                *(f"{shown[name]:.3g}" for name in names),
            )
        alike = row["agreement"]
        table.add_row("", "agreement", "", f"{alike['view']:.1f} dB", "", f"{alike['impacts']:.1e}", "", "")
    console.print(table)
    targets = f"answers agree to {PICTURES:g} dB (pictures) and {SOUNDS:g} (sounds)"
    write_record(arguments.json, {"rows": rows, "torch": torch.__version__}, targets, missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
