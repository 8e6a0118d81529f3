"""Conversion of a released file into an Object File."""

import dataclasses
import logging
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base import materials
from objectfolder.base.arrays import read_rows
from objectfolder.base.checks import finite_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import file_digest
from objectfolder.hub.importer import nets
from objectfolder.hub.importer.checkpoint import ReleasedDict, read_released
from objectfolder.nets.released_network import Frame
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sound.released_gains import ReleasedGains
from objectfolder.sound.released_spectrogram import ReleasedSpectrogram
from objectfolder.stored.header import checked_name, format_name
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.released_images import DEPTH_SIZE, ReleasedDepth, ReleasedImage
from objectfolder.vision.released_kilo import ReleasedKilo
from objectfolder.vision.released_nerf import ReleasedNerf
from objectfolder.workspace.layout import MODALITIES

SENSOR = "gelsight_r15"  #: default sensor that renders images from the depth maps of 2.0
RESOLUTION = 192  #: of a mesh's distance grid
ASSUMED_SCALE = 1.0  #: longest side of an object whose size nothing tells, metres
SIZE_MISMATCH = 0.1  #: greatest, between a mesh and the bounds that a file stores

_NAMES = {"vision": "VisionNet", "audio": "AudioNet", "touch": "TouchNet"}
_KINDS = {
    ReleasedNerf: "released_nerf",
    ReleasedKilo: "released_kilo",
    ReleasedSpectrogram: "released_spectrogram",
    ReleasedGains: "released_gains",
    ReleasedImage: "released_image",
    ReleasedDepth: "released_depth",
}
log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class ImportOptions:
    """Facts that a released file does not contain."""

    key: str | None = None  #: default: from the file's folder
    material: str = "unknown"
    scale: float | None = None  #: longest side, metres; default: that of the mesh or the bounds
    bounds: np.ndarray | None = None  #: (2, 3), of the object in the file's coordinates; required by 1.0
    mesh: Path | None = None  #: mesh in the file's coordinates; gives bounds and surface
    sensor: str | Path = SENSOR
    gel: Path | None = None  #: ``depth_bg.npy`` of the released code
    crop: float | None = None  #: half side of the cube outside of which space is empty, unit frame


def convert(path: str | Path, options: ImportOptions = ImportOptions()) -> ObjectFile:
    """Read a released ObjectFolder 1.0 or 2.0 file. Parts that cannot be read are left out with a warning.

    Returns an Object File with parts of kinds ``released_*``, and a surface if a mesh is given. Raises
    ObjectFolderError if no part can be read, an option is invalid, or a mesh is of another size than the
    file's object.
    """
    path = Path(path)
    # Checked here: an error of a part would leave the part out. `workspace.stages.check_key` needs an extra.
    if options.key is not None:
        checked_name("key", options.key, "key")
    checked_name("material", options.material, "material")
    sensor, gel = load_profile(options.sensor), _gel(options.gel)
    if options.crop is not None and finite_number("crop", options.crop) <= 0:
        expected = "half the side of a cube in the unit frame, such as 0.6"
        raise ObjectFolderError(f"crop is {options.crop!r}, expected {expected}")
    checkpoint = read_released(path)
    stored = _stored_bounds(checkpoint)
    bounds, geometry = _body(options, stored)
    where = bounds if bounds is not None else stored
    scale = options.scale
    if scale is None:
        scale = ASSUMED_SCALE if where is None else float(np.ptp(where, axis=0).max())
    frame = Frame(unit=scale)
    if geometry is not None and bounds is not None:
        low, high = bounds
        frame = Frame(tuple(((low + high) / 2).tolist()), float((high - low).max()))
    readers: dict[str, Callable[[ReleasedDict], Any]] = {
        "vision": lambda part: (nets.nerf_net if "network_fn_state_dict" in part else nets.configured_net)(
            part, options.crop
        ),
        "audio": lambda part: (nets.spectrogram_net if "voxel_vertex" in part else nets.gains_net)(
            part, frame
        ),
        "touch": lambda part: _touch(part, frame, bounds, sensor, gel),
    }
    header: dict[str, Any] = {
        "format": format_name(),
        "key": options.key or _key(path),
        "material": options.material,
        "scale": scale,
        "provenance": {"released": file_digest(path)},
    }
    if options.material in materials.material_names():
        properties = dataclasses.asdict(materials.material(options.material))
        header["material_properties"] = {name: properties[name] for name in properties if name != "name"}
    tensors: dict[str, np.ndarray] = {}
    notes: list[str] = []

    def note(text: str) -> None:
        notes.append(text)
        log.warning("%s", text)

    for modality in MODALITIES:
        try:
            net = readers[modality](checkpoint.part(_NAMES[modality]))
        except ObjectFolderError as error:
            note(f"{modality} is left out: {error}")
            continue
        net_tensors, config = net.to_tensors()
        header[modality] = {"kind": _KINDS[type(net)], "net": config}
        tensors |= {f"{modality}.{name}": value for name, value in net_tensors.items()}
    if not tensors:
        raise ObjectFolderError(f"{path}: nothing could be imported. " + "; ".join(notes))
    if options.scale is None and where is None:
        note(f"longest side not known ({scale:g} m assumed): give --scale or --bounds")
    kinds = {header[modality]["kind"] for modality in MODALITIES if modality in header}
    release = "ObjectFolder 1.0" if {"released_spectrogram", "released_image"} & kinds else "ObjectFolder 2.0"
    header["imported"] = {"release": release, "notes": notes}
    if geometry is not None:
        header["geometry"], tensors["geometry.distances"], header["source"] = geometry
    return ObjectFile(header, tensors, path)


def _touch(
    part: ReleasedDict, frame: Frame, bounds: np.ndarray | None, sensor: SensorProfile, gel: np.ndarray | None
) -> ReleasedImage | ReleasedDepth:
    if "xyz_min" in part or "xyz_max" in part:
        return nets.depth_net(part, frame, sensor, gel)
    if bounds is None:
        absent = f"{part.path}: {part.name} holds no xyz_min; a file of 1.0 does not contain its bounds"
        raise ObjectFolderError(f"{absent}: pass --bounds or --mesh")
    return nets.image_net(part, frame, bounds)


def _gel(path: Path | None) -> np.ndarray | None:
    if path is None:
        return None
    expected = f"heights of shape {DEPTH_SIZE}, as calibs/depth_bg.npy"
    heights = read_rows(path, DEPTH_SIZE[1], f": {expected}")
    if heights.shape != DEPTH_SIZE:
        raise ObjectFolderError(f"{path} has {len(heights)} rows; expected {expected}")
    if not np.isfinite(heights).all():
        raise ObjectFolderError(f"{path} holds values that are not finite")
    return heights


def _stored_bounds(checkpoint: ReleasedDict) -> np.ndarray | None:
    """Return the bounds stored in a file of 2.0, or None."""
    with suppress(ObjectFolderError):
        return np.array(nets.box(checkpoint.part("TouchNet")))
    with suppress(ObjectFolderError):
        return np.array(nets.box(checkpoint.part("AudioNet").part("normalizer")))
    return None


def _body(options: ImportOptions, stored: np.ndarray | None) -> tuple[np.ndarray | None, Any]:
    """Return the bounds in the file's coordinates, and the geometry's header, stream and source, if known.

    A mesh is compared with the bounds that the file stores, unless a scale is given.
    """
    if options.scale is not None and not 0 < options.scale < np.inf:
        raise ObjectFolderError(f"scale is {options.scale!r}, expected the longest side in metres")
    if options.mesh is None:
        if options.bounds is None:
            return None, None
        bounds = np.asarray(options.bounds, np.float64)
        if bounds.shape != (2, 3) or not np.isfinite(bounds).all() or not (bounds[0] < bounds[1]).all():
            expected = "xmin ymin zmin xmax ymax zmax, each minimum below its maximum"
            raise ObjectFolderError(f"bounds are {bounds.ravel().tolist()}, expected {expected}")
        return bounds, None
    if options.bounds is not None:
        both = f"bounds are given beside the mesh {options.mesh}, which has its own"
        raise ObjectFolderError(f"{both}; leave one of them out")
    # Imported here: needs the build extra. The mesh is not rotated, so that its axes stay those of the file.
    from objectfolder.mesh.gridcodec import pack_grid
    from objectfolder.mesh.normalize import normalize
    from objectfolder.mesh.reading.load import load_mesh
    from objectfolder.mesh.sdf import distance_grid

    mesh = load_mesh(options.mesh, "z")
    bounds = np.asarray(mesh.bounds, np.float64)
    if stored is not None and options.scale is None:
        _check_size(options.mesh, bounds, stored)
    solid = normalize(mesh, str(options.mesh))
    values, band = distance_grid(solid.surface.vertices, solid.surface.faces, RESOLUTION)
    stream, predictor = pack_grid(values)
    header = {"kind": "distance_grid", "resolution": RESOLUTION, "band": float(band), "predictor": predictor}
    centre, size = solid.source_centre.tolist(), solid.source_size
    source = {"source_centre": centre, "source_size": size, "source_up": "z"}
    return bounds, (header, stream, source)


def _check_size(mesh: Path, bounds: np.ndarray, stored: np.ndarray) -> None:
    """Raise unless a mesh is as large as the file's object; stored bounds may be one pair for all axes."""
    pair = not np.ptp(stored, axis=1).any()
    size, expected = (np.ptp(x, axis=None if pair else 0).max() for x in (bounds, stored))
    if abs(size / expected - 1) > SIZE_MISMATCH:
        what = f"its {'coordinates span' if pair else 'longest side is'} {size:.4g}"
        raise ObjectFolderError(
            f"{mesh}: {what}, the file's stored bounds say {expected:.4g}; expected a mesh in the "
            "coordinates of the released file. If it is that, give --scale, its longest side in metres"
        )


def _key(path: Path) -> str:
    """Derive a key from the folder of a file, whose name is a number in the releases."""
    name = re.sub(r"[^a-z0-9]+", "_", path.resolve().parent.name.lower()).strip("_")
    return name if re.match(r"[a-z]", name) else f"object_{name}".rstrip("_")
