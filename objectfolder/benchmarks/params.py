"""Typed parameters of the benchmarks: the sections of ``params.yaml`` for what is done with all objects."""

from collections.abc import Collection
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, field_validator

from objectfolder.errors import ObjectFolderError
from objectfolder.workspace.params import PARAMS_FILE, ROBOT_STAGES, TASKS, Section, Shared, read, validate

Count = Field(ge=1)
Sizes = Field(min_length=2, max_length=2)


class EncodeParams(Section):  # noqa: D101
    encoder: str  #: registered in objectfolder/benchmarks/models/encoders.py
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


class ReachParams(Section):
    """Proximal policy optimisation (PPO); names are those of Schulman et al. 2017 where they have any."""

    seeds: int = Count  #: trainings
    steps: int = Count  #: control steps of a training, at most
    horizon: int = Count  #: control steps (12.5 ms) of an episode
    goals: int = Count  #: of the test, and as many others of the validation
    environments: int = Count  #: side by side
    rollout: int = Count  #: control steps in each of them between updates
    batch: int = Field(ge=2)
    epochs: int = Count  #: over what a rollout has seen
    learning_rate: float = Field(gt=0)  #: at the start; linear to 0 at `steps`
    discount: float = Field(gt=0, le=1)  #: gamma, per control step
    width: int = Count  #: of both hidden layers
    log_deviation: float  #: natural logarithm of the actions' first standard deviation


class DecomposeParams(Section):  # noqa: D101
    hulls: int = Count  #: at most, of an object


class GraspDataParams(Section):
    """What is collected of each object that is grasped."""

    grasps: int = Field(ge=10, multiple_of=10)
    perturbations: int = Field(ge=0)  #: repetitions of each grasp, slightly changed, for the soft label
    image: int = Field(ge=8)  #: side of the camera's pictures, pixels
    touch: list[int] = Sizes  #: height and width of tactile images, pixels; the sensor's: 160, 120
    timestep: float = Field(gt=0, le=0.004)  #: of the simulation, s


class GraspPolicyParams(Section):
    """Trust region policy optimisation (TRPO), with the constants of the supplementary, I.4."""

    seeds: int = Count  #: trainings
    episodes: int = Count  #: of a training
    environments: int = Count  #: episodes side by side
    rollout: int = Field(ge=2, multiple_of=2)  #: steps in each of them between updates
    updates: int = Count  #: of a part, after which the policy is validated and kept
    patience: int = Count  #: parts without a better validation after which training stops
    batch: int = Field(ge=2)  #: of the value function
    learning_rate: float = Field(gt=0)  #: of the value function
    discount: float = Field(gt=0, le=1)  #: gamma
    gae: float = Field(ge=0, le=1)  #: lambda of generalised advantage estimation
    damping: float = Field(gt=0)  #: alpha of the conjugate gradients
    divergence: float = Field(gt=0)  #: delta, KL divergence of an update
    width: int = Count  #: of both hidden layers
    log_deviation: float  #: natural logarithm of the actions' first standard deviation
    rollouts: int = Count  #: episodes of the test, and as many others of the validation
    presses: int = Count  #: poses at which both fingers' features are kept


SECTIONS: dict[str, type[Section]] = {
    "encode": EncodeParams,
    "recognize": RecognizeParams,
    "retrieve": RetrieveParams,
    "reconstruct": ReconstructParams,
    "decompose": DecomposeParams,
    "grasp_stability": GraspStabilityParams,
    "grasp_data": GraspDataParams,
    "grasp_policy": GraspPolicyParams,
    "reach": ReachParams,
}


class Wanted(Section):
    """What a build runs: ``benchmarks`` in ``params.yaml``, by stage the splits or the objects."""

    recognize: list[Literal["seen"]]
    retrieve: list[Literal["seen", "unseen"]]
    reconstruct: list[Literal["seen", "unseen"]]
    grasp_stability: list[Literal["seen", "unseen"]]
    decompose: list[str]
    grasp_data: list[str]
    grasp_policy: list[str]
    reach: list[str]


def splits_of(task: str) -> tuple[str, ...]:
    """Names of the splits that a task knows; nobody can name an object that he never met."""
    return ("seen",) if task == "recognize" else ("seen", "unseen")


def task_params(task: str, values: dict[str, Any], path: str | Path = PARAMS_FILE) -> SimpleNamespace:
    """Return what a task reads: its own ``section``, ``encode`` and ``seed``.

    Parameters
    ----------
    task : str
        One of `objectfolder.workspace.params.TASKS`.
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


def robot_params(stage: str, values: dict[str, Any], path: str | Path = PARAMS_FILE) -> SimpleNamespace:
    """Return what a stage of `objectfolder.workspace.params.ROBOT_STAGES` reads: ``section`` and ``seed``.

    Raises
    ------
    ObjectFolderError
        If the section is lacking or wrong.
    """
    shared = validate(Shared, {name: values.get(name) for name in Shared.model_fields}, str(path))
    return SimpleNamespace(section=_section(stage, values, path), seed=shared.seed)


def check_tasks(values: dict[str, Any], path: str | Path = PARAMS_FILE) -> None:
    """Validate all sections about benchmarks, before a long build starts.

    Raises
    ------
    ObjectFolderError
        If one is lacking or wrong, ``benchmarks`` names an object that does not exist, or asks for a stage
        without that which it depends on.
    """
    for task in TASKS:
        task_params(task, values, path)
    for stage in ROBOT_STAGES:
        robot_params(stage, values, path)
    if "benchmarks" not in values:
        empty = ", ".join(f"{name}: []" for name in Wanted.model_fields)
        raise ObjectFolderError(
            f"{path} lacks `benchmarks`, what a build runs; add `benchmarks: {{{empty}}}`"
        )
    wanted = validate(Wanted, values["benchmarks"], f"{path}: benchmarks")
    for stage in ROBOT_STAGES:
        keys = getattr(wanted, stage)
        _require(f"{path}: benchmarks.{stage}", keys, values["objects"], "is no object")
        _require(f"{path}: benchmarks.{stage}", keys, wanted.decompose, "lacks in benchmarks.decompose")
    if wanted.grasp_stability and len(wanted.grasp_data) < 2:
        raise ObjectFolderError(
            f"{path}: benchmarks.grasp_stability needs grasps of two objects at least; name them in "
            "benchmarks.grasp_data"
        )


def _require(where: str, keys: list[str], known: Collection[str], fault: str) -> None:
    wrong = [key for key in keys if key not in known]
    if wrong:
        raise ObjectFolderError(f"{where}: {wrong[0]} {fault}; expected one of {', '.join(known) or 'none'}")


def stage_params(task: str, path: str | Path = PARAMS_FILE) -> SimpleNamespace:
    """Return a task's parameters from ``params.yaml``, and the ``keys`` of its objects."""
    values = read(path)
    params = task_params(task, values, path)
    params.keys = tuple(
        values["benchmarks"]["grasp_data"] if task == "grasp_stability" else values["objects"]
    )
    return params


def robot_stage_params(stage: str, path: str | Path = PARAMS_FILE) -> SimpleNamespace:
    """Return a robot stage's parameters from ``params.yaml``."""
    return robot_params(stage, read(path), path)


def _section(name: str, values: dict[str, Any], path: str | Path) -> BaseModel:
    if name not in values:
        raise ObjectFolderError(f"{path} lacks section {name!r}; run `objectfolder preset quick`")
    return validate(SECTIONS[name], values[name], f"{path}: {name}")
