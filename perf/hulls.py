"""Accuracy and cost of collision hulls: `python perf/hulls.py FILE ... [--json OUT]`.

FILE are Object Files. Needs the extra `rl`. Distances are in percent of the longest side.

excess: distance to the stored surface of hull points outside the solid. deficit: distance to the hulls of
surface points outside all hulls. volume: of the union of the hulls, relative to the solid.
mass_error, inertia_error: of the rigid body, percent (inertia: of its largest entry), if solid.ply of the
build lies beside the file. stored_mass_error, stored_inertia_error: the same from the stored surface.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
import trimesh
from harness import parsed, write_record
from manifold3d import Manifold, Mesh64, OpType
from rich.console import Console
from rich.table import Table

from objectfolder.base.seeding import numpy_generator
from objectfolder.mesh.ply import read_surface
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import density, rigid_body
from objectfolder.sim.hulls import convex_hulls
from objectfolder.sim.solid import close_holes

POINTS = 20_000


def measure(file: ObjectFile) -> dict:
    mesh = file.to_mesh()
    start = time.process_time()
    hulls = convex_hulls(mesh)
    seconds = time.process_time() - start
    planes = [(hull.face_normals, (hull.triangles[:, 0] * hull.face_normals).sum(1)) for hull in hulls]

    def heights(points: np.ndarray) -> np.ndarray:
        """How far points are outside of each hull, at least; (H, N)."""
        return np.stack([(points @ normals.T - offsets).max(1) for normals, offsets in planes])

    rng = numpy_generator(0, file.key, "perf", "hulls")
    area = sum(hull.area for hull in hulls)
    counts = [int(POINTS * hull.area / area) for hull in hulls]
    samples = [trimesh.sample.sample_surface(hull, n, seed=rng)[0] for hull, n in zip(hulls, counts)]
    points, own = np.concatenate(samples), np.repeat(np.arange(len(hulls)), counts)
    above = heights(points)
    above[own, np.arange(len(points))] = np.inf
    points = points[above.min(0) > 0]
    outside = file.surface.grid.distance(torch.from_numpy(points / file.scale)).numpy() > 0
    excess = np.where(outside, file.nearest(points)[1], 0) / file.scale
    deficit = np.maximum(heights(file.sample_surface(POINTS)).min(0), 0) / file.scale
    solids = [Manifold(Mesh64(np.asarray(h.vertices), np.asarray(h.faces, np.uint64))) for h in hulls]
    return {
        "hulls": len(hulls),
        "vertices": max(len(hull.vertices) for hull in hulls),
        "seconds": seconds,
        "volume": Manifold.batch_boolean(solids, OpType.Add).volume() / close_holes(mesh).volume,
        **{f"excess_{name}": value for name, value in spread(excess).items()},
        **{f"deficit_{name}": value for name, value in spread(deficit).items()},
    }


def mass_errors(file: ObjectFile, source: Path) -> dict[str, float]:
    """Percent by which mass and inertia differ from those of the mesh that the object was built from."""
    true = trimesh.Trimesh(*read_surface(source), process=False).apply_scale(file.scale)
    true.density = density(file)
    expected, errors = true.mass_properties, {}
    told = {name: content for name, content in file.header.items() if name not in ("solid", "mass")}
    for prefix, given in (("", file), ("stored_", ObjectFile(told, file.tensors))):
        body = rigid_body(given, [given.to_mesh().convex_hull])
        inertia = np.abs(body.inertia - expected.inertia).max() / np.abs(expected.inertia).max()
        errors |= {f"{prefix}mass_error": 100 * (body.mass / expected.mass - 1)}
        errors |= {f"{prefix}inertia_error": 100 * float(inertia)}
    return errors


def spread(distances: np.ndarray) -> dict[str, float]:
    """Percent."""
    numbers = {"mean": distances.mean(), "95": np.quantile(distances, 0.95), "max": distances.max()}
    return {name: 100 * float(value) for name, value in numbers.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--json", type=Path)
    arguments = parsed(parser)
    torch.set_num_threads(1)
    found = {}
    for path in arguments.files:
        file, source = ObjectFile.load(path), path.with_name("solid.ply")
        found[file.key] = measure(file) | (mass_errors(file, source) if source.exists() else {})
    columns = list(dict.fromkeys(name for values in found.values() for name in values))
    table = Table("object", *columns)
    for key, values in found.items():
        table.add_row(key, *(f"{values[name]:.3g}" if name in values else "" for name in columns))
    Console(width=200).print(table)
    write_record(arguments.json, found)


if __name__ == "__main__":
    main()
