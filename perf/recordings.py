"""Modes of a real ceramic bowl, heard and computed: `python perf/recordings.py DIR [--json FILE]`.

DIR holds `bowl.obj_.msh` and `mic*.wav` of the DiffSound project (github.com/TechnetiumMan/DiffSound, folders
data/mesh/bowl and data/real_audio; it has no licence, so nothing of it is stored here). The bowl goes through
this project's own analysis with 32 cells; then its stiffness and damping are fitted to the taps.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from harness import write_record
from rich.console import Console
from rich.table import Table

from objectfolder.audio.fitting import fit_sound, match_modes
from objectfolder.audio.recordings import at_one_rate, read_recording
from objectfolder.audio.ringdown import LN_1000
from objectfolder.fem.cutcell import cut_cells
from objectfolder.fem.eigen import solve_modes
from objectfolder.materials import material

CELLS, SUBDIVISIONS = 32, 8
MAX_RAW, MAX_FITTED = 0.03, 0.005  # of frequencies: the ceramic of the table, and after the fit, rms
NODES_OF = {1: 2, 2: 3, 4: 4, 15: 1}  # of Gmsh's element types


def boundary(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the surface of a tetrahedral mesh: Gmsh 2.2, binary; vertices in metres and faces."""
    raw = path.read_bytes()
    start = raw.index(b"$Nodes\n") + 7
    line = raw.index(b"\n", start)
    node = np.dtype([("number", "<i4"), ("place", "<f8", 3)])
    nodes = np.frombuffer(raw, node, count=int(raw[start:line]), offset=line + 1)
    start = raw.index(b"$Elements\n") + 10
    line = raw.index(b"\n", start)
    left, place, tets = int(raw[start:line]), line + 1, []
    while left:
        kind, count, tags = np.frombuffer(raw, "<i4", count=3, offset=place)
        width = 1 + tags + NODES_OF[int(kind)]
        block = np.frombuffer(raw, "<i4", count=count * width, offset=place + 12).reshape(count, width)
        if kind == 4:
            tets.append(block[:, 1 + tags :])
        left, place = left - count, place + 12 + block.nbytes
    row = np.zeros(nodes["number"].max() + 1, int)
    row[nodes["number"]] = np.arange(len(nodes))
    corners = row[np.concatenate(tets)]
    faces = corners[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_counts=True)
    return nodes["place"], faces[first[count == 1]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="with bowl.obj_.msh and mic*.wav")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parser.parse_args()
    vertices, faces = boundary(given.folder / "bowl.obj_.msh")
    lower, upper = vertices[faces].min((0, 1)), vertices[faces].max((0, 1))
    size, ceramic = float((upper - lower).max()), material("ceramic")
    cells = cut_cells((vertices - (lower + upper) / 2) / size, faces, CELLS, SUBDIVISIONS, "bowl")
    modes = solve_modes(cells.assemble(ceramic, size), 20000.0, 256, "bowl")
    computed = np.sqrt(modes.eigenvalues) / (2 * np.pi)
    sounds, rate = at_one_rate([read_recording(path) for path in sorted(given.folder.glob("mic*.wav"))])
    fit = fit_sound(computed, ceramic, sounds, rate, "loss_factor")
    match, heard = fit.match, fit.heard
    hertz = heard.frequency[match.heard]
    raw = float(np.sqrt(np.mean((computed[match.computed] / hertz - 1) ** 2)))
    laws = {law: material("ceramic", law) for law in ("rayleigh", "loss_factor")}
    decays = {
        "heard": heard.decay_time[match.heard],
        **{law: LN_1000 / own.damping((2 * np.pi * hertz) ** 2) for law, own in laws.items()},
        "fitted": fit.decay_time,
    }
    table = Table("computed Hz", "heard Hz", "left", *(f"T60 {name}, s" for name in decays), title="bowl")
    for i, residual in enumerate(match.residual):
        row = [f"{computed[match.computed[i]]:.0f}", f"{hertz[i]:.0f}", f"{residual:+.2%}"]
        table.add_row(*row, *(f"{times[i]:.3g}" for times in decays.values()))
    console = Console()
    console.print(table)
    errors = {
        name: float(np.median(np.abs(np.log(times / decays["heard"]))))
        for name, times in decays.items()
        if name != "heard"
    }
    chance = match_modes(computed, np.sort(np.random.default_rng(0).uniform(hertz[0], hertz[-1], len(hertz))))
    console.print(
        f"{len(hertz)} of {len(heard.frequency)} heard and {len(computed)} computed modes; frequencies: "
        f"{raw:.2%} as in the table of materials (target {MAX_RAW:.0%}), {fit.frequency_error:.2%} with "
        f"{match.stiffness:.4f} times the stiffness (target {MAX_FITTED:.1%}); as many frequencies at "
        f"random: {len(chance.heard)} match, rival {chance.rival:.2f} (bowl: {match.rival:.2f})\n"
        f"decay times, median of |ln ratio|: {', '.join(f'{k} {v:.2f}' for k, v in errors.items())}",
        highlight=False,
    )
    figures = {"raw": raw, "fitted": fit.frequency_error, "modes": len(hertz), "decay": errors}
    write_record(given.json, figures | {"stiffness": match.stiffness, "material": fit.material})
    sys.exit(raw > MAX_RAW or fit.frequency_error > MAX_FITTED)


if __name__ == "__main__":
    main()
