"""Touch, object by object: `python perf/touch.py COMMAND [--workspace DIR | --objects DIR] [KEY ...]`.

Every figure comes from a fresh process with one thread; milliseconds are CPU time per image. `speed` times
the steps from a contact to its image, alone and in batches, beside our re-implementation of TACTO's renderer
on OpenGL, the reference, in the same process. `query` times touches of a workspace's Object Files, snapping
and contact normals included. `dataset` renders 3,000 contacts as the stage does. `accuracy` scores TACTO's
images by ray casting, and those from heightmaps, against that reference. `net` scores TouchNet geometric at
held-out contacts, against the soft gel on the exact surface and against TACTO's images; `image` trains the
paper's network on contacts of one depth and angle, and scores it on them and on others.
Objects are those of a workspace (needs `objectfolder build normalize`) or meshes in metres, DIR/KEY/mesh.*.
Without pyrender the reference's rows are left out, with what to install. Exits with 1 if a target is missed.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import harness
import igl
import numpy as np
import torch
from rich.console import Console

from objectfolder import ObjectFile
from objectfolder.base.arrays import write_npz, write_png
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.figures import tile
from objectfolder.base.metrics import psnr
from objectfolder.mesh.closing.surface import close_surface
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.ply import read_surface
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.sdf import distance_grid
from objectfolder.nets.fit import Session
from objectfolder.stored.surface import UNMOVED, ObjectSurface
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals, heightmaps
from objectfolder.touch.evaluation import score_images
from objectfolder.touch.gel import deform
from objectfolder.touch.geometric_net import GeometricTouch
from objectfolder.touch.geometric_training import fit_contacts
from objectfolder.touch.image_training import train_image
from objectfolder.touch.net_settings import ImageConfig
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.simulate import touch_images
from objectfolder.touch.tacto import TactoReference
from objectfolder.touch.tacto_rays import TactoRays
from objectfolder.touch.truth import render_contacts
from objectfolder.workspace import params
from objectfolder.workspace.layout import Build

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "build" / "perf"
RIGID, SOFT = "tacto_digit", "digit"
BATCH = 16
SHOWN = 8  # contacts in a picture
MAX_MS = {"rigid_single": 8.0, "rigid_batch": 4.0, "soft_single": 10.0, "soft_batch": 7.0}
MAX_DATASET_S, MAX_MB = 30.0, 2048.0  # of 3,000 contacts
MIN_FASTER = 10.0  # than the reference: images from heightmaps, rigid gel, and TACTO's by ray casting
MIN_DB = {"tacto": 55.0, "tacto_contact": 52.0, "heightmap": 42.0, "heightmap_contact": 36.0}
MIN_NET = {
    "soft_unobstructed": 43.0,
    "soft_median": 47.0,  # of unobstructed contacts
    "tacto_unobstructed": 42.0,
    "tacto_all": 35.0,
}
LIMITS: dict[str, dict[str, float]] = {"accuracy": MIN_DB, "net": MIN_NET, "image": {}}
OFFSET_SPAN, ROUNDS, FITTED = 2e-4, 4, 48  # of the depth offset's search: preset quick
IMAGE = ImageConfig(
    width=256,
    depth=8,
    point_octaves=10,
    pixel_octaves=10,
    steps=0,
    batch=4096,
    learning_rate=5e-4,
    final_rate=0.01,
    precision="float32",
)
IMAGE_PRESS = 0.001  # m; the angle is 0

Contact = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class Touched:
    """A surface and where to press on it."""

    def __init__(self, source: str, scale: str, count: int, profile: SensorProfile):
        if source.endswith(".ply") and float(scale) > 0:
            self.vertices, self.faces = read_surface(source)
            self.scale = float(scale)
        else:
            mesh = load_mesh(Path(source), "z")
            surface = close_surface(mesh.vertices, mesh.faces)
            low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
            self.scale = float((high - low).max())
            self.vertices, self.faces = (surface.vertices - (low + high) / 2) / self.scale, surface.faces
        self.vertices = np.ascontiguousarray(self.vertices, np.float64)
        rng = np.random.default_rng(0)
        points = sample_surface(self.vertices, self.faces, count, rng)
        normals = contact_normals(self._distance, points, NORMAL_RADIUS)
        depths = rng.uniform(*profile.press_depth, count)
        self.contacts: Contact = points * self.scale, normals, rng.uniform(0, 2 * np.pi, count), depths
        self.caster = RayCaster(self.vertices, self.faces)

    def _distance(self, points: np.ndarray) -> np.ndarray:
        faces = np.ascontiguousarray(self.faces, np.int64)
        return igl.signed_distance(np.ascontiguousarray(points), self.vertices, faces)[0]

    def reference(self, profile: SensorProfile, row: dict) -> TactoReference | None:
        """TACTO's renderer on OpenGL; where it cannot run, why goes into the row."""
        try:
            return TactoReference(self.vertices, self.faces, profile, self.scale)
        except ObjectFolderError as error:
            row["reference_missing"] = str(error)
            return None


def speed(source: str, scale: str, count: str) -> dict:
    """Time every step in this process."""
    torch.set_num_threads(1)
    rigid, soft = load_profile(RIGID), load_profile(SOFT)
    touched = Touched(source, scale, int(count), rigid)
    contacts, caster, scale_m = touched.contacts, touched.caster, touched.scale

    def milliseconds(run: Callable[[slice], object], batch: int = BATCH) -> float:
        parts = [slice(i, i + batch) for i in range(0, len(contacts[0]), batch)]
        run(parts[0])
        start = time.process_time()
        for part in parts:
            run(part)
        return 1000 * (time.process_time() - start) / len(contacts[0])

    def pressed(profile: SensorProfile) -> Callable[[slice], object]:
        optics = Optics(profile)
        return lambda part: touch_images(caster, *(c[part] for c in contacts), profile, optics, scale_m)

    heights = heightmaps(caster, *contacts, soft, scale_m)[0]
    moved = torch.from_numpy(deform(heights, soft)[0])
    optics = Optics(soft)
    row: dict = {
        "heightmap": milliseconds(lambda p: heightmaps(caster, *(c[p] for c in contacts), soft, scale_m)),
        "gel": milliseconds(lambda part: deform(heights[part], soft)),
        "optics": milliseconds(lambda part: optics.render(moved[part])),
    }
    for name, profile in (("rigid", rigid), ("soft", soft)):
        row[f"{name}_single"] = milliseconds(pressed(profile), 1)
        row[f"{name}_batch"] = milliseconds(pressed(profile))
    fast = TactoRays(touched.vertices, touched.faces, rigid, scale_m)
    row["tacto"] = milliseconds(lambda part: fast.render(*(c[part] for c in contacts)))
    reference = touched.reference(rigid, row)
    if reference is not None:
        row["reference"] = milliseconds(lambda part: reference.render(*(c[part] for c in contacts)))
        row["tacto_faster"] = row["reference"] / row["tacto"]
        row["rigid_faster"] = row["reference"] / row["rigid_batch"]
    return row


def decibel_of(images: np.ndarray, truth: np.ndarray) -> float:
    return float(psnr(np.mean((images / 255 - truth / 255) ** 2)))


def faceted_images(
    touched: Touched, profile: SensorProfile, heights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """TACTO's images of an object with the normals of its faces, by rays and from heightmaps."""
    corners = touched.vertices[touched.faces].reshape(-1, 3)
    first, second, third = corners[::3], corners[1::3], corners[2::3]
    normals = np.cross(second - first, third - first)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    rays = TactoRays(
        corners, np.arange(len(corners)).reshape(-1, 3), profile, touched.scale, normals.repeat(3, axis=0)
    )
    drawn, _ = rays.render(*touched.contacts)
    optics = Optics(replace(profile, slope_smoothing=0.0))
    return drawn, optics.render(torch.from_numpy(deform(heights, profile)[0])).numpy()


def accuracy(source: str, scale: str, count: str, picture: str) -> dict:
    """Score images against the reference in this process; writes a picture of the first contacts.

    Means are over all pixels of an object's contacts; contact pixels are where the reference has the object
    before the gel. Heightmaps are scored where nothing blocks the sensor, against the reference, which shades
    the object with its vertices' normals, and, without smoothing of slopes, against rays that see the normals
    of its faces, which is its shape.
    """
    torch.set_num_threads(1)
    profile = load_profile(RIGID)
    touched = Touched(source, scale, int(count), profile)
    row: dict = {"contacts": int(count)}
    reference = touched.reference(profile, row)
    if reference is None:
        return row
    truth, contact = reference.render(*touched.contacts)
    drawn, _ = TactoRays(touched.vertices, touched.faces, profile, touched.scale).render(*touched.contacts)
    heights, obstructed, _ = heightmaps(touched.caster, *touched.contacts, profile, touched.scale)
    flat = Optics(profile).render(torch.from_numpy(deform(heights, profile)[0])).numpy()
    free = obstructed == 0
    row |= {"unobstructed": int(free.sum()), "contact_pixels": float(contact.mean())}

    def decibel(images: np.ndarray, of: np.ndarray) -> float:
        return decibel_of(images[of], truth[of])

    everywhere = np.ones_like(contact)
    row |= {"tacto": decibel(drawn, everywhere), "tacto_contact": decibel(drawn, contact)}
    row |= {"heightmap_all": decibel(flat, everywhere), "heightmap_all_contact": decibel(flat, contact)}
    if free.any():
        row["heightmap"] = decibel(flat, everywhere & free[:, None, None])
        row["heightmap_contact"] = decibel(flat, contact & free[:, None, None])
        faceted = [image[free] for image in faceted_images(touched, profile, heights)]
        row["faces"] = decibel_of(faceted[0], truth[free])
        row["heightmap_faces"] = decibel_of(faceted[1], faceted[0])
    shown = np.concatenate([images[:SHOWN] for images in (truth, drawn, flat)])
    write_png(picture, tile(shown, columns=min(SHOWN, int(count))))
    return row


def net(source: str, scale: str, count: str, resolution: str) -> dict:
    """Score TouchNet geometric at contacts that its one number was not fitted to.

    Parameters
    ----------
    resolution : str
        Of the stored distance grid.
    """
    torch.set_num_threads(1)
    touched = Touched(source, scale, 0, load_profile(SOFT))
    vertices, faces, scale_m = touched.vertices, touched.faces, touched.scale
    values, band = distance_grid(vertices, faces, int(resolution))
    surface = Isosurface(DistanceGrid(values, band))
    row: dict = {"resolution": int(resolution), "contacts": int(count)}
    for name, sensor, renderer in (("soft", SOFT, "gel"), ("tacto", RIGID, "tacto")):
        profile = load_profile(sensor)
        known, unknown = (
            render_contacts(
                vertices,
                faces,
                scale_m,
                sample_surface(vertices, faces, size, np.random.default_rng(seed)),
                profile,
                np.random.default_rng(seed + 2),
                renderer,
            )
            for seed, size in enumerate((FITTED, int(count)))
        )
        fitted = GeometricTouch(surface, scale_m, profile, renderer=renderer)
        fit_contacts(fitted, known, {k: v[:1] for k, v in known.items()}, OFFSET_SPAN, ROUNDS)
        places = ObjectSurface(lambda: surface, scale_m).snap(unknown["points"], 1.0, UNMOVED)
        contact = places, fitted.normals(places), unknown["angles"], unknown["depths"]
        found = [(part.images, part.force) for part in fitted.touches(*contact)]
        images, force = (np.concatenate(parts) for parts in zip(*found))
        scores = score_images(images, unknown)
        free = unknown["obstructed"] == 0
        row |= {
            f"{name}_offset_um": fitted.depth_offset * 1e6,
            f"{name}_smoothing": fitted.smoothing,
            f"{name}_unobstructed": scores["psnr_unobstructed"],
            f"{name}_median": scores["psnr_median_unobstructed"],
            f"{name}_contact": scores["psnr_contact"],
            f"{name}_all": scores["psnr"],
            "unobstructed": int(free.sum()),
        }
        if name == "soft":
            error = np.abs(force - unknown["force"])[free].mean()
            row["force_error"] = float(error / unknown["force"][free].mean())
    return row


def image(source: str, scale: str, count: str, steps: str) -> dict:
    """Train the paper's network on contacts of one depth and angle; score it on them and on others."""
    torch.set_num_threads(1)
    profile = load_profile(SOFT)
    touched = Touched(source, scale, 0, profile)
    vertices, faces, scale_m = touched.vertices, touched.faces, touched.scale
    chosen = np.random.default_rng(0).permutation(len(vertices))
    known, unknown = (
        render_contacts(
            vertices,
            faces,
            scale_m,
            vertices[rows],
            profile,
            np.random.default_rng(1),
            depth=IMAGE_PRESS,
            angle=0.0,
        )
        for rows in (chosen[: int(count)], chosen[int(count) :][: int(count)])
    )
    start = time.process_time()
    config = replace(IMAGE, steps=int(steps))
    some = {name: values[:16] for name, values in known.items()}  # the paper stops at no held-out loss
    generator = torch.Generator().manual_seed(0)
    trained, _ = train_image(known, some, scale_m, SOFT, config, Session(generator))
    row = {"contacts": int(count), "steps": int(steps), "seconds": time.process_time() - start}
    mean = known["images"].mean(axis=0).round()
    for name, contacts in (("known", known), ("unknown", unknown)):
        answers = trained.images(contacts["points"] / scale_m)
        for kind, images in (("net", answers), ("mean", np.broadcast_to(mean, answers.shape))):
            scores = score_images(images, contacts)
            row |= {f"{name}_{kind}": scores["psnr"], f"{name}_{kind}_contact": scores.get("psnr_contact")}
    return row


def query(source: str, scale: str, count: str) -> dict:
    """Time touches of an Object File in this process, alone and together."""
    torch.set_num_threads(1)
    folder = Path(source).parent
    if not (folder / "ObjectFile.safetensors").is_file():
        raise ObjectFolderError(f"{folder}: no Object File; objectfolder build pack@{folder.name}")
    file = ObjectFile.load(folder / "ObjectFile.safetensors")
    points = file.sample_surface(int(count))
    row: dict = {}
    for name, sensor in (("rigid", load_profile(RIGID)), ("soft", None)):
        file.touch(points[:1], sensor=sensor)
        start = time.process_time()
        for point in points:
            file.touch(point, sensor=sensor)
        row[f"{name}_single"] = 1000 * (time.process_time() - start) / len(points)
        start = time.process_time()
        file.touch(points, sensor=sensor)
        row[f"{name}_batch"] = 1000 * (time.process_time() - start) / len(points)
    return row


def dataset(source: str, scale: str, count: str) -> dict:
    """Time the rendering and the writing of contacts with the soft gel in this process."""
    torch.set_num_threads(1)
    profile = load_profile(SOFT)
    touched = Touched(source, scale, int(count), profile)
    points, rng = touched.contacts[0] / touched.scale, np.random.default_rng(0)
    start = time.process_time()
    contacts = render_contacts(touched.vertices, touched.faces, touched.scale, points, profile, rng)
    rendered = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_npz(Path(folder) / "test.npz", **contacts)
    written = time.process_time()
    return {
        "contacts": len(points),
        "render_s": rendered - start,
        "write_s": written - rendered,
        "dataset_s": written - start,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def sources(arguments: argparse.Namespace) -> dict[str, tuple[str, str]]:
    """File and longest side of every object; side 0: as the file has it."""
    if arguments.objects:
        found = {path.parent.name: (str(path), "0") for path in sorted(arguments.objects.glob("*/mesh.*"))}
    else:
        entries = params.read(arguments.workspace / "params.yaml")["objects"]
        found = {
            key: (str(Build(key, arguments.workspace).surface), str(entry["scale"]))
            for key, entry in entries.items()
        }
    unknown = set(arguments.keys) - set(found)
    if unknown:
        raise ObjectFolderError(f"no object {', '.join(sorted(unknown))}; there are {', '.join(found)}")
    return {key: found[key] for key in arguments.keys or found}


JOBS = {
    "speed": speed,
    "query": query,
    "dataset": dataset,
    "accuracy": accuracy,
    "net": net,
    "image": image,
}

SPEED = {
    "object": ("object", ""),
    "heightmap": ("heightmap", ".1f"),
    "gel": ("soft gel", ".1f"),
    "optics": ("optics", ".1f"),
    "rigid_single": ("rigid, 1", ".1f"),
    "rigid_batch": (f"rigid, {BATCH}", ".1f"),
    "soft_single": ("soft, 1", ".1f"),
    "soft_batch": (f"soft, {BATCH}", ".1f"),
    "tacto": ("tacto", ".1f"),
    "reference": ("reference", ".0f"),
    "rigid_faster": ("times rigid", ".1f"),
    "tacto_faster": ("times tacto", ".1f"),
}
QUERY = {
    "object": ("object", ""),
    "rigid_single": ("rigid, 1", ".1f"),
    "rigid_batch": ("rigid, all at once", ".1f"),
    "soft_single": ("soft, 1", ".1f"),
    "soft_batch": ("soft, all at once", ".1f"),
}
DATASET = {
    "object": ("object", ""),
    "contacts": ("contacts", ""),
    "render_s": ("render, CPU s", ".1f"),
    "write_s": ("write", ".1f"),
    "dataset_s": ("both", ".1f"),
    "peak_mb": ("peak MB", ".0f"),
}
ACCURACY = {
    "object": ("object", ""),
    "contacts": ("contacts", ""),
    "tacto": ("tacto", ".1f"),
    "tacto_contact": ("its contact", ".1f"),
    "unobstructed": ("unobstructed", ""),
    "heightmap": ("heightmap", ".1f"),
    "heightmap_contact": ("its contact", ".1f"),
    "faces": ("faces' normals", ".1f"),
    "heightmap_faces": ("heightmap, these", ".1f"),
    "heightmap_all": ("of all", ".1f"),
    "heightmap_all_contact": ("its contact", ".1f"),
}


NET = {
    "object": ("object", ""),
    "resolution": ("grid", ""),
    "unobstructed": ("unobstructed", ""),
    "soft_unobstructed": ("soft gel", ".1f"),
    "soft_median": ("median", ".1f"),
    "soft_contact": ("contact", ".1f"),
    "soft_all": ("all", ".1f"),
    "force_error": ("force", ".1%"),
    "tacto_unobstructed": ("TACTO", ".1f"),
    "tacto_median": ("median", ".1f"),
    "tacto_all": ("all", ".1f"),
}
IMAGES = {
    "object": ("object", ""),
    "contacts": ("contacts", ""),
    "steps": ("steps", ""),
    "seconds": ("CPU s", ".0f"),
    "known_net": ("trained on", ".1f"),
    "known_mean": ("mean image", ".1f"),
    "unknown_net": ("held out", ".1f"),
    "unknown_mean": ("mean image", ".1f"),
}


def show(rows: list[dict], title: str, form: dict[str, tuple[str, str]], console: Console) -> None:
    harness.print_rows(rows, title, form, console)
    for reason in {row["reference_missing"] for row in rows if "reference_missing" in row}:
        console.print(f"left out: {reason}", markup=False, soft_wrap=True)


def described_targets(command: str) -> str:
    """Return the targets of a command in words."""
    if command in LIMITS:
        return ", ".join(f"{name} {limit:g} dB" for name, limit in LIMITS[command].items())
    if command == "dataset":
        return f"{MAX_DATASET_S:g} s, {MAX_MB:g} MB"
    limits = ", ".join(f"{name} {limit:g} ms" for name, limit in MAX_MS.items())
    return limits + (f"; {MIN_FASTER:g} times as fast as TACTO's renderer" if command == "speed" else "")


def misses(command: str, rows: list[dict]) -> list[str]:
    """Targets that are missed; what has no reference misses none."""
    if command in LIMITS:
        return harness.failures(rows) + harness.beyond(rows, LIMITS[command], "dB", least=True)
    missed = harness.failures(rows) + harness.beyond(rows, MAX_MS, "ms")
    missed += harness.beyond(rows, {"dataset_s": MAX_DATASET_S}, "s")
    missed += harness.beyond(rows, {"peak_mb": MAX_MB}, "MB")
    faster = dict.fromkeys(("rigid_faster", "tacto_faster"), MIN_FASTER)
    return missed + harness.beyond(rows, faster, "times", least=True)


def main() -> None:
    harness.run_job(JOBS)
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    described = {
        "speed": "time every step",
        "query": "time touches of Object Files",
        "dataset": "time the rendering of a data set",
        "accuracy": "score against TACTO's renderer on OpenGL",
        "net": "score TouchNet geometric at held-out contacts",
        "image": "train and score the paper's network (minutes per object)",
    }
    for name, text in described.items():
        command = commands.add_parser(name, help=text)
        harness.add_objects(command)
        command.add_argument("--objects", type=Path, help="meshes in metres instead: DIR/KEY/mesh.*")
        contacts = 3000 if name == "dataset" else 40
        command.add_argument("--contacts", type=int, default=contacts, help="of each object")
        command.add_argument("--pictures", type=Path, default=PICTURES, help="folder for side-by-sides")
        grids = "of the stored grids (net)"
        command.add_argument("--resolution", type=int, nargs="+", default=[192], help=grids)
        command.add_argument("--steps", type=int, default=1000, help="of training (image)")
    arguments = harness.parsed(parser)
    console = Console(width=max(Console().width, 160))
    rows = []
    for key, (source, scale) in sources(arguments).items():
        more = {
            "accuracy": [[arguments.pictures / f"tacto_{key}.png"]],
            "net": [[resolution] for resolution in arguments.resolution],
            "image": [[arguments.steps]],
        }
        for extra in more.get(arguments.command, [[]]):
            row = harness.fresh(__file__, arguments.command, source, scale, arguments.contacts, *extra)
            rows.append({"object": key, **row})
    titles = {
        "speed": ("CPU ms per image, one thread; the reference is TACTO's renderer on OpenGL", SPEED),
        "query": ("CPU ms per touch of an Object File, one thread", QUERY),
        "dataset": ("Contacts with the soft gel, one thread", DATASET),
        "accuracy": ("PSNR in dB against TACTO's renderer on OpenGL, all pixels and in contact", ACCURACY),
        "net": ("TouchNet geometric, held-out contacts, PSNR in dB; unobstructed but for `all`", NET),
        "image": ("TouchNet image, PSNR in dB beside the mean image's", IMAGES),
    }
    show(rows, *titles[arguments.command], console)
    missed = misses(arguments.command, rows)
    targets = described_targets(arguments.command)
    harness.write_record(arguments.json, {arguments.command: rows}, targets, missed)
    harness.exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
