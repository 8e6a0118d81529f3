"""Errors of the lowest modes against the cells' size: `python perf/modal_convergence.py`.

Plates of 1/10 to 1/200 and a pipe against Ritz solutions of three-dimensional elasticity, an L-profile and an
open box of panels against quadratic tetrahedra, all turned against the grid. Prints a table with the observed
orders; `--picture FILE.png` draws it. Half an hour with the tetrahedra (`--tetrahedra`, needs tetgen, see
modal_reference.py), else their recorded frequencies are used; a few minutes without.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg
from harness import parsed, write_record
from modal_accuracy import STUFF, box, pipe_modes, tube
from numpy.polynomial import legendre
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from objectfolder.mesh.topology import Mesh, signed_volume
from objectfolder.sound.fem.accuracy import Discretisation
from objectfolder.sound.fem.blocks import merge_full_blocks
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import FreeVibration

MODES = 6
RESOLUTIONS = (12, 16, 24, 32, 48)
TURN = Rotation.from_rotvec([0.31, 0.17, 0.23])  # so that no face lies along the grid
SHIFT = (0.003, 0.007, 0.013)
PROFILE, WALL = 0.25, 0.02  #: legs and wall of the L-profile of length 1
PANELS, BOARD = (1.0, 0.7, 0.5), 0.03
#: Lowest frequencies by `--tetrahedra`, Hz.
TETRAHEDRA = {
    "L-profile, wall 1/50": (32.3374, 57.3529, 71.7653, 80.3710, 85.2834, 98.9965),  # 339,783 unknowns
    "open box, boards 3/100": (16.4319, 33.1911, 44.1848, 61.2713, 62.8412, 76.0294),  # 396,699 unknowns
}


@dataclass(frozen=True)
class Case:
    """A solid, its wall and its true lowest frequencies."""

    name: str
    surface: Mesh  #: longest side 1, along the axes
    wall: float
    truth: np.ndarray  #: (MODES,) Hz


def box_modes(sides: tuple[float, float, float], count: int = MODES, degree: int = 14) -> np.ndarray:
    """Compute frequencies, Hz, of a free box; Ritz, three-dimensional elasticity, Legendre polynomials.

    The method of resonant ultrasound spectroscopy (Visscher et al., JASA 1991). Across a thin side a few
    polynomials suffice.
    """
    degrees = [degree if side > 0.3 * max(sides) else 6 for side in sides]
    index = np.indices(degrees).reshape(3, -1).T
    x, w = legendre.leggauss(degree + 1)
    value = legendre.legvander(x, degree - 1)
    slope = np.stack([legendre.legval(x, legendre.legder(unit)) for unit in np.eye(degree)], 1)
    scale = np.sqrt(np.arange(degree) + 0.5)  # orthonormal on [-1, 1]
    value, slope = value * scale, slope * scale
    tables = {
        "00": np.einsum("qi,q,qj->ij", value, w, value),
        "01": np.einsum("qi,q,qj->ij", value, w, slope),
        "10": np.einsum("qi,q,qj->ij", slope, w, value),
        "11": np.einsum("qi,q,qj->ij", slope, w, slope),
    }

    def inner(a: int, b: int) -> np.ndarray:
        """Integrate the derivative along axis a times that along axis b, per volume."""
        out = np.ones((len(index),) * 2)
        for axis in range(3):
            kind = f"{int(axis == a)}{int(axis == b)}"
            half = sides[axis] / 2
            out *= tables[kind][index[:, axis][:, None], index[:, axis]] / half ** (kind.count("1"))
        return out

    nu, modulus = STUFF.poisson_ratio, STUFF.youngs_modulus
    lame, shear = modulus * nu / ((1 + nu) * (1 - 2 * nu)), modulus / (2 * (1 + nu))
    products = [[inner(a, b) for b in range(3)] for a in range(3)]
    trace = sum(products[a][a] for a in range(3))
    stiffness = np.block(
        [
            [
                lame * products[a][b] + shear * products[b][a] + (shear * trace if a == b else 0)
                for b in range(3)
            ]
            for a in range(3)
        ]
    )
    values = scipy.linalg.eigvalsh(stiffness / STUFF.density)
    return np.sqrt(values[6 : 6 + count]) / (2 * np.pi)


def profile() -> Mesh:
    """Build an L-profile of length 1."""
    a, t = PROFILE, WALL
    section = np.array([(0, 0), (a, 0), (a, t), (t, t), (t, a), (0, a)]) - a / 2
    ends = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    here = np.arange(6)
    there = np.roll(here, -1)
    sides = np.concatenate([np.c_[here, there, there + 6], np.c_[here, there + 6, here + 6]])
    vertices = np.concatenate([np.c_[section, np.full(6, z)] for z in (-0.5, 0.5)])
    return vertices, np.concatenate([ends[:, ::-1], ends + 6, sides])


def panels() -> Mesh:
    """Build an open box of five panels."""
    sides, t = np.array(PANELS), BOARD
    outer, faces = box(PANELS, (0, 0, 0))
    inner, _ = box(tuple(sides - [2 * t, 2 * t, t]), (0, 0, t / 2))  # both end at the top
    top = np.array([1, 5, 7, 3])  # corners around the opening
    keep = faces[~np.isin(faces, top).all(1)]
    following = np.roll(top, -1)
    rim = np.concatenate([np.c_[top, following, following + 8], np.c_[top, following + 8, top + 8]])
    return np.concatenate([outer, inner]), np.concatenate([keep, keep[:, ::-1] + 8, rim])


def tetrahedra(name: str, surface: Mesh, wall: float) -> np.ndarray:
    """Solve on 40,000 or more quadratic tetrahedra with edges of at most about the wall; Hz."""
    import tetgen

    from objectfolder.sound.fem.tetrahedra import quadratic

    largest = min(wall**3, signed_volume(*surface) / 40_000)
    vertices, faces = np.ascontiguousarray(surface[0], float), surface[1].astype(np.int32)
    made = tetgen.TetGen(vertices, faces).tetrahedralize(switches=f"pq10a{largest:.3g}Q")
    solid = quadratic(np.asarray(made[0]), np.asarray(made[1])[:, :4].astype(np.int64), 1)
    values = FreeVibration(solid.assemble(STUFF, 1.0)).lowest(lambda found: MODES, 1e-4)[0]
    found = np.sqrt(values[:MODES]) / (2 * np.pi)
    print(f"{name}: {solid.degrees_of_freedom:,} unknowns, {', '.join(f'{f:.4f}' for f in found)}")
    return found


def cases(solve_tetrahedra: bool = False) -> list[Case]:
    """Return the solids with their truth."""
    out = []
    for slenderness in (10, 50, 200):
        sides = (1.0, 0.8, 1 / slenderness)
        out.append(Case(f"plate 1/{slenderness}", box(sides, (0, 0, 0)), sides[2], box_modes(sides)))
    outer, thick, height = 0.25, 0.01, 1.0
    pairs = np.concatenate([pipe_modes(outer, outer - thick, height, n, 14)[:3] for n in (2, 3)])
    out.append(
        Case(
            "pipe, wall 1/100",
            tube(outer, outer - thick, height),
            thick,
            np.repeat(np.sort(pairs), 2)[:MODES],
        )
    )
    for name, surface, wall in (
        ("L-profile, wall 1/50", profile(), WALL),
        ("open box, boards 3/100", panels(), BOARD),
    ):
        truth = tetrahedra(name, surface, wall) if solve_tetrahedra else np.array(TETRAHEDRA[name])
        out.append(Case(name, surface, wall, truth))
    return out


def errors(case: Case, resolution: int) -> np.ndarray:
    """Return the relative errors of the lowest modes on a grid; (MODES,)."""
    vertices = TURN.apply(case.surface[0])
    span = np.ptp(vertices, axis=0)
    vertices = (vertices - vertices.min(0) - span / 2) * 0.97 + SHIFT  # inside the unit cube
    cells = merge_full_blocks(cut_cells(vertices / max(1, span.max()), case.surface[1], resolution, 6))
    found = Discretisation(cells, STUFF, max(1, span.max()) / 0.97).lowest_frequencies(MODES)
    return found / case.truth - 1


def order(sizes: np.ndarray, worst: np.ndarray) -> float:
    """Fit the power of the cells' size with which an error falls."""
    return float(np.polyfit(np.log(sizes), np.log(worst), 1)[0])


def draw(rows: list[dict], path: Path) -> None:
    """Draw the errors over the cells' size."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for row in rows:
        percent = 100 * np.array(row["errors"])
        (line,) = axes.loglog(row["resolutions"], percent, "o-")
        end = (row["resolutions"][-1] * 1.04, percent[-1])
        color = line.get_color()
        axes.annotate(row["name"], end, color=color, fontsize=9, va="center", annotation_clip=False)
    axes.set_xlabel("cells along the longest side")
    axes.set_ylabel("largest error of six modes, %")
    axes.set_xticks(RESOLUTIONS, [str(r) for r in RESOLUTIONS])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tetrahedra", action="store_true", help="solve the tetrahedra again")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parsed(parser)
    rows = []
    for case in cases(arguments.tetrahedra):
        worst = np.array([np.abs(errors(case, resolution)).max() for resolution in RESOLUTIONS])
        fit = order(1 / np.array(RESOLUTIONS), worst)
        rows.append({"name": case.name, "resolutions": RESOLUTIONS, "errors": worst.tolist(), "order": fit})
    table = Table("solid", *(f"{r}^3, %" for r in RESOLUTIONS), "order")
    for row in rows:
        table.add_row(row["name"], *(f"{100 * e:.2f}" for e in row["errors"]), f"{row['order']:.1f}")
    Console(width=110).print(table)
    write_record(arguments.json, rows)
    if arguments.picture:
        draw(rows, arguments.picture)


if __name__ == "__main__":
    main()
