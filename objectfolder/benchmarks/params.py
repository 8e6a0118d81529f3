"""Typed parameters of the benchmarks: the sections of ``params.yaml`` for what is done with all objects."""

from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, field_validator

from objectfolder.errors import ObjectFolderError
from objectfolder.params import PARAMS_FILE, TASKS, Section, Shared, read, validate

Count = Field(ge=1)
Sizes = Field(min_length=2, max_length=2)


class EncodeParams(Section):  # noqa: D101
    encoder: str  #: registered in objectfolder/benchmarks/encoders.py
    image: int = Field(ge=8)  #: side of the crop of a view, pixels
    spectrogram: list[int] = Sizes  #: bins and frames; the paper's: 257, 201
    touch: list[int] = Sizes  #: height and width, pixels; the paper's: 160, 120


class Training(Section):
    """What the tasks share."""

    epochs: int = Count  #: at most
    batch: int = Field(ge=2)
    learning_rate: float = Field(gt=0)
    weight_decay: float = Field(ge=0)
    patience: int = Count  #: epochs without a better validation score after which training stops


class RecognizeParams(Training):  # noqa: D101
    seeds: int = Count  #: runs whose mean is the result
    fusion_epochs: int = Count  #: of several modalities together, after each was trained alone


class RetrieveParams(Training):  # noqa: D101
    seeds: int = Count  #: runs whose mean is the result
    margin: float = Field(gt=0)  #: of the triplet losses, cosine distance
    embedding: int = Count  #: features that are compared


class ReconstructParams(Training):  # noqa: D101
    naming: float = Field(ge=0)  #: weight of a loss for naming the object by its features; 0 is the paper's
    points: int = Count  #: whose occupancy is learned, per observation and step
    width: int = Count  #: of the occupancy network
    blocks: int = Count
    frequencies: int = Field(ge=0, le=12)  #: octaves of the points' positional encoding; 0 is the paper's
    resolution: int = Field(ge=8)  #: of marching cubes
    score_points: int = Count  #: of IoU, and of either surface for the distances
    views: int = Count  #: test observations per object that are meshed


class GraspStabilityParams(Training):  # noqa: D101
    seeds: int = Count  #: runs whose mean is the result
    #: Grasps that are learnt from, ascending; what exceeds those that there are ends with all of them.
    sizes: list[Annotated[int, Field(ge=2)]] = Field(min_length=1)
    epoch_grasps: int = Count  #: an epoch over fewer of them goes over each as often as fits into so many
    fusion_epochs: int = Count  #: of vision and touch together, after each was trained alone
    hidden: int = Count  #: units between both fully connected layers, for each of vision and touch
    touch: list[int] = Sizes  #: height and width that touches are averaged to, instead of those of ``encode``

    @field_validator("sizes")
    @classmethod
    def _ascending(cls, sizes: list[int]) -> list[int]:
        if sizes != sorted(set(sizes)):
            raise ValueError("expected ascending numbers, none twice")
        return sizes


SECTIONS: dict[str, type[Section]] = {
    "encode": EncodeParams,
    "recognize": RecognizeParams,
    "retrieve": RetrieveParams,
    "reconstruct": ReconstructParams,
    "grasp_stability": GraspStabilityParams,
}


class Splits(Section):
    """Splits on which a build runs each task: ``benchmarks`` in ``params.yaml``."""

    recognize: list[Literal["seen"]]
    retrieve: list[Literal["seen", "unseen"]]
    reconstruct: list[Literal["seen", "unseen"]]


def splits_of(task: str) -> tuple[str, ...]:
    """Names of the splits that a task knows; nobody can name an object that he never met."""
    return ("seen",) if task == "recognize" else ("seen", "unseen")


def task_params(task: str, values: dict[str, Any], path: str | Path = PARAMS_FILE) -> SimpleNamespace:
    """Return what a task reads: its own ``section``, ``encode`` and ``seed``.

    Parameters
    ----------
    task : str
        One of `objectfolder.params.TASKS`.
    values : dict
        Contents of ``params.yaml``, perhaps with a preset merged into it.
    path : path, optional
        Named in errors.

    Raises
    ------
    ObjectFolderError
        If a section is lacking or wrong.
    """
    section, encode = (_section(name, values, path) for name in (task, "encode"))
    shared = validate(Shared, {name: values.get(name) for name in Shared.model_fields}, str(path))
    return SimpleNamespace(section=section, encode=encode, seed=shared.seed)


def check_tasks(values: dict[str, Any], path: str | Path = PARAMS_FILE) -> None:
    """Validate all sections about benchmarks, before a long build starts."""
    for task in TASKS:
        task_params(task, values, path)
    if "benchmarks" not in values:
        empty = ", ".join(f"{task}: []" for task in TASKS)
        raise ObjectFolderError(
            f"{path} lacks `benchmarks`, the splits that a build runs; add `benchmarks: {{{empty}}}`"
        )
    validate(Splits, values["benchmarks"], f"{path}: benchmarks")


def stage_params(task: str, path: str | Path = PARAMS_FILE) -> SimpleNamespace:
    """Return a task's parameters from ``params.yaml``, and the ``keys`` of all objects."""
    values = read(path)
    params = task_params(task, values, path)
    params.keys = tuple(values["objects"])
    return params


def _section(name: str, values: dict[str, Any], path: str | Path) -> BaseModel:
    if name not in values:
        raise ObjectFolderError(f"{path} lacks section {name!r}; run `objectfolder preset quick`")
    return validate(SECTIONS[name], values[name], f"{path}: {name}")
