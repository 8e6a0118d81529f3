"""Sound at a listener: `python perf/radiation.py [--workspace DIR] [--objects KEY ...] [--bands KEY ...]`.

Run `objectfolder build radiation` first. For some modes of each object, levels in 500 directions are compared
with those of a mesh of more triangles (`--fine`), the same for all wavelengths. For those of `--bands`, a
table tells by how much radiation changes the share of each octave in the energy of a strike's sound, against
summed displacements. Exits with 1 if a target is missed.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from harness import exit_with_verdict, write_record
from rich.console import Console
from rich.table import Table

from objectfolder import ObjectFile
from objectfolder.base.arrays import read_npz, read_safetensors
from objectfolder.mesh.ply import read_surface
from objectfolder.sound.radiation.farfield import FarField, unpack_far_field
from objectfolder.sound.radiation.harmonics import real_harmonics
from objectfolder.sound.radiation.radiation import radiate
from objectfolder.workspace import params
from objectfolder.workspace.layout import Build

MODES = 6  # of each object that are compared
DIRECTIONS = 500
CENTRES = 125.0 * 2.0 ** np.arange(8)  # of octaves, Hz
REPEATS = 50
MEAN_DB, PERCENTILE_DB, LISTENER_MS = 1.0, 3.0, 3.0
TARGETS = (
    f"{MEAN_DB:g} dB on average and {PERCENTILE_DB:g} dB for 95 % of directions; "
    f"a strike at a listener {LISTENER_MS:g} ms"
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--workspace", type=Path, default=Path())
    parser.add_argument("--objects", nargs="*", default=["mug", "bell"], metavar="KEY")
    parser.add_argument("--bands", nargs="*", default=["mug", "bell"], metavar="KEY")
    parser.add_argument("--fine", type=int, default=10000, help="triangles of the reference")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parser.parse_args()
    console, values = Console(), params.read(given.workspace / "params.yaml")
    missed, rows, shares = [], [], []
    for key in given.objects:
        build, scale = Build(key, given.workspace), values["objects"][key]["scale"]
        rows += compared(build, scale, values["radiation"]["triangles"], given.fine)
    table = Table(
        "object", "Hz", "kR", "CPU s", "mean dB", "95th percentile dB", "power dB", title="directions"
    )
    for row in rows:
        figures = (f"{row[name]:.2f}" for name in ("kr", "seconds", "mean", "percentile", "power"))
        table.add_row(row["object"], f"{row['hertz']:.0f}", *figures)
        if row["mean"] > MEAN_DB or row["percentile"] > PERCENTILE_DB:
            missed.append(
                f"{row['object']} at {row['hertz']:.0f} Hz: {row['mean']:.1f} and {row['percentile']:.1f} dB"
            )
    console.print(table)
    bands = Table("object", *(f"{hertz:g}" for hertz in CENTRES), title="change of each octave's share, dB")
    for key in given.bands:
        change = octaves(Build(key, given.workspace))
        shares.append({"object": key, "change": change})
        bands.add_row(key, *("" if each is None else f"{each:+.1f}" for each in change))
    console.print(bands)
    strike = strike_times()
    console.print(
        f"one strike of the sample mug: {strike['alone']:.1f} ms, at a listener {strike['heard']:.1f} ms"
    )
    if strike["heard"] > LISTENER_MS:
        missed.append(f"a strike at a listener: {strike['heard']:.1f} ms")
    record = {"fine": given.fine, "directions": rows, "octaves": CENTRES.tolist(), "shares": shares}
    write_record(given.json, record | {"strike_ms": strike}, TARGETS, missed)
    exit_with_verdict(missed, console)


def compared(build: Build, scale: float, triangles: int, fine: int) -> list[dict]:
    """Compare the levels of some modes with those of a fine mesh."""
    modes = read_npz(build.modes, "points", "shapes", "damped_frequency")
    vertices, faces = read_surface(build.surface)
    w = modes["damped_frequency"]
    chosen = np.unique(np.linspace(0, len(w) - 1, MODES).astype(int))
    directions = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    harmonics = real_harmonics(directions / np.linalg.norm(directions, axis=1)[:, None], 31)
    rows = []
    for mode in chosen:
        task = modes["points"] * scale, modes["shapes"][..., [mode]], w[[mode]]
        start = time.process_time()
        ours = radiate((vertices * scale, faces), *task, triangles)
        seconds = time.process_time() - start
        reference = radiate((vertices * scale, faces), *task, fine, fewest=fine)
        levels = [
            20 * np.log10(abs(harmonics[:, : one.coefficients.shape[1]] @ one.coefficients[0]))
            for one in (ours, reference)
        ]
        off = abs(levels[0] - levels[1])
        rows.append(
            {
                "object": build.key,
                "hertz": round(float(w[mode] / (2 * np.pi)), 1),
                "kr": round(float(w[mode] / 343.2 * ours.radius), 2),
                "seconds": round(seconds, 2),
                "mean": round(float(off.mean()), 2),
                "percentile": round(float(np.percentile(off, 95)), 2),
                "power": round(float(10 * np.log10(power(ours)[0] / power(reference)[0])), 2),
            }
        )
    return rows


def power(field: FarField) -> np.ndarray:
    """Return the mean square of each mode's far field, times 4 pi."""
    return (abs(field.coefficients) ** 2).sum(1)


def octaves(build: Build) -> list[float | None]:
    """Return by how many dB radiation changes each octave's share of the energy; None without modes."""
    modes = read_npz(build.modes, "shapes", "damped_frequency", "damping")
    tensors, header = read_safetensors(build.radiation)
    w, c = modes["damped_frequency"], modes["damping"]
    gain = np.square(modes["shapes"], dtype=np.float64).mean((0, 1))
    moved = gain / w**2 / c
    heard = gain * w**2 / c * power(unpack_far_field(tensors, header["radius"]))
    octave = np.round(np.log2(w / (2 * np.pi) / CENTRES[0])).astype(int)
    found: list[float | None] = []
    for index in range(len(CENTRES)):
        inside = octave == index
        change = (
            (heard[inside].sum() / heard.sum()) / (moved[inside].sum() / moved.sum())
            if inside.any()
            else None
        )
        found.append(None if change is None else round(float(10 * np.log10(change)), 1))
    return found


def strike_times() -> dict[str, float]:
    """Return the CPU time of one strike without and with a listener, milliseconds, warm, on one thread."""
    torch.set_num_threads(1)
    mug = ObjectFile.sample("mug")
    point, spent = mug.sample_surface(1), {}
    for name, options in (("alone", {}), ("heard", {"listener": [[0.3, 0.4, 0.5]]})):
        mug.impact(point, [[0, 0, 1.0]], **options)
        start = time.process_time()
        for _ in range(REPEATS):
            mug.impact(point, [[0, 0, 1.0]], **options)
        spent[name] = round(1000 * (time.process_time() - start) / REPEATS, 2)
    return spent


if __name__ == "__main__":
    main()
