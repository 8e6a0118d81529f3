"""Accuracy of the modal analysis against exact solutions and refined grids: `python perf/modal_accuracy.py`.

Prints one table; exits with 1 if a row misses its target. `--objects DIR` adds real meshes (one `mesh.*` in
each subfolder, minutes each), `--tetrahedra` the mug against quadratic tetrahedra.
Set OMP_NUM_THREADS=1: the seconds are CPU time of one core.
"""

import argparse
import itertools
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg
from harness import parsed, write_record
from numpy.polynomial import legendre
from rich.console import Console
from rich.table import Table

from objectfolder.base.materials import Material, material
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.sampling import sample_surface
from objectfolder.shapes import generate
from objectfolder.sound.fem.blocks import merge_full_blocks
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import Modes, solve_modes
from objectfolder.sound.fem.elements import discretize
from objectfolder.sound.fem.modal import Request, refined_analysis
from objectfolder.sound.fem.settings import FineGrids
from objectfolder.workspace import params

ROOT = Path(__file__).parents[1]
STUFF = Material("stuff", 1000.0, 1e9, 0.3, 0.0, 0.0)
WAVE = np.sqrt(STUFF.youngs_modulus / STUFF.density)
# Free square plate, nu = 0.3: Leissa's table (1973), whose values are up to 1 % high, and converged values.
LEISSA = (13.489, 19.789, 24.432, 35.024, 35.024, 61.526)
KIRCHHOFF = (13.468, 19.596, 24.270, 34.801, 34.801, 61.093)
#: material, longest side in metres, modal seconds allowed
OBJECTS = {
    "gso_salad_plate": ("ceramic", 0.222, 30.0),
    "gso_school_bell": ("steel", 0.160, 30.0),
    "ycb_bowl": ("steel", 0.162, 30.0),
    "ycb_mug": ("steel", 0.117, 90.0),
    "polyhaven_wooden_table": ("wood", 1.134, 180.0),
}
REFINED = 1.5  #: times the cells along the longest side, on the grid that real objects are compared with


@dataclass(frozen=True)
class Row:
    """Line of the table."""

    name: str
    value: float
    target: float
    detail: str = ""


def hertz(modes: Modes) -> np.ndarray:
    """Frequencies in Hz."""
    return np.sqrt(modes.eigenvalues) / (2 * np.pi)


def box(
    sides: tuple[float, float, float], centre: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Build a box; vertices and outward faces."""
    corner = (np.indices((2, 2, 2)).reshape(3, -1).T - 0.5) * sides + centre
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return corner, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def tube(outer: float, inner: float, height: float, around: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """Build a pipe along z from polygons with the circles' areas; vertices and outward faces."""
    angle = 2 * np.pi * np.arange(around) / around
    grow = np.sqrt(2 * np.pi / around / np.sin(2 * np.pi / around))
    ring = np.stack([np.cos(angle), np.sin(angle)], 1) * grow
    corners = ((outer, -height / 2), (outer, height / 2), (inner, height / 2), (inner, -height / 2))
    vertices = np.concatenate([np.c_[ring * radius, np.full(around, z)] for radius, z in corners])
    i, faces = np.arange(around), []
    for k in range(4):
        a, b = k * around + i, k * around + (i + 1) % around
        c, d = (k + 1) % 4 * around + i, (k + 1) % 4 * around + (i + 1) % around
        faces += [np.stack([a, b, d], 1), np.stack([a, d, c], 1)]
    return vertices, np.concatenate(faces)


def plate(name: str = "Leissa", truth: tuple[float, ...] = LEISSA) -> Row:
    """Square plate, 1/50 thick, a quarter of a cell."""
    thick = 0.02
    fem = cut_cells(*box((1, 1, thick), (0, 0, 0.013)), 12, 8).assemble(STUFF, 1.0)
    found = hertz(solve_modes(fem, 1e4, 6))
    exact = np.array(truth) * WAVE * thick / np.sqrt(12 * (1 - 0.3**2)) / (2 * np.pi)
    return Row(f"free square plate, 6 modes, {name}", float(np.abs(found / exact - 1).max()), 0.01)


def pipe_modes(outer: float, inner: float, height: float, wave: int, degree: int = 9) -> np.ndarray:
    """Compute frequencies, Hz, of a free pipe's modes with ``wave`` > 1 periods around; Ritz, 3-D elasticity.

    Displacements are (U cos, V sin, W cos) of the angle; U, V, W are products of Legendre polynomials of
    radius and height, which converge exponentially.
    """
    nu, modulus = STUFF.poisson_ratio, STUFF.youngs_modulus
    x, w = legendre.leggauss(2 * degree)
    scale = np.array([(outer - inner) / 2, height / 2])
    r, _ = np.meshgrid((outer + inner) / 2 + scale[0] * x, scale[1] * x, indexing="ij")
    weight = (np.outer(w, w) * scale.prod() * r).ravel()
    one = legendre.legvander(x, degree - 1)
    slope = np.stack([legendre.legval(x, legendre.legder(u)) for u in np.eye(degree)], 1)

    def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.einsum("qi,pj->qpij", a, b).reshape(len(x) ** 2, -1)

    f, fr, fz = product(one, one), product(slope, one) / scale[0], product(one, slope) / scale[1]
    g, none = f / r.ravel()[:, None], np.zeros_like(f)
    strain = np.stack(
        [
            np.concatenate(row, 1)
            for row in (
                (fr, none, none),
                (g, wave * g, none),
                (none, none, fz),
                (-wave * g, fr - g, none),
                (fz, none, fr),
                (none, fz, -wave * g),
            )
        ]
    )
    shear = modulus / (2 * (1 + nu))
    rigidity = np.diag([2 * shear] * 3 + [shear] * 3)
    rigidity[:3, :3] += modulus * nu / ((1 + nu) * (1 - 2 * nu))
    stiffness = np.einsum("aqi,ab,bqj,q->ij", strain, rigidity, strain, weight, optimize=True)
    mass = scipy.linalg.block_diag(*[STUFF.density * (f * weight[:, None]).T @ f] * 3)
    values = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
    return np.sqrt(values.clip(0)) / (2 * np.pi)


def cylinder(wall: float, resolution: int = 16) -> Row:
    """Free pipe whose wall is ``wall`` cells thick; the pairs with 2 and 3 waves around."""
    outer, thick = 0.5, wall / resolution
    solid = tube(outer, outer - thick, 0.4)
    truth = np.sort(np.concatenate([pipe_modes(outer, outer - thick, 0.4, n)[:2] for n in (2, 3)]))[:4]
    found = hertz(solve_modes(cut_cells(*solid, resolution, 8).assemble(STUFF, 1.0), 1e4, 8))
    error = float(np.abs(found / np.repeat(truth, 2) - 1).max())
    return Row(f"free cylinder, wall {wall:g} cells, 8 modes", error, 0.01)


def timoshenko(thick: float, count: int, degree: int = 24) -> np.ndarray:
    """Compute bending frequencies, Hz, of a free rectangular bar of length 1; Ritz, Legendre polynomials."""
    nu = STUFF.poisson_ratio
    shear = 10 * (1 + nu) / (12 + 11 * nu) / (2 * (1 + nu))  # of the modulus; Cowper's coefficient
    x, w = legendre.leggauss(2 * degree)
    value = legendre.legvander(x, degree - 1)
    slope = 2 * np.stack([legendre.legval(x, legendre.legder(u)) for u in np.eye(degree)], 1)

    def inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (a * w[:, None] / 2).T @ b

    bend = thick**2 / 12
    cross = -shear * inner(slope, value)
    stiffness = np.block(
        [
            [shear * inner(slope, slope), cross],
            [cross.T, shear * inner(value, value) + bend * inner(slope, slope)],
        ]
    )
    mass = scipy.linalg.block_diag(inner(value, value), bend * inner(value, value))
    values = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
    return WAVE * np.sqrt(values[2 : 2 + count]) / (2 * np.pi)


def beam() -> Row:
    """Slender bar, sections 1/40 by 1/25, first four bending modes across the thin side."""
    thick, wide = 0.025, 0.04
    fem = cut_cells(*box((1, wide, thick), (0, 0.007, 0.009)), 20, 8).assemble(STUFF, 1.0)
    truth = timoshenko(thick, 4)
    modes = solve_modes(fem, 1.2 * truth[-1], 40)
    share = (modes.shapes.reshape(len(fem.nodes), 3, -1)[:, 2] ** 2).sum(0) / (modes.shapes**2).sum(0)
    found = hertz(modes)[share > 0.6][:4]
    return Row("free slender beam, 4 bending modes", float(np.abs(found / truth - 1).max()), 0.01)


def aligned_volume() -> Row:
    """Measure the volume of a thin table top parallel to the grid, at many positions."""
    errors = []
    for axis, x in itertools.product(range(3), (0.0, 0.007, 0.013)):
        vertices, faces = box((0.02, 0.6, 1), (x, 0, 0))
        errors.append(cut_cells(np.roll(vertices, axis, axis=1), faces, 24, 8).volume_error)
    return Row("volume of an axis-aligned board", float(np.abs(errors).max()), 0.003)


def mug(resolution: int = 16) -> Row:
    """Compare cut cells with quadratic tetrahedra on a mug with a wall of 4 mm."""
    solid = normalize(generate("mug", texture_size=64), "mug").surface.mesh
    kinds = (("cut_cell_hex20", 32), ("tet10", resolution))
    found = []
    for kind, cells in kinds:
        divided = discretize(*solid, kind, [cells], 8, 10**9, "mug")
        found.append(hertz(solve_modes(divided.assemble(material("ceramic"), 0.112), 2e4, 8)))
    detail = f"tet10 {divided.degrees_of_freedom} unknowns"
    return Row("mug, wall 4 mm, 8 modes, tet10", float(np.abs(found[0] / found[1] - 1).max()), 0.015, detail)


def real(path: Path) -> list[Row]:
    """Measure a real object: the stage's own figures, and its grid against a finer one."""
    key = path.parent.name
    stuff, scale, seconds = OBJECTS[key]
    values = params.read(ROOT / "params.yaml")
    section = {name: v for name, v in values["voxelize"].items() if name != "sdf_resolution"}
    up = "y" if path.suffix in (".gltf", ".glb") else "z"
    solid = normalize(load_mesh(path, up), key).surface.mesh
    fine = FineGrids(**values["modal"]["fine"])
    divided = discretize(*solid, **section, name=key)
    start = time.process_time()
    points = np.concatenate([solid[0], sample_surface(*solid, 8000, np.random.default_rng(0))])
    limits = values["modal"]["max_frequency"], 1000
    report = refined_analysis(
        divided, solid, fine, points, Request(material(stuff), scale, *limits), key
    ).report
    spent = time.process_time() - start
    cells = round(REFINED * report["resolution"])
    finer = merge_full_blocks(cut_cells(*solid, cells, 6, key))
    exact = hertz(solve_modes(finer.assemble(material(stuff), scale), limits[0], 8))
    found = np.array(report["lowest_hz"])[: len(exact)]
    detail = f"{report['resolution']}^3, {report['degrees_of_freedom']} unknowns, {report['modes']} modes"
    estimate = max(report["discretisation_error"] or [np.nan])
    return [
        Row(f"{key}: 8 modes, {cells}^3", float(np.abs(found / exact - 1).max()), 0.02, detail),
        Row(f"{key}: estimate of that", estimate, np.inf),
        Row(f"{key}: volume", abs(report["volume_error"]), 0.003),
        Row(f"{key}: residual", report["residual_max"], 1e-8),
        Row(f"{key}: rigid Hz", max(report["rigid_hz"]), 0.1),
        Row(f"{key}: CPU s", spent, seconds, detail),
    ]


def threads() -> Row:
    """Compare the mode shapes of one object solved with one and with two threads."""
    code = (
        "import sys; from modal_accuracy import *;"
        "s = normalize(generate('bell', texture_size=64)).surface.mesh;"
        "f = cut_cells(*s, 16, 8).assemble(material('steel'), .09);"
        "np.save(sys.argv[1], solve_modes(f, 2e4, 40).shapes)"
    )
    shapes = []
    for count in ("1", "2"):
        target = ROOT / "build" / "perf" / f"threads{count}.npy"
        target.parent.mkdir(parents=True, exist_ok=True)
        variables = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), count)
        command = [sys.executable, "-c", code, str(target)]
        subprocess.run(command, cwd=ROOT / "perf", env=os.environ | variables, check=True)
        shapes.append(np.load(target, allow_pickle=False))
        target.unlink()
    return Row(
        "shapes, 1 and 2 threads", float(np.abs(shapes[0] - shapes[1]).max() / np.abs(shapes[0]).max()), 1e-8
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=Path, help="folder of real meshes")
    parser.add_argument("--tetrahedra", action="store_true", help="compare the mug with tet10")
    parser.add_argument("--json", type=Path)
    arguments = parsed(parser)
    rows = [
        plate(),
        plate("converged", KIRCHHOFF),
        *(cylinder(wall) for wall in (0.5, 1, 2)),
        beam(),
        aligned_volume(),
        threads(),
    ]
    if arguments.tetrahedra:
        rows.append(mug())
    for path in sorted(arguments.objects.glob("*/mesh.*")) if arguments.objects else []:
        if path.parent.name in OBJECTS and path.suffix in (".obj", ".glb", ".gltf", ".ply", ".stl"):
            rows += real(path)
    table = Table("quantity", "value", "target", "", "detail")
    for row in rows:
        met = "met" if row.value <= row.target else "MISSED"
        table.add_row(row.name, f"{row.value:.3g}", f"{row.target:g}", met, row.detail)
    Console(width=120).print(table)
    finite = [vars(row) | {"target": row.target if np.isfinite(row.target) else None} for row in rows]
    missed = [f"{row.name}: {row.value:.3g}, target {row.target:g}" for row in rows if row.value > row.target]
    write_record(arguments.json, finite, "in the table", missed)
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
