"""Shapes from real photographs: `python perf/real_photographs.py MODEL IMAGES --files FOLDER`.

IMAGES is data/demo_images of https://github.com/yuxng/PoseCNN (MIT licence): five photographs of YCB objects
on tables, with depth. An object's mask is what stands on the table inside of a box drawn by hand; the clamp,
whose black plastic has no depth, is left out. Where FOLDER has the object's Object File, the IoU is that of
the best of 24 turns about the vertical axis, which a photograph does not tell. Beside it is the average shape
of the model's objects, at the level that suits these objects best.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from harness import parsed, write_record
from PIL import Image
from rich.console import Console
from rich.table import Table
from scipy import ndimage

from objectfolder.base.io import atomic
from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets.occupancy import is_inside, uniform_points
from objectfolder.benchmarks.models.framing import frame_cutout
from objectfolder.benchmarks.models.shape_model import ShapeModel, load_model
from objectfolder.benchmarks.reporting.shape_pictures import sheet
from objectfolder.benchmarks.scoring.shapes import intersection_over_union
from objectfolder.benchmarks.scoring.truth import THRESHOLDS, best_level
from objectfolder.benchmarks.tasks.photograph import cut_out, photograph_to_mesh, read_picture
from objectfolder.objectfile.file import ObjectFile

FOCAL, CENTRE, UNITS = (1066.778, 1067.487), (312.9869, 241.3109), 10000.0  #: tools/demo.py of PoseCNN
HEIGHTS = (0.004, 0.4)  #: m above the table
JUMP = 0.012  #: m between neighbouring pixels of two objects
#: By image, a box that shows the bare table: left, top, right, bottom, pixels.
TABLES = {
    1: (405, 390, 635, 475),
    2: (350, 425, 450, 475),
    3: (286, 300, 328, 470),
    4: (265, 432, 335, 462),
    5: (5, 360, 140, 460),
}
TURNS, POINTS = 24, 30000


@dataclass(frozen=True)
class Photograph:
    """An object in a photograph."""

    image: int
    name: str
    box: tuple[int, int, int, int]  #: left, top, right, bottom, pixels
    key: str | None = None  #: of its Object File


PHOTOGRAPHS = (
    Photograph(3, "bowl", (322, 250, 545, 420), "ycb_bowl"),
    Photograph(3, "soup can", (168, 298, 286, 458), "ycb_tomato_soup_can"),
    Photograph(4, "pitcher", (236, 62, 462, 352), "ycb_pitcher"),
    Photograph(1, "drill", (40, 230, 290, 385), "ycb_power_drill"),
    Photograph(5, "drill", (250, 112, 440, 330), "ycb_power_drill"),
    Photograph(1, "mustard bottle", (318, 192, 404, 458)),
    Photograph(2, "cleanser bottle", (208, 22, 318, 298)),
    Photograph(5, "cleanser bottle", (112, 44, 230, 320)),
    Photograph(2, "sugar box", (190, 284, 346, 452)),
)


def mask(depth: np.ndarray, photograph: Photograph) -> np.ndarray:
    """Return which pixels (H, W) show the largest thing that stands on the table within the box."""
    height, width = depth.shape
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    metres = depth / UNITS
    points = np.stack(
        [(column - CENTRE[0]) / FOCAL[0] * metres, (row - CENTRE[1]) / FOCAL[1] * metres, metres], -1
    )
    bare = points[within(TABLES[photograph.image], depth.shape) & (depth > 0)]
    normal = np.linalg.svd(bare - bare.mean(0), full_matrices=False)[2][2]
    above = (points - bare.mean(0)) @ normal * -np.sign(normal @ bare.mean(0))
    solid = (depth > 0) & (above > HEIGHTS[0]) & (above < HEIGHTS[1])
    spread = ndimage.maximum_filter(metres, 3) - ndimage.minimum_filter(metres, 3)
    parts, count = ndimage.label(solid & within(photograph.box, depth.shape) & (spread < JUMP))
    sizes = ndimage.sum_labels(np.ones_like(parts), parts, range(1, count + 1))
    grown = ndimage.binary_dilation(parts == 1 + int(np.argmax(sizes)), iterations=4)
    return ndimage.binary_erosion(ndimage.binary_fill_holes(grown), iterations=2)


def within(box: tuple[int, int, int, int], shape: tuple[int, ...]) -> np.ndarray:
    """Return which pixels of a picture of this shape are in a box."""
    left, top, right, bottom = box
    chosen = np.zeros(shape, bool)
    chosen[top:bottom, left:right] = True
    return chosen


def turned(points: np.ndarray) -> list[np.ndarray]:
    """Return points (P, 3), turned about the vertical axis."""
    angles = 2 * np.pi * np.arange(TURNS) / TURNS
    zero, one = np.zeros_like(angles), np.ones_like(angles)
    cos, sin = np.cos(angles), np.sin(angles)
    turns = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]).transpose(2, 0, 1)
    return [(points @ turn.T).astype(np.float32) for turn in turns]


def found(folders: list[Path], key: str) -> Path | None:
    """Return an object's Object File in the first of the folders that has it."""
    paths = (folder / key / "ObjectFile.safetensors" for folder in folders)
    return next((path for path in paths if path.is_file()), None)


def average_inside(model: ShapeModel, folders: list[Path], points: np.ndarray) -> np.ndarray:
    """Return which points are inside the average shape of those of the model's objects that are at hand."""
    paths = [path for key in model.setup.keys if (path := found(folders, key))]
    inside = np.stack([is_inside(ObjectFile.load(path).surface, points) for path in paths])
    share = np.broadcast_to(inside.mean(0), inside.shape)
    return inside.mean(0) > best_level(share, inside, THRESHOLDS)[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path, help="reconstruct_seen.safetensors of the benchmark")
    parser.add_argument("images", type=Path, help="data/demo_images of PoseCNN")
    parser.add_argument(
        "--files", type=Path, nargs="+", required=True, help="folders KEY/ObjectFile.safetensors"
    )
    parser.add_argument("--sheet", type=Path, help="picture to draw, .webp")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    model = load_model(given.model)
    points = uniform_points(POINTS, numpy_generator(0, "real photographs"))
    average = average_inside(model, given.files, points)
    views, meshes, rows = [], [], []
    for photograph in PHOTOGRAPHS:
        stem = given.images / f"{photograph.image:06d}"
        depth = np.asarray(Image.open(f"{stem}-depth.png")).astype(np.float64)
        shown = mask(depth, photograph)
        picture = read_picture(f"{stem}-color.png")
        view = frame_cutout(cut_out(picture, 255 * shown.astype(np.uint8)), model.setup.view)
        vertices, faces = photograph_to_mesh(model, view)
        truth = (np.zeros((0, 3)), np.zeros((0, 3), int))
        row = {"image": photograph.image, "object": photograph.name, "key": photograph.key}
        if photograph.key and (path := found(given.files, photograph.key)):
            surface = ObjectFile.load(path).surface
            truth = surface.vertices, surface.faces
            inside = is_inside(surface, points)
            embedding = model.embed({"vision": view[None]})
            answers = [model.is_inside(embedding, turn)[0] for turn in turned(points)]
            row["iou"] = max(float(intersection_over_union(answer, inside)) for answer in answers)
            row["average_shape"] = float(intersection_over_union(average, inside))
        rows.append(row)
        views.append(view)
        meshes.append([(vertices, faces), truth])
    page = Table(title="Shapes from real photographs: IoU")
    for name in ("image", "object", "from the photograph", "average shape"):
        page.add_column(name)
    for row in rows:
        scores = [f"{row[name]:.2f}" if name in row else "-" for name in ("iou", "average_shape")]
        page.add_row(str(row["image"]), str(row["object"]), *scores)
    Console().print(page)
    if given.sheet:
        with atomic(given.sheet) as temporary:
            Image.fromarray(sheet(np.stack(views), meshes)).save(temporary, "webp", quality=80, method=6)
    write_record(given.json, {"rows": rows})


if __name__ == "__main__":
    main()
