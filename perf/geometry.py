"""Time, memory and volumes of normalize and voxelize, object by object.

`python perf/geometry.py [--objects DIR] [--catalogue catalogs/procedural.yaml --every 5]` measures those of
params.yaml or of a folder, and every fifth object of a catalogue. Each gets a fresh single-threaded process.
Exits with 1 if an object misses a target; a refused object misses none.
"""

import argparse
import json
import resource
import sys
import time
from pathlib import Path

import numpy as np
from harness import exit_with_verdict, fresh, parsed, run_job, write_record
from rich.console import Console
from rich.table import Table

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.yamlfile import read_yaml
from objectfolder.mesh.gridcodec import BOUND, band_width, pack_grid
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.sdf import distance_grid
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes import generate
from objectfolder.workspace import params

GENERATED = "generated"  # stands for the up axis of a procedural object
ROOT = Path(__file__).parents[1]
MAX_SECONDS = 10.0  # CPU time of normalize and voxelize of one object, loading included
MAX_MEGABYTES = 2048.0
MAX_GRID_ERROR = 0.01  # of the volume that the distance grid's surface encloses
PEER_RESOLUTION = 64  # the peer needs the whole grid: minutes at the real resolution


def meshes(folder: Path | None) -> dict[str, tuple[Path, str]]:
    """Return path and up axis of every object, of params.yaml or of `mesh.*` in each subfolder."""
    if folder is None:
        entries = params.read(ROOT / "params.yaml")["objects"]
        return {key: (ROOT / entry["mesh"], entry.get("up", "z")) for key, entry in entries.items()}
    paths = sorted(
        p for suffix in ("obj", "gltf", "glb", "ply", "stl") for p in folder.glob(f"*/mesh.{suffix}")
    )
    return {p.parent.name: (p, "y" if p.suffix in (".gltf", ".glb") else "z") for p in paths}


def generated(catalogue: Path, every: int) -> dict[str, tuple[str, str]]:
    """Return generator and parameters (JSON) of every n-th procedural object of a catalogue, by key."""
    entries = read_yaml(catalogue)["procedural"]
    keys = sorted(entries)[::every]
    return {key: (json.dumps(entries[key]), GENERATED) for key in keys}


def load(source: str, up: str, texture_size: int) -> TexturedMesh:
    """Return the mesh of a file, or of an entry that `generated` returned."""
    return generate(**json.loads(source)) if up == GENERATED else load_mesh(Path(source), up, texture_size)


def measure(key: str, source: str, up: str) -> dict:
    """Measure one object in this process."""
    from objectfolder.sound.fem.settings import VoxelizeConfig
    from objectfolder.sound.fem.voxelize import voxelize

    values = params.read(ROOT / "params.yaml")
    row: dict = {"object": key}
    start = time.process_time()
    mesh = load(source, up, values["normalize"]["texture_size"])
    try:
        result = normalize(mesh, key)
        report = result.report(1.0, up)
        row["normalize_s"] = time.process_time() - start
        row |= {name: report[name] for name in ("rung", "components", "volume_m3", "faces")}
        row |= {name: report[f"{name}_percent"] for name in ("deviation_mean", "deviation_max")}
        start = time.process_time()
        config = params.settings(VoxelizeConfig, values)
        voxels = voxelize(result.surface.mesh, result.surface.mesh, config, key)
        row["voxelize_s"] = time.process_time() - start
        row |= {name: voxels.report["cells"][name] for name in ("resolution", "volume_error")}
        grid = voxels.report["distance_grid"]
        row |= {"wall": grid["wall_thickness"], "grid": grid["resolution"]}
        row["grid_error"] = grid["volume_share_kept"] - 1
        row["grid_kb"] = len(pack_grid(voxels.values)[0]) / 1000
    except ObjectFolderError as error:
        row["refused"] = str(error)
        row.setdefault("normalize_s", time.process_time() - start)
    row["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return row


def compare(mesh: str, up: str) -> dict:
    """Compare the distance grid with libigl's distance and winding number of every sample."""
    import igl

    path = Path(mesh)
    vertices, faces = normalize(load_mesh(path, up), path.parent.name).surface.mesh
    start = time.process_time()
    values, band = distance_grid(vertices, faces, PEER_RESOLUTION)
    own = time.process_time() - start
    axis = np.linspace(-BOUND, BOUND, PEER_RESOLUTION)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    start = time.process_time()
    distance = np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0])
    peer = np.where(igl.fast_winding_number(vertices, faces, points) > 0.5, -distance, distance)
    seconds = time.process_time() - start
    assert band == band_width(PEER_RESOLUTION)
    apart = np.abs(values.ravel() * (band / 127) - peer.clip(-band, band)).max() / (axis[1] - axis[0])
    return {"object": path.parent.name, "own_s": own, "peer_s": seconds, "apart_voxels": float(apart)}


def misses(row: dict) -> list[str]:
    """Return the targets that an object misses."""
    missed = []
    if "failed" in row:
        missed.append(f"crashed: {row['failed']}")
    seconds = row.get("normalize_s", 0.0) + row.get("voxelize_s", 0.0)
    if seconds > MAX_SECONDS:
        missed.append(f"{seconds:.1f} s, target {MAX_SECONDS:g} s")
    if abs(row.get("grid_error", 0.0)) > MAX_GRID_ERROR:
        missed.append(f"its grid holds {row['grid_error']:+.2%} of the volume, target {MAX_GRID_ERROR:.0%}")
    if row.get("peak_mb", 0.0) > MAX_MEGABYTES:
        missed.append(f"{row['peak_mb']:.0f} MB, target {MAX_MEGABYTES:g} MB")
    return missed


def show(rows: list[dict], peer: dict | None, console: Console) -> None:
    table = Table(title="CPU seconds, one fresh process per object; % of the size, or of its cube")
    columns = {
        "object": "object",
        "rung": "rung",
        "components": "pieces",
        "volume_m3": "volume %",
        "deviation_mean": "mean dev. %",
        "deviation_max": "max dev. %",
        "resolution": "cells",
        "volume_error": "volume error %",
        "wall": "wall %",
        "grid": "grid",
        "grid_error": "grid vol. error %",
        "grid_kb": "grid kB",
        "normalize_s": "normalize s",
        "voxelize_s": "voxelize s",
        "peak_mb": "peak MB",
    }
    for title in columns.values():
        left = title in ("object", "rung")
        table.add_column(title, justify="left" if left else "right", no_wrap=left)
    form = {
        "volume_m3": lambda v: f"{v:.3%}"[:-1],
        "volume_error": lambda v: f"{v:+.3%}"[:-1],
        "wall": lambda v: f"{v:.2%}"[:-1],
        "grid_error": lambda v: f"{v:+.2%}"[:-1],
        "grid_kb": lambda v: f"{v:.0f}",
        "deviation_mean": lambda v: f"{v:.2g}",
        "deviation_max": lambda v: f"{v:.2g}",
        "normalize_s": lambda v: f"{v:.2f}",
        "voxelize_s": lambda v: f"{v:.2f}",
        "peak_mb": lambda v: f"{v:.0f}",
    }
    for row in rows:
        table.add_row(*(form.get(name, str)(row[name]) if name in row else "-" for name in columns))
    console.print(table)
    for row in rows:
        if "refused" in row:
            console.print(f"refused: {row['refused']}", markup=False, soft_wrap=True)
    if peer and "failed" not in peer:
        console.print(
            f"distance grid {PEER_RESOLUTION}^3 of {peer['object']}: {peer['own_s']:.2f} s; "
            f"libigl's distance and winding number of every sample: {peer['peer_s']:.2f} s, "
            f"{peer['peer_s'] / peer['own_s']:.1f} times as long; "
            f"at most {peer['apart_voxels']:.3f} voxels apart",
            soft_wrap=True,
        )


def main() -> None:
    run_job({"measure": measure, "compare": compare})
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=Path, help="folder with a mesh.* in each subfolder")
    parser.add_argument("--catalogue", type=Path, help="catalogue of procedural objects to measure, too")
    parser.add_argument("--every", type=int, default=1, help="measure every n-th object of the catalogue")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    found = meshes(arguments.objects)
    if not found:
        sys.exit(f"{arguments.objects}: no subfolder holds a mesh.obj, .gltf, .glb, .ply or .stl")
    console = Console(width=max(Console().width, 190))
    sources = found | (generated(arguments.catalogue, arguments.every) if arguments.catalogue else {})
    rows = [{**fresh(__file__, "measure", key, *mesh), "object": key} for key, mesh in sources.items()]
    faces = {row["object"]: row["faces"] for row in rows if "voxelize_s" in row and row["object"] in found}
    largest = max(faces, key=faces.__getitem__, default=None)
    peer = fresh(__file__, "compare", *found[largest]) if largest else None
    show(rows, peer, console)
    missed = [f"{row['object']}: {reason}" for row in rows for reason in misses(row)]
    targets = f"{MAX_SECONDS:g} s, {MAX_MEGABYTES:g} MB, grid error {MAX_GRID_ERROR:.0%}"
    write_record(arguments.json, {"objects": rows, "distance_grid": peer}, targets, missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
