"""Modes of real objects, heard and computed: `python perf/recordings.py --bowl DIR --bar WAV`.

DIR holds `bowl.obj_.msh` and `mic*.wav` of the DiffSound project (github.com/TechnetiumMan/DiffSound, folders
data/mesh/bowl and data/real_audio; it has no licence, so nothing of it is stored here). The bowl goes through
this project's own analysis with 32 cells; then its stiffness and damping are fitted to the taps.

WAV is `src/114x25.4x3.12mm Hot Rolled Mild Steel Bar.wav` of github.com/jjderooy/pyRFDA (MIT), commit
44d3c96, whose `src/main.py` gives size and mass: one tap on a bar on two wires, 0.37 s. Its modes are
computed as given, and with three unknowns fitted to the frequencies: Young's modulus, Poisson's ratio and
the ratio of thickness to width at equal mass. Its decay is computed too: by boundary elements, what it
radiates.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from harness import write_record
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares, linear_sum_assignment

from objectfolder.base.materials import Material, material
from objectfolder.sound.click import AIR_DENSITY, SOUND_SPEED
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import solve_modes
from objectfolder.sound.fitting import fit_sound, match_modes
from objectfolder.sound.radiation.radiation import radiate
from objectfolder.sound.recordings import read_recording, resample_to_lowest
from objectfolder.sound.ringdown import BAND, LN_1000, Ringdown, ringdown, strikes

CELLS, SUBDIVISIONS = 32, 8
MAX_RAW, MAX_FITTED = 0.03, 0.005  # of frequencies: the ceramic of the table, and after the fit, rms
NODES_OF = {1: 2, 2: 3, 4: 4, 15: 1}  # of Gmsh's element types
BAR, BAR_MASS = np.array([0.11436, 0.02544, 0.00312]), 0.0713  # metres, kg
BAR_CELLS, BAR_TRIANGLES = 48, 1500
CUT = 0.05  # s after the strike, in which the bar hops on its wires
QUIET = 0.1  # s after that, at which modes are compared by their level
PLAIN = (1279.4, 3523.0)  # Hz of two peaks that are not fitted: one falls by under 1 dB, one rattles


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


def bowl(folder: Path, console: Console) -> dict:
    """Fit the ceramic bowl."""
    vertices, faces = boundary(folder / "bowl.obj_.msh")
    lower, upper = vertices[faces].min((0, 1)), vertices[faces].max((0, 1))
    size, ceramic = float((upper - lower).max()), material("ceramic")
    cells = cut_cells((vertices - (lower + upper) / 2) / size, faces, CELLS, SUBDIVISIONS, "bowl")
    modes = solve_modes(cells.assemble(ceramic, size), 20000.0, 256, "bowl")
    computed = np.sqrt(modes.eigenvalues) / (2 * np.pi)
    sounds, rate = resample_to_lowest([read_recording(path) for path in sorted(folder.glob("mic*.wav"))])
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
    return {
        "raw": raw,
        "fitted": fit.frequency_error,
        "modes": len(hertz),
        "decay": errors,
        "stiffness": match.stiffness,
        "material": fit.material,
    }


@dataclass(frozen=True)
class BarModes:
    """Modes of a bar of some material and ratio of thickness to width."""

    hertz: np.ndarray  #: (M,)
    radiated: np.ndarray  #: decay rate by the sound that each sends out, 1/s; (M,)


def bar_modes(youngs_modulus: float, squeeze: float, poisson_ratio: float, radiating: bool) -> BarModes:
    """Compute the modes of the bar, whose thickness is multiplied and whose width is divided by `squeeze`."""
    size = BAR * [1, 1 / squeeze, squeeze]
    steel: Material = replace(
        material("steel"),
        density=BAR_MASS / float(size.prod()),
        youngs_modulus=youngs_modulus,
        poisson_ratio=poisson_ratio,
    )
    box = trimesh.creation.box(size / size[0])
    vertices, faces = np.array(box.vertices), np.array(box.faces)
    cells = cut_cells(vertices, faces, BAR_CELLS, SUBDIVISIONS, "bar")
    fem = cells.assemble(steel, float(size[0]))
    modes = solve_modes(fem, 22000.0, 64, "bar")
    angular = np.sqrt(modes.eigenvalues)
    radiated = np.zeros(len(angular))
    if radiating:
        points = np.array(box.subdivide_to_size(0.012).vertices)
        shapes = cells.interpolate(modes.shapes.reshape(len(fem.nodes), -1), points)
        shapes = shapes.reshape(len(points), 3, -1)
        surface = vertices * size[0], faces
        field = radiate(surface, points * size[0], shapes, angular, BAR_TRIANGLES)
        # Power over twice the energy, both of a unit amplitude of modal acceleration.
        radiated = (abs(field.coefficients) ** 2).sum(1) * angular**2 / (2 * AIR_DENSITY * SOUND_SPEED)
    return BarModes(angular / (2 * np.pi), radiated)


def bar_heard(path: Path) -> Ringdown:
    """Return the modes that ring after the bar has come to rest on its wires: of each band, the loudest.

    Its hopping gives strong modes weaker side lines, 20 to 40 Hz away.
    """
    sound, rate = read_recording(path)
    tap = strikes(sound, rate)[0][round(CUT * rate) :]
    heard = ringdown([tap], rate, highest=21000.0)
    level = heard.level * np.exp(-heard.damping * QUIET)
    best = [
        row
        for row, hertz in enumerate(heard.frequency)
        if level[row] == level[abs(heard.frequency - hertz) < BAND / 2].max() and level[row] > 1e-4
    ]
    return Ringdown(*(array[best] for array in vars(heard).values()))


def pairs(computed: np.ndarray, heard: np.ndarray) -> np.ndarray:
    """Return the computed mode of each heard one, within a tenth, one to one."""
    far = np.minimum(abs(np.log(heard)[:, None] - np.log(computed)), 0.1)
    return linear_sum_assignment(far)[1]


def bar(path: Path, console: Console) -> dict:
    """Compare the steel bar as given, and with three unknowns fitted."""
    heard, steel = bar_heard(path), material("steel", "loss_factor")

    def misfit(unknown: np.ndarray) -> np.ndarray:
        hertz = bar_modes(steel.youngs_modulus * unknown[0], unknown[1], unknown[2], False).hertz
        return np.log(hertz[pairs(hertz, heard.frequency)] / heard.frequency)

    found = least_squares(misfit, [1.05, 1.007, 0.27], diff_step=1e-2, xtol=1e-4)
    fitted = bar_modes(steel.youngs_modulus * found.x[0], found.x[1], found.x[2], True)
    rows = pairs(fitted.hertz, heard.frequency)
    given = bar_modes(steel.youngs_modulus, 1.0, steel.poisson_ratio, False)
    # As given, modes 4 and 5 (3rd bending, 2nd torsion) are in the other order: pair by the fit's ratios.
    raw = given.hertz[rows] / heard.frequency - 1
    left = (1 + raw) / np.exp(np.median(np.log1p(raw))) - 1
    loss = heard.damping - fitted.radiated[rows]
    slow = np.argsort(heard.damping / heard.frequency)[:2]
    inside = float(np.mean(loss[slow] / (np.pi * heard.frequency[slow])))
    decays = {
        "heard": heard.damping,
        "table": steel.damping((2 * np.pi * heard.frequency) ** 2),
        "radiated": fitted.radiated[rows],
        "both": fitted.radiated[rows] + np.pi * heard.frequency * inside,
    }
    table = Table("heard Hz", "as given", "fitted", *(f"T60 {name}, s" for name in decays), title="steel bar")
    for i, hertz in enumerate(heard.frequency):
        off = fitted.hertz[rows[i]] / hertz - 1
        times = (f"{LN_1000 / rates[i]:.3g}" for rates in decays.values())
        table.add_row(f"{hertz:.1f}", f"{raw[i]:+.2%}", f"{off:+.2%}", *times)
    console.print(table)
    predicted = [float(fitted.hertz[abs(fitted.hertz - hertz).argmin()]) for hertz in PLAIN]
    rest = np.setdiff1d(np.arange(len(rows)), slow)
    errors = {
        name: float(np.median(abs(np.log(decays[name][rest] / heard.damping[rest]))))
        for name in ("table", "radiated", "both")
    }
    rms = [float(np.sqrt(np.mean(np.square(error)))) for error in (raw, left, found.fun)]
    thick, wide = 1000 * BAR[2] * found.x[1], 1000 * BAR[1] / found.x[1]
    console.print(
        f"{len(rows)} modes, root mean square: {rms[0]:.2%} as given, {rms[1]:.2%} with one stiffness, "
        f"{rms[2]:.3%} with {found.x[0]:.4f} times Young's modulus, {thick:.3f} x {wide:.2f} mm and "
        f"Poisson's ratio {found.x[2]:.3f}; not fitted, Hz: "
        f"{', '.join(f'{hertz} heard, {own:.1f} computed' for hertz, own in zip(PLAIN, predicted))}\n"
        f"loss factor inside {inside:.2g}; decay rates of the {len(rest)} others, median of |ln ratio|: "
        f"{', '.join(f'{name} {value:.2f}' for name, value in errors.items())}",
        highlight=False,
    )
    return {
        **dict(zip(("raw", "stiffness_only", "fitted"), rms)),
        "unknowns": found.x.tolist(),
        "modes": len(rows),
        "not_fitted": dict(zip(map(str, PLAIN), predicted)),
        "loss_factor": inside,
        "decay": errors,
        "decay_rates": {name: rates.tolist() for name, rates in decays.items()},
        "hertz": heard.frequency.tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bowl", type=Path, metavar="DIR", help="with bowl.obj_.msh and mic*.wav")
    parser.add_argument("--bar", type=Path, metavar="WAV", help="of the steel bar")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parser.parse_args()
    if not given.bowl and not given.bar:
        parser.error("give --bowl, --bar or both")
    console, figures = Console(), {}
    if given.bowl:
        figures["bowl"] = bowl(given.bowl, console)
    if given.bar:
        figures["bar"] = bar(given.bar, console)
    write_record(given.json, figures)
    own = figures.get("bowl", {"raw": 0.0, "fitted": 0.0})
    sys.exit(own["raw"] > MAX_RAW or own["fitted"] > MAX_FITTED)


if __name__ == "__main__":
    main()
