"""Speed of Object File queries: `python perf/query.py FILE ... [--mixed N] [--json FILE]`.

Median CPU times in fresh single-threaded processes: from starting Python to the first touch; views of 256 x
256 with one sample per pixel and with adaptive supersampling; sounds of two seconds and touches, in single
calls and in batches. The table also lists the authors' published times for their released files on a GPU.
`--mixed` compares the bytes of N mixed queries from four threads with those of the same queries in
sequence. Needs the base install only. Exits with 1 if a target is missed.
"""

import argparse
import hashlib
import resource
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median

from harness import exit_with_verdict, fresh, parsed, require, run_job, write_record
from rich.console import Console
from rich.table import Table

#: Title, target per file, published figures of ObjectFolder 1.0 and 2.0 on a GPU (Gao et al. 2022, Table 1).
FIGURES: dict[str, tuple[str, float, float | None, float | None]] = {
    "first_touch_s": ("start to first touch, s", 2.0, None, None),
    "view_ms": ("view, ms", 40.0, 3699.0, 62.0),
    "view_single_ms": ("1 sample, ms", 25.0, None, None),
    "impact_ms": ("impact, ms", 5.0, 420.0, 35.0),
    "impact_batch_ms": ("in batches", 1.0, None, None),
    "touch_ms": ("touch, ms", 7.0, 10.0, 14.0),
    "touch_batch_ms": ("in batches", 7.0, None, None),
    "peak_mb": ("peak MB", 1024.0, None, None),
    "file_kb": ("file, kB", 1300.0, 15600.0, None),
}
MEDIAN_KB = 900.0  #: target for the median file size
VIEWS, SINGLE, BATCH = 12, 40, 64


def milliseconds(ask: Callable, arguments: list) -> float:
    """Return the median CPU time of calls with these arguments, after one call to warm up."""
    ask(*arguments[0])
    times = []
    for one in arguments:
        start = time.process_time()
        ask(*one)
        times.append(1000 * (time.process_time() - start))
    return median(times)


def first(path: str, *point: str) -> dict:
    """Time import, load and touch in this process, including the start of Python."""
    from objectfolder import ObjectFile

    ObjectFile.load(path).touch([float(x) for x in point])
    return {"first_touch_s": time.process_time()}


def speed(path: str) -> dict:
    """Time all queries in this process."""
    import numpy as np
    import torch

    from objectfolder import ObjectFile
    from objectfolder.vision.cameras import sphere_points

    torch.set_num_threads(1)
    file, rng = ObjectFile.load(path), np.random.default_rng(0)
    cameras, lights = sphere_points(VIEWS, 2.5, rng), sphere_points(VIEWS, 1.0, rng)
    points, forces = file.sample_surface(BATCH), rng.standard_normal((BATCH, 3))
    singly = list(zip(points[:SINGLE, None], forces[:SINGLE, None]))
    together = [(points, forces)] * 5
    pairs = list(zip(cameras[:, None], lights[:, None]))
    touch = lambda points, _: file.touch(points)  # noqa: E731
    return {
        "object": file.key,
        "point": points[0].tolist(),
        "view_ms": milliseconds(file.view, pairs),
        "view_single_ms": milliseconds(partial(file.view, supersample=False), pairs),
        "impact_ms": milliseconds(file.impact, singly),
        "impact_batch_ms": milliseconds(file.impact, together) / BATCH,
        "touch_ms": milliseconds(touch, singly),
        "touch_batch_ms": milliseconds(touch, together[:2]) / BATCH,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "file_kb": Path(path).stat().st_size / 1000,
    }


def mixed(path: str, count: str) -> dict:
    """Compare the bytes of concurrent and sequential queries."""
    import numpy as np

    from objectfolder import ObjectFile
    from objectfolder.vision.cameras import sphere_points

    def queries() -> list[Callable]:
        file, rng = ObjectFile.load(path), np.random.default_rng(0)
        points = file.sample_surface(int(count))
        asked: list[Callable] = []
        for point, force, kind in zip(points, rng.standard_normal(points.shape), rng.random(len(points))):
            camera, light = (sphere_points(1, radius, rng) for radius in (2.5, 1.0))
            if kind < 0.04:
                asked.append(partial(file.view, camera, light, 128))
            elif kind < 0.4:
                asked.append(partial(file.touch, point, rng.uniform(0, 0.001), rng.uniform(0, 6)))
            else:
                asked.append(partial(file.impact, point, force, duration=rng.choice([0.5, 2.0])))
        return asked

    def digest(ask: Callable) -> bytes:
        return hashlib.sha256(ask().tobytes()).digest()

    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(digest, queries()))
    differing = sum(a != b for a, b in zip(together, map(digest, queries()), strict=True))
    return {"mixed_queries": len(together), "differing": differing}


def significant(value: float | None) -> str:
    """Format with at least three significant digits; an empty string for None."""
    return "" if value is None else f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def misses(rows: list[dict]) -> list[str]:
    """Describe the missed targets."""
    found = [
        f"{row['object']}: {title} {row[name]:.3g}, expected at most {target:g}"
        for row in rows
        for name, (title, target, *_) in FIGURES.items()
        if row[name] > target
    ]
    middle = median(row["file_kb"] for row in rows)
    if middle > MEDIAN_KB:
        found.append(f"median file {middle:.0f} kB, expected at most {MEDIAN_KB:g}")
    return found + [
        f"{row['object']}: answers differ between threads" for row in rows if row.get("differing")
    ]


def show(rows: list[dict], console: Console) -> None:
    table = Table(title="Queries of Object Files, CPU time of one thread")
    table.add_column("object")
    for title, *_ in FIGURES.values():
        table.add_column(title, justify="right")
    for row in rows:
        table.add_row(row["object"], *(significant(row[name]) for name in FIGURES))
    table.add_section()
    for i, name in enumerate(("target, at most", "released 1.0 on a GPU", "released 2.0 on a GPU"), 1):
        table.add_row(name, *(significant(figure[i]) for figure in FIGURES.values()))
    console.print(table)
    for row in (row for row in rows if "mixed_queries" in row):
        console.print(
            f"{row['object']}: {row['mixed_queries']} mixed queries from 4 threads; "
            f"{row['differing']} answers differ from those of sequential queries"
        )


def main() -> None:
    run_job({"first": first, "speed": speed, "mixed": mixed})
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", help="Object Files")
    parser.add_argument("--mixed", type=int, help="number of mixed queries of the first file")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    rows = []
    for path in arguments.files:
        row = require(fresh(__file__, "speed", path))
        point = [str(x) for x in row.pop("point")]
        starts = [require(fresh(__file__, "first", path, *point))["first_touch_s"] for _ in range(3)]
        rows.append(row | {"first_touch_s": median(starts)})
    if arguments.mixed:
        rows[0] |= require(fresh(__file__, "mixed", arguments.files[0], arguments.mixed))
    console = Console(width=max(Console().width, 130))
    show(rows, console)
    missed = misses(rows)
    write_record(arguments.json, {"objects": rows}, f"in the table; median file {MEDIAN_KB:g} kB", missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
