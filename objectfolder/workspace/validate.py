"""Validate artifacts: one table that says how each kind of artifact is read."""

import csv
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from objectfolder.base.arrays import read_npz, read_safetensors
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import read_json
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.ply import read_surface
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.objectfile.evaluation import summary_row
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sound.fem.elements import solid_from_arrays
from objectfolder.sound.radiation.farfield import unpack_far_field
from objectfolder.stored.reading import report_damage
from objectfolder.workspace.layout import MODALITIES, SPLITS, Build

#: Array shapes; a letter stands for the same number throughout a file.
MODES = {
    **{"points": "p3", "split": "p", "shapes": "p3m", "eigenvalues": "m", "damping": "m"},
    **{"damped_frequency": "m", "truncated": "", "band_hz": "2"},
}
VIEWS = {"rgba": "nhw4", "camera_to_world": "n44", "light": "n3", "focal": "", "center": "n2", "renderer": ""}
TOUCHES = {
    **{"images": "nhw3", "masks": "nhw", "points": "n3", "normals": "n3", "depths": "n", "angles": "n"},
    **{"obstructed": "n", "max_penetration": "n", "area": "n", "force": "n", "renderer": ""},
}
SDF = {"values": "nnn", "band": ""}
NORMALIZE = (
    *("scale_m", "source_centre", "source_size", "source_up", "solid", "volume_m3", "rungs", "warnings"),
)


def readers(build: Build) -> dict[Path, Callable[[Path], Any]]:
    """Map each artifact of an object to its reader, which raises ObjectFolderError if it is not valid."""
    table: dict[Path, Callable[[Path], Any]] = {
        build.visual: partial(load_mesh, up="y"),
        build.surface: read_surface,
        build.solid_surface: read_surface,
        build.normalize: partial(_json, names=NORMALIZE),
        build.solid: lambda path: solid_from_arrays(read_npz(path, "kind")),
        build.sdf: lambda path: DistanceGrid.from_arrays(_arrays(path, SDF)),
        build.voxelize: partial(_json, names=("distance_grid",)),
        build.modes: partial(_arrays, shapes=MODES),
        build.modal: partial(_json, names=("modes", "mass_kg", "truncated")),
        build.radiation: _radiation,
        build.object_file: lambda path: ObjectFile.load(path).check(),
        build.metrics: lambda path: summary_row(build.key, read_json(path)),
    }
    table |= {build.views(split): partial(_arrays, shapes=VIEWS) for split in SPLITS}
    table |= {build.touch(split): partial(_arrays, shapes=TOUCHES) for split in SPLITS}
    table |= {build.net(modality): _net for modality in MODALITIES}
    table |= {build.curve(modality): _curve for modality in MODALITIES}
    sheets = (build.views_sheet, build.touch_sheet, build.vision_sheet, build.sound_sheet)
    return table | dict.fromkeys(sheets, _picture)


def find_problem(check: Callable[[Path], Any], path: Path) -> str:
    """Return the problem of an artifact in one line, or an empty string."""
    try:
        check(path)
    except ObjectFolderError as error:
        return str(error)
    except Exception as error:  # readers may raise anything on unexpected content
        return f"{path} is not valid: {type(error).__name__}: {error}".partition("\n")[0]
    return ""


def _arrays(path: Path, shapes: dict[str, str]) -> dict[str, np.ndarray]:
    arrays = read_npz(path, *shapes)
    sizes: dict[str, int] = {}
    for name, dims in shapes.items():
        shape = arrays[name].shape
        expected = [int(d) if d.isdigit() else sizes.setdefault(d, n) for d, n in zip(dims, shape)]
        if len(shape) != len(dims) or list(shape) != expected:
            raise ObjectFolderError(f"{path}: {name} has shape {shape}, expected {tuple(dims)}; rebuild it")
    return arrays


def _json(path: Path, names: tuple[str, ...]) -> None:
    missing = [name for name in names if name not in read_json(path)]
    if missing:
        raise ObjectFolderError(f"{path} lacks {', '.join(missing)}; rebuild it")


def _net(path: Path) -> None:
    _, header = read_safetensors(path)
    missing = [name for name in ("kind", "net") if name not in header]
    if missing:
        raise ObjectFolderError(f"{path} is not a net: it lacks {', '.join(missing)}; rebuild it")


def _radiation(path: Path) -> None:
    tensors, header = read_safetensors(path)
    with report_damage(str(path), "radiation"):
        unpack_far_field(tensors, header["radius"])


def _curve(path: Path) -> None:
    with path.open() as stream:
        rows = list(csv.reader(stream))
    if not rows or rows[0] != ["step", "train_loss", "val_loss"]:
        raise ObjectFolderError(f"{path} does not start with step,train_loss,val_loss; rebuild it")
    np.array(rows[1:], float)


def _picture(path: Path) -> None:
    with Image.open(path, formats=["PNG"]) as image:
        image.load()
