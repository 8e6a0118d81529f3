"""Typed parameters. Each stage gets only the slice of ``params.yaml`` that it declares in ``dvc.yaml``."""

import json
import re
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from ruamel.yaml import YAML, YAMLError

from objectfolder.errors import ObjectFolderError
from objectfolder.materials import material

PARAMS_FILE = "params.yaml"
KEY = re.compile(r"[a-z][a-z0-9_]*")
Bridge = Literal["all", "fem", "off"]
Count = Field(ge=1)


class Section(BaseModel):
    """Frozen, and unknown names are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class ObjectEntry(Section):
    """One object."""

    mesh: str  #: under data/objects/<key>/
    material: str
    scale: float = Field(gt=0, le=100)  #: longest side, metres
    up: Literal["y", "z"] = "z"  #: up axis of the source mesh
    wall: float | None = Field(default=None, gt=0)  #: thickness given to open sheets, metres; null: 2 %
    bridge: Bridge = "all"  #: fill small gaps: everywhere, for sound alone, nowhere

    @field_validator("scale", "wall", mode="before")
    @classmethod
    def _number(cls, value: Any) -> Any:
        return float(value) if isinstance(value, int) and not isinstance(value, bool) else value

    @field_validator("material")
    @classmethod
    def _known(cls, value: str) -> str:
        return material(value).name


class ProceduralEntry(BaseModel):
    """An object that ``objectfolder.mesh.procedural`` generates; other fields go to the generator."""

    model_config = ConfigDict(frozen=True, extra="allow")

    generator: str


class Shared(Section):
    """Values that several stages use."""

    seed: int = Field(ge=0)
    sensor: str  #: profile in objectfolder/touch/profiles


class NormalizeParams(Section):  # noqa: D101
    texture_size: int = Count  #: longest side of the texture that is kept, pixels


class VoxelizeParams(Section):  # noqa: D101
    #: what vibrates is divided into these (docs/modal.md)
    element: Literal["cut_cell_hex20", "hex8", "hex8_incompatible", "tet10"]
    resolutions: list[int] = Field(min_length=1)  #: cells along the longest side, finest first
    subdivisions: int = Field(ge=4)  #: sub-cells along each side of a cell; fewer lose walls
    max_degrees_of_freedom: int = Count  #: take the first resolution under this size
    sdf_resolution: int = Field(ge=16, le=256)  #: finer, the band is narrower than the contact normals' reach


class FineGridParams(Section):  # noqa: D101
    resolution: int = Count  #: cells along the longest side
    subdivisions: int = Field(ge=4)  #: sub-cells along each side of a cell
    max_degrees_of_freedom: int = Count  #: not taken beyond this size
    max_error: float = Field(
        gt=0
    )  #: that the first grid may have, estimated, in the eight lowest frequencies


class ModalParams(Section):  # noqa: D101
    fine: FineGridParams  #: taken where walls are thin or the error of voxelize's grid is large
    max_frequency: float = Field(gt=20)  #: Hz
    max_modes: int = Count
    surface_points: int = Field(ge=0)  #: random points, besides the surface's vertices


class RenderViewsParams(Section):  # noqa: D101
    renderer: Literal["mitsuba", "mitsuba-llvm", "mitsuba-cuda", "cycles", "raster"]  #: docs/pipeline.md
    ambient: float = Field(ge=0)  #: radiance from every direction, beside the point light
    resolution: int = Count  #: pixels along a side
    train: int = Count  #: views
    val: int = Count
    test: int = Count
    train_samples: int = Count  #: per pixel
    test_samples: int = Field(ge=2, multiple_of=2)  #: per pixel, validation and test: two halves


class RenderTouchParams(Section):  # noqa: D101
    locations: Literal["surface", "vertices"]  #: random points by area, or every vertex (as the paper)
    train: int = Count  #: contacts; with ``vertices``, every vertex is used and split 80/10/10
    val: int = Count
    test: int = Count
    renderer: Literal["gel", "tacto"]  #: the deformed gel, or what TACTO draws (sensor: tacto_digit)
    depth: float | None = Field(ge=0)  #: of every contact, metres; null: random, the sensor's press_depth
    angle: float | None  #: of every contact, radians; null: random


class VisionOsf(Section):  # noqa: D101
    width: int = Count  #: of the density network
    depth: int = Count
    branch_width: int = Count  #: of the network of the scattered fraction
    branch_depth: int = Count
    point_octaves: int = Field(ge=0, le=16)  #: of the positional encoding
    direction_octaves: int = Field(ge=0, le=16)
    coarse_samples: int = Count  #: of a ray
    fine_samples: int = Count
    steps: int = Count
    batch: int = Count  #: of rays
    learning_rate: float = Field(gt=0)


class TrainVisionParams(Section):  # noqa: D101
    net: Literal["surface", "osf"]
    levels: int = Count
    features: int = Count
    table_bits: int = Field(ge=4, le=24)
    coarsest: int = Count
    finest: int = Count
    width: int = Count
    points: int = Count  #: of the surface, to learn its look from
    point_steps: int = Count
    point_batch: int = Count
    pixels: int = Count  #: of all training views, to learn what bounces from
    steps: int = Count
    batch: int = Count
    learning_rate: float = Field(gt=0)
    osf: VisionOsf  #: net and training of that kind; the fields above are those of ``surface``


class AudioSize(Section):  # noqa: D101
    modes: int = Count  #: for objects with at most this many modes
    resolution: int = Field(ge=1, le=128)  #: cells of the grid along each axis
    channels: int = Count  #: features of a node of the grid
    width: int = Count  #: of the first layer of sines
    features: int = Count  #: of the second
    frequency: float = Field(gt=0)  #: of the sines
    steps: int = Count
    learning_rate: float = Field(gt=0)
    grid_rate: float = Field(gt=0)  #: learning rate of the grid, relative


class AudioSpectrogram(Section):  # noqa: D101
    width: int = Count
    depth: int = Count
    point_octaves: int = Field(ge=0, le=16)  #: of the positional encoding
    bin_octaves: int = Field(ge=0, le=16)
    steps: int = Count
    batch: int = Count
    learning_rate: float = Field(gt=0)


class TrainAudioParams(Section):  # noqa: D101
    net: Literal["gains", "spectrogram"]
    sizes: list[AudioSize] = Field(min_length=1)  #: the first that is large enough, else the last
    batch: int = Count
    spectrogram: AudioSpectrogram  #: net and training of that kind; the fields above are those of ``gains``

    def size(self, modes: int) -> AudioSize:
        """Return the size for a number of modes."""
        return next((s for s in self.sizes if modes <= s.modes), self.sizes[-1])


class TouchImage(Section):  # noqa: D101
    width: int = Count
    depth: int = Count
    point_octaves: int = Field(ge=0, le=16)  #: of the positional encoding
    pixel_octaves: int = Field(ge=0, le=16)
    steps: int = Count
    batch: int = Count  #: of pixels
    learning_rate: float = Field(gt=0)


class TrainTouchParams(Section):  # noqa: D101
    net: Literal["geometric", "image"]
    offset_span: float = Field(gt=0)  #: search range of the depth offset, metres
    rounds: int = Count
    contacts: int = Count  #: training and validation contacts used at most
    image: TouchImage  #: net and training of that kind; the fields above are those of ``geometric``


class EvaluateParams(Section):  # noqa: D101
    impacts: int = Count  #: random impacts whose spectrograms are scored


class ObserveParams(Section):  # noqa: D101
    observations: int = Field(ge=10, multiple_of=10)  #: of each modality, for the benchmarks
    resolution: int = Field(ge=8)  #: of views, pixels along a side


SECTIONS: dict[str, type[Section]] = {
    "normalize": NormalizeParams,
    "voxelize": VoxelizeParams,
    "modal": ModalParams,
    "render_views": RenderViewsParams,
    "render_touch": RenderTouchParams,
    "train_vision": TrainVisionParams,
    "train_audio": TrainAudioParams,
    "train_touch": TrainTouchParams,
    "evaluate": EvaluateParams,
    "observe": ObserveParams,
}

#: What each stage declares: fields of its object's entry, and (`SHARED`) values that stages share.
#: A stage also gets the section of its own name, if there is one. A test compares this with dvc.yaml.
OBJECT_FIELDS: dict[str, tuple[str, ...]] = {
    "normalize": ("mesh", "scale", "up", "wall", "bridge"),
    "voxelize": (),
    "modal": ("material", "scale"),
    "render_views": (),
    "render_touch": ("scale",),
    "train_vision": (),
    "train_audio": (),
    "train_touch": ("scale",),
    "pack": ("material",),
    "evaluate": (),
    "observe": (),
}
#: Stages over all objects, or those that are grasped, by split; objectfolder/benchmarks/params.py has their
#: parameters.
TASKS = ("recognize", "retrieve", "reconstruct", "grasp_stability")
#: Stages of the objects that ``benchmarks`` in ``params.yaml`` names.
ROBOT_STAGES = ("decompose", "grasp_data", "grasp_policy", "reach")
#: Shared parameters, by the stage that reads them.
SHARED: dict[str, tuple[str, ...]] = {
    "modal": ("seed",),
    "render_views": ("seed",),
    "render_touch": ("seed", "sensor"),
    "train_vision": ("seed",),
    "train_audio": ("seed",),
    "train_touch": ("seed", "sensor"),
    "evaluate": ("seed",),
    "observe": ("seed",),
}


def read(path: str | Path = PARAMS_FILE) -> dict[str, Any]:
    """Read ``params.yaml`` without interpreting it.

    Raises
    ------
    ObjectFolderError
        If it is missing, not YAML, or an object key is not a slug.
    """
    path = Path(path)
    if not path.is_file():
        raise ObjectFolderError(f"{path} does not exist; run inside an objectfolder workspace")
    try:
        values = YAML(typ="safe").load(path.read_text())
    except (YAMLError, UnicodeDecodeError) as error:
        raise ObjectFolderError(f"{path} is not valid YAML: {error}") from error
    if not isinstance(values, dict):
        raise ObjectFolderError(f"{path} holds {type(values).__name__}, expected a mapping")
    for group in ("objects", "procedural"):
        entries = values.get(group)
        if not isinstance(entries, dict):
            raise ObjectFolderError(f"{path}: {group} must be a mapping from keys to entries (or {{}})")
        for key in entries:
            check_key(key, f"{path}: {group}")
    return values


def check_key(key: Any, where: str = "object key") -> str:
    """Return a valid object key.

    Raises
    ------
    ObjectFolderError
        If it is not a slug. DVC drops integer keys silently and takes a dot for a path.
    """
    stages = {*SECTIONS, *OBJECT_FIELDS, *TASKS, *ROBOT_STAGES}
    if isinstance(key, str) and KEY.fullmatch(key) and key not in stages:
        return key
    reason = (
        "DVC drops integer keys silently"
        if isinstance(key, int)
        else "DVC reads a dot as a path into the parameters"
        if isinstance(key, str) and "." in key
        else "it is the name of a stage"
        if isinstance(key, str) and key in stages
        else "keys become file and stage names"
    )
    raise ObjectFolderError(
        f"{where}: {key!r} is not a valid object key ({reason}); expected a letter, then letters, digits or "
        "underscores, all lower case"
    )


def object_entry(key: str, values: dict[str, Any], path: str | Path = PARAMS_FILE) -> ObjectEntry:
    """Validate one object's entry.

    Raises
    ------
    ObjectFolderError
        If there is none, or a field is wrong.
    """
    if key not in values["objects"]:
        known = ", ".join(values["objects"]) or "none yet"
        raise ObjectFolderError(
            f"{path} has no object {key!r} (it has {known}); add it with `objectfolder add`"
        )
    valid = validate(ObjectEntry, values["objects"][key], f"{path}: objects.{key}")
    home = PurePosixPath("data/objects") / key
    mesh = PurePosixPath(valid.mesh)
    if home not in mesh.parents or ".." in mesh.parts:
        raise ObjectFolderError(f"{path}: objects.{key}.mesh is {valid.mesh!r}, expected a file in {home}/")
    return valid


def stage_params(stage: str, key: str, path: str | Path = PARAMS_FILE) -> SimpleNamespace:
    """Return the slice of the parameters that a stage declares.

    Returns
    -------
    SimpleNamespace
        ``object`` with the declared fields of the object's entry, ``section`` (or None), and the shared
        values ``seed`` and ``sensor`` where declared. Anything else is an AttributeError, so that nothing
        undeclared is read.
    """
    values = read(path)
    entry = object_entry(check_key(key), values, path)
    section = None
    if stage in SECTIONS:
        if stage not in values:
            raise ObjectFolderError(f"{path} lacks section {stage!r}; run `objectfolder preset quick`")
        section = validate(SECTIONS[stage], values[stage], f"{path}: {stage}")
    return SimpleNamespace(
        object=SimpleNamespace(**{field: getattr(entry, field) for field in OBJECT_FIELDS[stage]}),
        section=section,
        **{name: getattr(_shared(values, path), name) for name in SHARED.get(stage, ())},
    )


def procedural_entry(key: str, path: str | Path = PARAMS_FILE) -> tuple[str, dict[str, Any]]:
    """Generator name and parameters of a procedural object."""
    values = read(path)
    entry = values["procedural"].get(key)
    if entry is None:
        raise ObjectFolderError(f"{path}: procedural has no {key!r}")
    valid = validate(ProceduralEntry, entry, f"{path}: procedural.{key}")
    return valid.generator, dict(valid.model_extra or {})


def check_all(values: dict[str, Any], path: str | Path = PARAMS_FILE) -> None:
    """Validate everything, before a long build starts."""
    for key, entry in values["objects"].items():
        object_entry(key, values, path)
        lacking = [name for name in ObjectEntry.model_fields if name not in entry]
        if lacking:
            default = ObjectEntry.model_construct()
            fields = ", ".join(f"{name}: {json.dumps(getattr(default, name))}" for name in lacking)
            raise ObjectFolderError(
                f"{path}: objects.{key} lacks {', '.join(lacking)}, which DVC tracks; add `{fields}`"
            )
    for key, entry in values["procedural"].items():
        validate(ProceduralEntry, entry, f"{path}: procedural.{key}")
    for name, model in SECTIONS.items():
        if name not in values:
            raise ObjectFolderError(f"{path} lacks section {name!r}; run `objectfolder preset quick`")
        validate(model, values[name], f"{path}: {name}")
    _shared(values, path)


def _shared(values: dict[str, Any], path: str | Path) -> Shared:
    return validate(Shared, {name: values.get(name) for name in Shared.model_fields}, str(path))


def validate(model: type[BaseModel], value: Any, where: str) -> Any:
    """Return a section as its model.

    Raises
    ------
    ObjectFolderError
        If a field is lacking, unknown or wrong; the message begins with ``where``.
    """
    try:
        return model.model_validate(value)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, e['loc'])) or 'entry'}: {e['msg']}, got {e['input']!r}"
            for e in error.errors()
        )
        raise ObjectFolderError(f"{where}: {problems}") from error
