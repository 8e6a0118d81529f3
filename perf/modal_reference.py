"""Lowest modes of real and thin objects against quadratic tetrahedra: `python perf/modal_reference.py`.

The tetrahedra keep the facets of the solid (TetGen) or stay close (fTetWild). Where the surface of a scan
crosses itself, both solvers get the solid that MeshFix makes of it. Two meshes of each object show how far
the reference itself is converged; the finer one is the reference. References take minutes each and are kept
under --cache. CPU s is the time of the grids and of the lowest modes; the stages' own is in perf/modal.py.

Needs, for thin walls and scans, `pip install tetgen pymeshfix` (AGPL, GPL: never
installed by this project). Rows of other objects in the file of `--json` are kept.
`--objects DIR` adds real meshes, one `mesh.*` in each subfolder. `--workspace DIR` compares instead solids of
a workspace, with its materials, sizes and parameters: of the paper's objects that it lists, `--draw` drawn by
`--seed`, whatever became of them; names are then some of these. Exits with 1 if a target is missed.
"""

import argparse
import random
import time
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import igl
import numpy as np
from harness import exit_with_verdict, fresh, parsed, run_job, this_run, write_record
from modal_accuracy import tube
from rich.console import Console
from rich.table import Table
from scipy.optimize import linear_sum_assignment

from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.base.io import read_json
from objectfolder.base.materials import Material, material, own_material
from objectfolder.hub.fetch.catalogue import read_catalogue
from objectfolder.mesh.closing.piercing import self_intersections
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.ply import read_surface
from objectfolder.mesh.raycast import wall_thickness
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.topology import Mesh, components, signed_volume
from objectfolder.shapes import generate
from objectfolder.sound.fem.eigen import FreeVibration
from objectfolder.sound.fem.elements import discretize
from objectfolder.sound.fem.modal import Request, refined_analysis
from objectfolder.sound.fem.settings import ModalConfig
from objectfolder.sound.fem.tetrahedra import Tetrahedra, quadratic
from objectfolder.workspace import params
from objectfolder.workspace.layout import Build

ROOT = Path(__file__).parents[1]
MODES = 10  #: compared
SPARES = 3  #: more modes of ours that may hold a share of a reference shape
POINTS = 600  #: of the surface, at which shapes are compared
TOLERANCE = 1e-4  #: residual of the reference's modes; the error of their frequencies is its square
ALIKE = 0.3  #: least squared cosine of shapes that belong together; repeated modes mix
CLUSTER = 0.01  #: modes this close (relative) may mix, and are compared as one subspace
GOOD, BAD = 0.02, 0.04  #: largest difference of the ten modes: for `Limits.share` of the objects, for all
SMALL = 0.002  #: differences of the size of the reference's own error, which say nothing about the estimate


class Limits(NamedTuple):
    """Targets of a set of objects."""

    share: float  #: of the objects that are within GOOD
    low: float  #: the estimate is at least the difference divided by this
    high: float  #: the estimate is at most the difference times this
    words: str


KNOWN = Limits(18 / 22, 3, np.inf, "for 18 of 22 objects and 4% for all; estimate at least a third of it")
DRAWN = Limits(8 / 10, 2, 2, "for 8 of 10 objects and 4% for all; estimate within a factor of two of it")

#: material and longest side in metres
REAL = {
    "gso_bunny_racer": ("polycarbonate", 0.112),
    "gso_frypan": ("steel", 0.356),
    "gso_salad_plate": ("ceramic", 0.222),
    "gso_school_bell": ("steel", 0.160),
    "polyhaven_teapot": ("ceramic", 0.268),
    "polyhaven_wooden_stool": ("wood", 0.579),
    "polyhaven_wooden_table": ("wood", 1.134),
    "ycb_bowl": ("steel", 0.162),
    "ycb_cup_a": ("polycarbonate", 0.061),
    "ycb_medium_clamp": ("iron", 0.089),
    "ycb_mug": ("steel", 0.117),
    "ycb_nine_hole_peg_test": ("wood", 0.191),
    "ycb_pitcher": ("plastic", 0.242),
    "ycb_power_drill": ("plastic", 0.188),
    "ycb_tomato_soup_can": ("steel", 0.102),
    "ycb_wood_block": ("wood", 0.206),
}
#: material, longest side, generator and its parameters
PROCEDURAL: dict[str, tuple[str, float, str, dict[str, Any]]] = {
    "rimmed_plate": ("steel", 0.26, "plate", {"wall": 0.0015, "foot_height": 0.001, "height": 0.02}),
    "pan": ("steel", 0.42, "pan", {"wall": 0.002}),
    "shelf_box": ("wood", 1.2, "shelf", {"bays": 3, "board_thickness": 0.018, "back": 0.006}),
    "table": ("wood", 1.4, "table", {}),
    "spoon": ("steel", 0.19, "spoon", {"wall": 0.0015}),
    "tube": ("steel", 0.2, "tube", {}),
}
#: Largest volume of a tetrahedron of the coarse and the fine mesh, in cubes of the wall. A bound on their
#: quality alone leaves flat plates to tetrahedra 17 walls long, 4 % too stiff.
SIZES = {"coarse": 4.0, "fine": 1.0}
FACETS = 0.8  #: share of the fine mesh's unknowns above which the coarse one differs too little from it,
#: because facets are small. A third mesh then has tetrahedra of at most this many times the fine one's mean
#: volume, which gives a third to a half more: those inside are larger than those at the surface.
FINER = 2.0
UNKNOWNS = 4  #: of a quadratic tetrahedron's own, about
QUALITY = 10  #: largest ratio of radius and edge
TETRAHEDRA, FEWEST = 40_000, 5_000  #: of the volume: more than the first are not asked for, nor fewer
MAX_VOLUME = 1e-4  #: of a tetrahedron, unit frame: edges of about a tenth
ENVELOPE = 2e-4  #: of fTetWild, where TetGen refuses even a mended surface; in diagonals
SAME = 0.01  #: largest relative change of the volume by mending
SPECK = 1e-7  #: least volume of a piece, unit frame
THINNED = 0.99  #: share of the faces left where TetGen fails on those of a mended surface


def is_workspace(folder: str | Path | None) -> bool:
    """Return whether objects are those of a workspace, not meshes of a folder or procedural ones."""
    return folder is not None and Path(folder, params.PARAMS_FILE).is_file()


def candidates(workspace: Path) -> list[str]:
    """Return the objects of the paper that a workspace lists, sorted."""
    listed = params.read(workspace / params.PARAMS_FILE)["objects"]
    return sorted(set(listed) & set(read_catalogue(ROOT / "catalogs/objectfolder1.yaml").objects))


def draw(keys: list[str], count: int, seed: int) -> list[str]:
    """Draw some of the keys, for a seed always the same; sorted."""
    return sorted(random.Random(seed).sample(keys, min(count, len(keys))))


def surface_of(name: str, folder: str) -> Mesh:
    """Return the solid of an object; unit frame. ``folder``: of meshes, or a workspace."""
    if is_workspace(folder):
        return read_surface(Build(name, folder).solid_surface)
    if name in REAL:
        path = next(p for p in Path(folder, name).glob("mesh.*"))
        return normalize(load_mesh(path, "y" if path.suffix == ".gltf" else "z"), name).surface.mesh
    _, _, generator, settings = PROCEDURAL[name]
    if generator == "tube":
        return tube(0.15, 0.1425, 1.0, around=192)
    return normalize(generate(generator, texture_size=128, **settings), name).surface.mesh


def body(name: str, folder: str) -> tuple[Material, float]:
    """Return the material and the longest side in metres."""
    if is_workspace(folder):
        values = params.read(Path(folder, params.PARAMS_FILE))
        entry, law = values["objects"][name], params.settings(ModalConfig, values).damping
        return own_material(entry["material"], law, folder), entry["scale"]
    stuff, scale = REAL[name] if name in REAL else PROCEDURAL[name][:2]
    return material(stuff), scale


def mended(surface: Mesh) -> Mesh:
    """Return a surface whose pieces, cavities included, lack the faces that cross; holes are closed."""
    import pymeshfix

    vertices, faces = surface
    piece = components(*faces[:, [0, 1, 1, 2]].reshape(-1, 2).T, len(vertices))[1][faces[:, 0]]
    found, count = [], 0
    for part in (faces[piece == number] for number in np.unique(piece)):
        if abs(volume := signed_volume(vertices, part)) < SPECK:
            continue
        fixer = pymeshfix.MeshFix(np.ascontiguousarray(vertices, np.float64), part.astype(np.int32))
        fixer.repair()
        points, sides = np.asarray(fixer.points), np.asarray(fixer.faces, np.int64)
        turned = volume * signed_volume(points, sides) < 0
        found.append((points, count + (sides[:, ::-1] if turned else sides)))
        count += len(points)
    return np.concatenate([points for points, _ in found]), np.concatenate([sides for _, sides in found])


def versions(surface: Mesh) -> Iterator[Mesh]:
    """Return the surface and, should TetGen refuse it, ever simpler versions of the same volume."""
    if not self_intersections(*surface):
        yield surface
    volume = signed_volume(*surface)
    for simpler in (surface, igl.decimate(*surface, int(THINNED * len(surface[1])))[:2]):
        found = mended(simpler)
        if abs(signed_volume(*found) / volume - 1) < SAME:
            yield found


def largest_volume(surface: Mesh, name: str, size: str, cache: str) -> float:
    """Return the largest volume of a tetrahedron of a mesh, unit frame."""
    volume, wall = signed_volume(*surface), wall_thickness(*surface)
    if size == "finer":
        unknowns = int(read_npz(Path(cache) / f"{name}_fine.npz", "unknowns")["unknowns"])
        return FINER * volume / (unknowns / UNKNOWNS)
    return SIZES[size] * min(MAX_VOLUME, max(wall**3, volume / TETRAHEDRA), volume / FEWEST)


def fill(surface: Mesh, largest: float) -> tuple[Tetrahedra, Mesh]:
    """Fill a surface with tetrahedra that keep its facets or, if TetGen refuses it, stay near them.

    Returns the surface that was filled, too.
    """
    import tetgen

    for vertices, faces in versions(surface):
        for tolerance in ("", "T1e-10"):  # of coplanar facets
            try:
                with TemporaryDirectory() as folder, chdir(folder):  # it writes the facets that it refuses
                    made = tetgen.TetGen(
                        np.ascontiguousarray(vertices, np.float64), faces.astype(np.int32)
                    ).tetrahedralize(switches=f"p{tolerance}q{QUALITY}a{largest:.3g}Q")
                points, cells = np.asarray(made[0]), np.asarray(made[1])[:, :4].astype(np.int64)
                solid = igl.winding_number(vertices, faces, points[cells].mean(1)) > 0.5  # no cavity
                return quadratic(points, cells[solid], 1), (vertices, faces)
            except RuntimeError:  # crosses itself, or a fault of TetGen
                continue
    import pytetwild

    edge = 2 * np.cbrt(largest)  # volume of a regular tetrahedron: edge^3 / 8.5
    with TemporaryDirectory() as folder, chdir(folder):  # it writes a file into the working directory
        points, cells = pytetwild.tetrahedralize(
            np.ascontiguousarray(surface[0], np.float64),
            surface[1].astype(np.int32),
            edge_length_abs=edge,
            epsilon=ENVELOPE,
            num_threads=1,
        )
    return quadratic(points, cells.astype(np.int64), 1), surface


def reference(name: str, size: str, folder: str, cache: str) -> dict:
    """Solve an object on tetrahedra; write solid, frequencies and shapes to the cache."""
    surface = surface_of(name, folder)
    stuff, scale = body(name, folder)
    solid, surface = fill(surface, largest_volume(surface, name, size, cache))
    points = sample_surface(*surface, POINTS, np.random.default_rng(1))
    fem = solid.assemble(stuff, scale)
    values, vectors = FreeVibration(fem).lowest(lambda found: MODES + SPARES, TOLERANCE)
    shapes = solid.interpolate(vectors.reshape(len(fem.nodes), -1), points).reshape(POINTS, 3, -1)
    write_npz(
        Path(cache) / f"{name}_{size}.npz",
        vertices=surface[0],
        faces=surface[1],
        points=points,
        shapes=shapes.astype(np.float32),
        hz=np.sqrt(values) / (2 * np.pi),
        unknowns=solid.degrees_of_freedom,
        volume_error=solid.volume / signed_volume(*surface) - 1,
    )
    return {"unknowns": solid.degrees_of_freedom}


def agreement(own: np.ndarray, other: np.ndarray, other_hz: np.ndarray, partner: np.ndarray) -> np.ndarray:
    """Return how much of each of our shapes lies in the span of the reference's shapes of its frequency.

    The modal assurance criterion of a single mode, the squared cosine of the angle to the subspace of a
    cluster.

    Parameters
    ----------
    own : (Q, M) array
    other : (Q, N) array, N > M
    other_hz : (N,) array, ascending
    partner : (M,) int array
        Mode of the reference to compare each with.
    """
    out = np.empty(own.shape[1])
    for mode, shape in enumerate(own.T):
        near = np.abs(other_hz / other_hz[partner[mode]] - 1) < CLUSTER
        basis = np.linalg.qr(other[:, near])[0]
        out[mode] = ((basis.T @ shape) ** 2).sum() / (shape @ shape)
    return out


def paired(own: np.ndarray, other: np.ndarray, count: int) -> np.ndarray:
    """Pair our first modes with the reference's by shape: the partner of each, or -1; (count,).

    Parameters
    ----------
    own : (Q, M) array
    other : (Q, N) array
    count : int
    """
    own, other = (shapes / np.linalg.norm(shapes, axis=0) for shapes in (own, other))
    shared = (own.T @ other) ** 2
    row, column = linear_sum_assignment(-shared)
    partner = np.where(shared[row, column] > ALIKE, column, -1)
    return partner[np.argsort(row)][:count]


def meshes(name: str, cache: str) -> list[dict[str, np.ndarray]]:
    """Return the references of an object, coarsest first; the last two differ in size."""
    paths = [Path(cache) / f"{name}_{size}.npz" for size in (*SIZES, "finer")]
    return [read_npz(path, "hz", "unknowns") for path in paths if path.exists()]


def alike(found: list[dict[str, np.ndarray]]) -> bool:
    """Return whether two references are of nearly the same size."""
    return len(found) == 2 and bool(found[0]["unknowns"] > FACETS * found[1]["unknowns"])


def apart_meshes(found: list[dict[str, np.ndarray]]) -> float | None:
    """Return the largest difference of the modes of the last two references; None of one."""
    if len(found) < 2 or alike(found):
        return None
    coarse, fine = (reference["hz"][:MODES] for reference in found[-2:])
    return float(np.abs(coarse / fine - 1).max())


def compare(name: str, folder: str, cache: str) -> dict:
    """Compare the modes of `voxelize` and `modal`, preset quick or the workspace's, with the reference."""
    found = meshes(name, cache)
    kept = found[-1]
    surface = kept["vertices"], kept["faces"]
    stuff, scale = body(name, folder)
    values = params.read(Path(folder if is_workspace(folder) else ROOT, params.PARAMS_FILE))
    section = {key: v for key, v in values["voxelize"].items() if key != "sdf_resolution"}
    config = params.settings(ModalConfig, values)
    start = time.process_time()
    solid = discretize(*surface, **section, name=name)
    limits = config.max_frequency, MODES + SPARES  # neither grid nor estimate depends on how many are kept
    request = Request(stuff, scale, *limits)
    data = refined_analysis(solid, surface, config.fine, kept["points"], request, name)
    seconds = time.process_time() - start
    count = min(MODES, len(data.eigenvalues))
    own, truth = np.sqrt(data.eigenvalues) / (2 * np.pi), kept["hz"]
    shapes, theirs = data.shapes.reshape(3 * POINTS, -1), kept["shapes"].reshape(3 * POINTS, -1)
    partner = paired(shapes, theirs, count)
    lacking = np.setdiff1d(np.arange(count), partner)  # modes of the reference that ours lack
    partner = np.where(partner < 0, np.arange(count), partner)  # of no shape alike: by order
    apart = own[:count] / truth[partner] - 1
    mac = agreement(shapes[:, :count], theirs, truth, partner)
    beyond = truth[partner[partner >= count]]  # of a repeated frequency, whose modes the count separates
    lacking = lacking[(np.abs(beyond[:, None] / truth[lacking] - 1) > CLUSTER).all(0)]
    estimate = np.array(data.report["discretisation_error"])
    return {
        "resolution": data.report["resolution"],
        "wall_cells": wall_thickness(*surface) * data.report["resolution"],
        "degrees_of_freedom": data.report["degrees_of_freedom"],
        "modes": count,
        "difference_max": float(np.abs(apart).max()),
        "difference_mean": float(np.abs(apart).mean()),
        "estimate_max": float(np.abs(estimate).max()),
        "least_agreement": float(mac.min()),
        "lacking": len(lacking),
        "seconds": seconds,
        "difference": apart.round(5).tolist(),
        "estimate": estimate.round(5).tolist(),
        "reference_unknowns": int(kept["unknowns"]),
        "reference_apart": apart_meshes(found),
        "reference_hz": truth[:count].round(3).tolist(),
    }


def misses(rows: list[dict], limits: Limits = KNOWN) -> list[str]:
    """Return the missed targets."""
    missed = [f"{row['object']}: {row['failed']}" for row in rows if "failed" in row]
    rows = [row for row in rows if "failed" not in row]
    good = sum(row["difference_max"] <= GOOD and not row.get("lacking") for row in rows)
    if good < limits.share * len(rows):
        missed.append(f"{good} of {len(rows)} objects within {GOOD:.0%}")
    for row in rows:
        if row.get("lacking"):
            missed.append(f"{row['object']}: {row['lacking']} modes of the reference have none alike")
        if row["difference_max"] > BAD:
            missed.append(f"{row['object']}: {row['difference_max']:.1%} apart, target {BAD:.0%}")
        apart, estimate = row["difference_max"], row["estimate_max"]
        low = apart > SMALL and estimate < apart / limits.low
        if low or estimate > limits.high * max(apart, SMALL):
            missed.append(f"{row['object']}: estimate {estimate:.2%} of {apart:.2%}")
    return missed


def show(rows: list[dict], console: Console) -> None:
    titles = ("object", "cells", "wall", "unknowns", "max %", "mean %", "estimate %", "MAC", "CPU s")
    table = Table(*titles, "tetrahedra", "theirs %")
    for row in rows:
        if "failed" in row:
            table.add_row(row["object"], row["failed"][:60])
            continue
        figures = [100 * row[key] for key in ("difference_max", "difference_mean", "estimate_max")]
        table.add_row(
            row["object"],
            f"{row['resolution']}^3",
            f"{row['wall_cells']:.2f}",
            f"{row['degrees_of_freedom']:,}",
            *(f"{figure:.2f}" for figure in figures),
            f"{row['least_agreement']:.4f}",
            f"{row['seconds']:.0f}",
            f"{row['reference_unknowns']:,}",
            "-" if row["reference_apart"] is None else f"{100 * row['reference_apart']:.2f}",
        )
    console.print(table)


def main() -> None:
    run_job({"reference": reference, "compare": compare})
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="objects (default: all)")
    parser.add_argument("--objects", type=Path, help="folder of real meshes")
    parser.add_argument("--workspace", type=Path, help="whose objects to compare instead")
    parser.add_argument("--draw", type=int, default=10, help="how many of the paper's objects in it")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cache", type=Path, help="default: build/perf/modal_reference")
    parser.add_argument("--single", action="store_true", help="one reference, without a coarser or finer one")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    names, folder = arguments.names or [*(REAL if arguments.objects else ()), *PROCEDURAL], arguments.objects
    limits, drawn = KNOWN, {}
    if workspace := arguments.workspace:
        keys = candidates(workspace)
        chosen = draw(keys, arguments.draw, arguments.seed)
        if others := set(arguments.names) - set(chosen):
            parser.error(f"not drawn: {', '.join(sorted(others))}; drawn are {', '.join(chosen)}")
        names, folder, limits = arguments.names or chosen, workspace, DRAWN
        drawn = {"drawn": chosen, "seed": arguments.seed, "candidates": len(keys)}
    cache = arguments.cache or ROOT / "build/perf/modal_reference" / (
        workspace.resolve().name if workspace else ""
    )
    cache.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in names:
        row: dict = {}
        for size in ("fine",) if arguments.single else SIZES:
            if "failed" not in row and not (cache / f"{name}_{size}.npz").exists():
                row = fresh(__file__, "reference", name, size, folder, cache)
        if "failed" not in row and not arguments.single and alike(meshes(name, cache)):
            row = fresh(__file__, "reference", name, "finer", folder, cache)
        if "failed" not in row:
            row = fresh(__file__, "compare", name, folder, cache)
        rows.append({"object": name, "commit": this_run()["commit"]} | row)
    console = Console(width=max(Console().width, 130))
    show(rows, console)
    if arguments.json and arguments.json.exists():
        rows += [row for row in read_json(arguments.json)["rows"] if row["object"] not in names]
    if drawn:
        found = {row["object"]: row for row in rows}
        rows = [found.get(key, {"object": key, "failed": "not compared yet"}) for key in chosen]
    rows.sort(key=lambda row: row["object"])
    missed = misses(rows, limits)
    write_record(
        arguments.json, {**drawn, "rows": rows}, f"difference at most {GOOD:.0%} {limits.words}", missed
    )
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
