"""Energy of modes beyond those kept: `python perf/truncation.py OBJECT [--keep N ...] [--json FILE]`.

Solves all modes of an object of this workspace below `modal.max_frequency`, compares the energy of those
beyond the lowest N with the estimate that `evaluate` gives (`lost_energy`), and exits with 1 if the estimate
is wrong by more than a factor of 1.5.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from harness import parsed, write_record
from rich.console import Console
from rich.table import Table

from objectfolder.base.arrays import read_npz
from objectfolder.base.io import read_json
from objectfolder.base.materials import LAWS, material
from objectfolder.sound.evaluation import lost_energy
from objectfolder.sound.fem.elements import solid_from_arrays
from objectfolder.sound.fem.modal import Request, modal_analysis
from objectfolder.sound.gains_net import energy_weights
from objectfolder.workspace.layout import Build

FACTOR = 1.5
POINTS = 1000


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("object", help="key of an object whose stage modal has run")
    parser.add_argument("--keep", type=int, nargs="+", default=[64, 128, 256], metavar="N")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    build = Build(given.object)
    report = read_json(build.modal)
    points = read_npz(build.modes, "points")["points"]
    points = points[np.random.default_rng(0).choice(len(points), min(POINTS, len(points)), replace=False)]
    limit, start = report["max_frequency_hz"], time.process_time()
    solid = solid_from_arrays(read_npz(build.solid, "kind"))
    stuff = material(report["material"])
    found = modal_analysis(solid, points, Request(stuff, report["scale_m"], limit, 1 << 20), given.object)
    seconds, count = time.process_time() - start, len(found.eigenvalues)
    squared, w = np.square(found.shapes, dtype=np.float64).mean((0, 1)), np.sqrt(found.eigenvalues)
    table = Table("damping", "kept", "up to Hz", "energy lost", "estimated", title=given.object)
    rows = []
    for law, kept in ((law, n) for law in LAWS for n in sorted({n for n in given.keep if n < count})):
        stuff = material(report["material"], law)
        energy = squared * energy_weights(w, stuff.damping(w**2))
        row = {
            "law": law,
            "kept": kept,
            "hertz": float(w[kept - 1] / (2 * np.pi)),
            "lost": float(energy[kept:].sum() / energy.sum()),
            "estimated": lost_energy(found.shapes[..., :kept], w[:kept], stuff, count, limit),
        }
        rows.append(row)
        shares = (f"{row[name]:.4%}" for name in ("lost", "estimated"))
        table.add_row(law, str(kept), f"{row['hertz']:.0f}", *shares)
    console = Console()
    console.print(table)
    console.print(f"{count} modes to {limit:.0f} Hz; {seconds:.0f} CPU s")
    write_record(given.json, {"object": given.object, "modes": count, "rows": rows})
    sys.exit(any(not 1 / FACTOR < row["estimated"] / row["lost"] < FACTOR for row in rows))


if __name__ == "__main__":
    main()
