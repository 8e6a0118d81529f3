"""Assets of real meshes in physics engines: `python perf/assets.py OUT FOLDER ... [--json FILE]`.

FOLDER holds objects beside a table, objects.csv or SOURCES.md, of their materials and sizes. Each becomes
an asset in OUT, by `objectfolder.asset` in a fresh single-threaded process: CPU seconds, imports included.
Then, in its most probable stable pose on a table, it rests for two seconds in MuJoCo and, as URDF, in
PyBullet: how far it moves along the table (drift) and down (sink), mm. Masses of the solids are beside those
of the catalogue. With `--build`, objects of a built workspace are made again from their meshes: mass, inertia
and surface beside those that `objectfolder export` uses. Run again, it continues.
"""

import argparse
import re
import resource
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from harness import exit_with_verdict, failures, fresh, parsed, run_job, write_record
from rich.console import Console
from rich.progress import track

from objectfolder.base.io import atomic, read_json, write_json

ROOT = Path(__file__).parents[1]
MOST_SECONDS = 20.0  #: CPU time of an asset
MOST_DRIFT, MOST_SINK = 1.0, 0.5  #: mm, in `REST` seconds
MOST_MASS_ERROR, MOST_INERTIA_ERROR = 0.005, 0.01  #: between an asset and the export of the built object
REST = 2.0  #: seconds
COLUMNS, SIDE, GAP = 15, 96, 4  #: of the picture, pixels


def listed(folder: Path) -> list[dict[str, Any]]:
    """Return key, material, longest side and mesh of the objects of a folder."""
    from objectfolder.workspace.discover import discover_listed

    if (folder / "objects.csv").is_file():
        found = discover_listed(folder / "objects.csv")
        rows = [(one.key, one.material, one.size, one.up, one.mesh) for one in found]
    else:
        rows = []
        for line in (folder / "SOURCES.md").read_text().splitlines():
            cells = [cell.strip() for cell in line.strip("| ").split("|")]
            meshes = (
                sorted((folder / cells[0]).glob("mesh.*")) if re.fullmatch(r"[a-z0-9_]+", cells[0]) else []
            )
            meshes = [mesh for mesh in meshes if mesh.suffix in (".obj", ".gltf", ".glb")]
            if meshes:
                rows.append((cells[0], cells[1].strip("*"), float(cells[2]), None, meshes[0]))
    names = ("object", "material", "size", "up", "mesh")
    return [dict(zip(names, row)) | {"mesh": str(row[4]), "folder": folder.name} for row in rows]


def make(mesh: str, key: str, material: str, size: str, up: str, out: str) -> dict:
    """Make one asset; ``size`` and ``up`` may be empty."""
    from objectfolder.sim.asset import asset

    made = asset(mesh, material, float(size) if size else None, key=key, up=up or None)
    prepared = time.process_time()
    made.write(out)
    used = resource.getrusage(resource.RUSAGE_SELF)
    weight = made.weight
    return {
        "seconds": time.process_time(),
        "hulls_s": time.process_time() - prepared,
        "peak_mb": used.ru_maxrss / 1024,
        "hulls": len(made.body.hulls),
        "kg": weight.kg,
        "low": weight.low,
        "high": weight.high,
        "thickest_mm": 1000 * weight.thickest,
        "warned": bool(made.warnings),
        "closed_by": made.closed_by,
    }


def rest(folder: str) -> dict:
    """Let an asset rest in both engines."""
    place = Path(folder)
    pose = stable_pose(place)
    return {"mujoco": in_mujoco(place, pose), "pybullet": in_pybullet(place, pose)}


def stable_pose(place: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return position (3,) and quaternion (w, x, y, z) of the most probable stable pose on z = 0."""
    import trimesh

    hulls = [trimesh.load_mesh(path, process=False) for path in sorted(place.glob("hull*.obj"))]
    whole = trimesh.util.concatenate(hulls).convex_hull
    centre = read_json(place / "asset.json")["centre"]
    poses, shares = trimesh.poses.compute_stable_poses(whole, center_mass=centre, sigma=0, n_samples=1)
    pose = poses[int(np.argmax(shares))]
    return pose[:3, 3], trimesh.transformations.quaternion_from_matrix(pose)


def in_mujoco(place: Path, pose: tuple[np.ndarray, np.ndarray]) -> dict:
    """Return drift and sink, mm, of an asset that rests on a table in MuJoCo."""
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(place / f"{place.name}.xml"))
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        model = spec.compile()
    except ValueError as error:
        return {"failed": str(error)}
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[3:7] = pose
    mujoco.mj_forward(model, data)
    path = [data.xipos[1].copy()]
    while data.time < REST:
        mujoco.mj_step(model, data)
        path.append(data.xipos[1].copy())
    return moved(np.array(path))


def in_pybullet(place: Path, pose: tuple[np.ndarray, np.ndarray]) -> dict:
    """Return drift and sink, mm, of an asset that rests on a table in PyBullet."""
    import pybullet

    pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.setGravity(0, 0, -9.81)
        pybullet.createMultiBody(0, pybullet.createCollisionShape(pybullet.GEOM_PLANE))
        body = pybullet.loadURDF(str(place / f"{place.name}.urdf"), flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
        w, *vector = pose[1]
        inertial = pybullet.getDynamicsInfo(body, -1)[3:5]  # Bullet moves the frame of inertia
        start, turn = pybullet.multiplyTransforms(pose[0].tolist(), [*vector, w], *inertial)
        pybullet.resetBasePositionAndOrientation(body, start, turn)
        path = [np.array(start)]
        for _ in range(round(REST * 240)):
            pybullet.stepSimulation()
            path.append(np.array(pybullet.getBasePositionAndOrientation(body)[0]))
        return moved(np.array(path))
    except pybullet.error as error:
        return {"failed": str(error)}
    finally:
        pybullet.disconnect()


def moved(path: np.ndarray) -> dict:
    """Return how far a centre of mass (T, 3) went from its start, mm: along the table, and down."""
    away = 1000 * (path - path[0])
    return {"drift": float(np.hypot(*away.T[:2]).max()), "sink": abs(float(min(away[:, 2].min(), 0)))}


def agree(workspace: str, key: str) -> dict:
    """Compare the asset of an object's mesh with its Object File, from which `objectfolder export` works."""
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.sim.asset import candidate_asset
    from objectfolder.sim.body import rigid_body
    from objectfolder.workspace import params
    from objectfolder.workspace.examine import Candidate
    from objectfolder.workspace.layout import Build

    root = Path(workspace)
    entry = params.read(root / "params.yaml")["objects"][key]
    built = ObjectFile.load(Build(key, root).object_file)
    mesh, mass = root / entry["mesh"], entry.get("mass")
    shape = {"size": entry["scale"], "up": entry["up"], "wall": entry["wall"], "mass": mass}
    made = candidate_asset(Candidate(key, mesh, entry["material"], **shape), bridge=entry["bridge"])
    whole, other = made.file.to_mesh(), built.to_mesh()
    hulls = [whole.convex_hull]  # mass and inertia do not depend on them
    ours, theirs = rigid_body(made.file, hulls), rigid_body(built, hulls)
    apart = np.abs(ours.inertia - theirs.inertia).max() / np.abs(theirs.inertia).max()
    same = whole.faces.shape == other.faces.shape and np.array_equal(whole.vertices, other.vertices)
    return {
        "mass_error": abs(ours.mass / theirs.mass - 1),
        "inertia_error": float(apart),
        "same_surface": bool(same),  # of which the hulls are computed: the same
    }


def known_masses(folders: list[Path], catalogue: Path) -> dict[str, float]:
    """Return kg by the names of the objects' folders, as the publishers of the catalogue weighed them."""
    from objectfolder.base.errors import ObjectFolderError
    from objectfolder.hub.fetch.catalogue import read_catalogue
    from objectfolder.hub.fetch.files import find_local

    published, found = read_catalogue(catalogue), {}
    for key, entry in published.objects.items():
        for folder in folders if entry.mass else ():
            try:
                found[find_local(folder, published, key).name] = entry.mass
            except ObjectFolderError:
                continue  # another folder has it, or none
    return found


def measured(one: dict[str, Any], out: Path, masses: dict[str, float]) -> dict[str, Any]:
    """Return the row of an object, from an earlier run if it has one."""
    key = one["object"]
    kept = out / "rows" / f"{key}.json"
    if kept.is_file() and (out / key / "asset.json").is_file():
        return read_json(kept)
    row = {name: one[name] for name in ("object", "material", "folder")}
    arguments = (one["mesh"], key, one["material"], one["size"] or "", one["up"] or "", out)
    if not (out / key).exists():
        row |= fresh(__file__, "make", *arguments)
    if "failed" not in row:
        row |= fresh(__file__, "rest", out / key)
    if key in masses and "kg" in row:
        row |= {"real": masses[key], "error": row["kg"] / masses[key] - 1}
    write_json(kept, row)
    return row


def missed(rows: list[dict], agreement: list[dict]) -> list[str]:
    """Say what misses its target."""
    found = failures(rows)
    for row in (row for row in rows if "failed" not in row):
        key = row["object"]
        if row["seconds"] > MOST_SECONDS:
            found.append(f"{key}: {row['seconds']:.1f} s")
        for engine in ("mujoco", "pybullet"):
            how = row[engine]
            if "failed" in how:
                found.append(f"{key}, {engine}: {how['failed']}")
            elif how["drift"] > MOST_DRIFT or how["sink"] > MOST_SINK:
                found.append(f"{key}, {engine}: drift {how['drift']:.2f}, sink {how['sink']:.2f} mm")
    found += failures(agreement)
    for row in (row for row in agreement if "failed" not in row):
        within = row["mass_error"] <= MOST_MASS_ERROR and row["inertia_error"] <= MOST_INERTIA_ERROR
        if not (within and row["same_surface"]):
            apart = f"mass {row['mass_error']:.2%}, inertia {row['inertia_error']:.2%}"
            found.append(f"{row['object']}: beside its export {apart}, same surface: {row['same_surface']}")
    return found


def draw(keys: list[str], out: Path, path: Path) -> None:
    """Write a sheet of the thumbnails."""
    from PIL import Image

    from objectfolder.base.figures import tile

    images = [
        Image.open(out / key / "thumbnail.png").resize((SIDE, SIDE), Image.Resampling.LANCZOS) for key in keys
    ]
    page = Image.fromarray(tile(np.stack(list(map(np.asarray, images))), min(COLUMNS, len(images)), GAP))
    with atomic(path) as temporary:
        page.save(temporary, "webp", quality=80, method=6)


def show(rows: list[dict], console: Console) -> None:
    """Print a line for each object."""
    for row in rows:
        if "failed" in row:
            text = textwrap.shorten(row["failed"], 400)
            console.print(f"{row['object']}: refused: {text}", markup=False, soft_wrap=True)
            continue
        engines = "; ".join(
            f"{engine}: {how.get('failed') or f'''{how['drift']:.2f}, {how['sink']:.2f} mm'''}"
            for engine, how in ((name, row[name]) for name in ("mujoco", "pybullet"))
        )
        mass = f"{row['kg']:.3g} kg" + (f" ({row['real']:.3g} weighed)" if "real" in row else "")
        console.print(
            f"{row['object']}: {row['seconds']:.1f} s, {row['hulls']} hulls, {mass}"
            f"{', warned' if row['warned'] else ''}; {engines}",
            markup=False,
            soft_wrap=True,
        )


def main() -> None:
    run_job({"make": make, "rest": rest, "agree": agree})
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="folder of the assets")
    parser.add_argument("folders", nargs="*", type=Path, help="folders of objects")
    parser.add_argument("--only", nargs="+", default=(), help="keys of the objects to measure")
    parser.add_argument("--catalogue", type=Path, default=ROOT / "catalogs" / "real.yaml", help="of masses")
    parser.add_argument("--build", type=Path, help="workspace with Object Files")
    parser.add_argument("--compared", nargs="*", default=(), help="objects of --build; default: ten of them")
    parser.add_argument("-j", "--jobs", type=int, default=1, help="objects at a time")
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument("--picture", type=Path, help="write a sheet of the thumbnails here (.webp)")
    arguments = parsed(parser)
    console, out = Console(), arguments.out.resolve()
    objects = [one for folder in arguments.folders for one in listed(folder.resolve())]
    objects = [one for one in objects if not arguments.only or one["object"] in arguments.only]
    masses = known_masses(arguments.folders, arguments.catalogue)
    (out / "rows").mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(arguments.jobs) as pool:
        made = pool.map(lambda one: measured(one, out, masses), objects)
        rows = list(track(made, "making assets", len(objects)))
    show(rows, console)
    agreement = []
    if arguments.build:
        built = sorted(path.parent.name for path in arguments.build.glob("build/*/ObjectFile.safetensors"))
        keys = arguments.compared or built[:: max(len(built) // 10, 1)][:10]
        for key in track(keys, "comparing"):
            kept = out / "rows" / f"agree_{key}.json"
            if not kept.is_file():
                write_json(kept, fresh(__file__, "agree", arguments.build.resolve(), key))
            agreement.append({"object": key} | read_json(kept))
            console.print(str(agreement[-1]), markup=False, soft_wrap=True)
    good = [row for row in rows if "failed" not in row]
    if arguments.picture and good:
        draw([row["object"] for row in good], out, arguments.picture)
    record = {
        "objects": len(rows),
        "assets": len(good),
        "seconds_median": median(row["seconds"] for row in good) if good else None,
        "seconds_worst": max((row["seconds"] for row in good), default=None),
        "rows": rows,
        "agreement": agreement,
    }
    targets = (
        f"at most {MOST_SECONDS:g} CPU s each; in {REST:g} s on a table at most {MOST_DRIFT:g} mm of drift "
        f"and {MOST_SINK:g} mm of sinking; beside the export of a built object at most {MOST_MASS_ERROR:.1%} "
        f"of mass and {MOST_INERTIA_ERROR:.0%} of inertia apart, and the same hulls"
    )
    found = missed(rows, agreement)
    write_record(arguments.json, record, targets, found)
    exit_with_verdict(found, console)


if __name__ == "__main__":
    main()
