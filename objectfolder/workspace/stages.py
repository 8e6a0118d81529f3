"""The stages: a row each, from which follow sections, targets, resources and what `prune` removes.

What a stage reads and writes is in dvc.yaml. No stage imports this module: a new row makes none stale.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.workspace.params import check_slug

HOUR = 3600.0


@dataclass(frozen=True)
class Needs:
    """Resources of a running stage."""

    #: Rough time on one core with preset quick; sets the priority of a stage and the estimate of remaining
    #: time.
    seconds: float = 1.0
    cpus: int = 1  #: number of cores, which is also the thread limit of numerical libraries
    gpus: float = 0.0  #: number of GPUs; a fraction is a share of one GPU
    memory_mb: int = 500  #: peak resident memory, MB
    #: Wall seconds after which the stage is considered hung and killed; None: never.
    timeout: float | None = HOUR


PAPERS_NET = Needs(100000, gpus=1.0, memory_mb=8000, timeout=None)  #: its training, or its answers on a CPU
TRAINING = Needs(1200, gpus=1.0, memory_mb=4000, timeout=None)  #: of a benchmark


@dataclass(frozen=True)
class Stage:
    """What the build system knows of a stage beside dvc.yaml."""

    #: What it runs for: a source of meshes, each object, each object if others need it, objects or splits
    #: that ``benchmarks`` in params.yaml lists.
    of: Literal["first", "object", "on demand", "listed"]
    settings: str = ""  #: ``MODULE:CLASS`` in objectfolder/ of its section of params.yaml
    #: Memory is above the largest peaks in docs/measurements. One core, because outputs must not depend on
    #: the number of threads. Timeouts are an order of magnitude above the longest run.
    needs: Needs = Needs()
    of_renderer: Mapping[str, Needs] = field(default_factory=dict)  #: needs by renderer, if others
    net_in: str = ""  #: section whose net it trains or asks; one of the paper needs `PAPERS_NET`
    task: bool = False  #: whether it is a benchmark task: ``objectfolder/benchmarks/tasks`` declares it
    splits: tuple[str, ...] = ()  #: that are listed; none: objects are
    hulls: bool = False  #: whether its objects must be listed under ``decompose``


_FEM, _DATA = "sound.fem.settings", "benchmarks.datasets.settings"
_TASKS, _POLICIES = "benchmarks.tasks", "benchmarks.models.settings"
_BOTH = ("seen", "unseen")
STAGES = {
    "hash_code": Stage("first"),
    "generate": Stage("first", needs=Needs(2, memory_mb=500)),
    "normalize": Stage("object", "mesh.settings:NormalizeConfig", Needs(1, memory_mb=2000)),
    "voxelize": Stage("object", f"{_FEM}:VoxelizeConfig", Needs(7, memory_mb=2500)),
    "modal": Stage("object", f"{_FEM}:ModalConfig", Needs(45, memory_mb=8000, timeout=3 * HOUR)),
    "radiation": Stage("object", "sound.radiation.settings:RadiationConfig", Needs(25, memory_mb=2200)),
    "render_views": Stage(
        "object",
        "vision.settings:RenderViewsConfig",
        Needs(50, memory_mb=1000, timeout=12 * HOUR),
        {"mitsuba-cuda": Needs(30, gpus=0.5, memory_mb=2000, timeout=3 * HOUR)},
    ),
    "render_touch": Stage(
        "object", "touch.settings:RenderTouchConfig", Needs(3, memory_mb=1000, timeout=3 * HOUR)
    ),
    "train_vision": Stage(
        "object", "vision.net_settings:VisionConfig", Needs(18, memory_mb=2000), net_in="train_vision"
    ),
    "train_audio": Stage(
        "object", "sound.net_settings:AudioConfig", Needs(20, memory_mb=1500), net_in="train_audio"
    ),
    "train_touch": Stage(
        "object", "touch.net_settings:TouchConfig", Needs(5, memory_mb=1500), net_in="train_touch"
    ),
    "pack": Stage("object", needs=Needs(memory_mb=800)),
    "evaluate": Stage(
        "object",
        "objectfile.settings:EvaluateConfig",
        Needs(9, memory_mb=2000, timeout=3 * HOUR),
        net_in="train_vision",
    ),
    "observe": Stage(
        "on demand",
        f"{_DATA}:ObserveConfig",
        Needs(5, memory_mb=1500, timeout=3 * HOUR),
        net_in="train_vision",
    ),
    "close_ups": Stage("on demand", "", Needs(5, memory_mb=1500, timeout=3 * HOUR), net_in="train_vision"),
    "recognize": Stage(
        "listed", f"{_TASKS}.recognize:RecognizeConfig", TRAINING, task=True, splits=("seen",)
    ),
    "retrieve": Stage("listed", f"{_TASKS}.retrieve:RetrieveConfig", TRAINING, task=True, splits=_BOTH),
    "reconstruct": Stage(
        "listed", f"{_TASKS}.reconstruct:ReconstructConfig", TRAINING, task=True, splits=_BOTH
    ),
    "localize": Stage("listed", f"{_TASKS}.localize:LocalizeConfig", TRAINING, task=True),
    "slide": Stage("listed", f"{_TASKS}.slide:SlideConfig", TRAINING, task=True),
    "vision_to_touch": Stage(
        "listed", f"{_TASKS}.vision_to_touch:VisionToTouchConfig", TRAINING, task=True, splits=_BOTH
    ),
    "touch_to_vision": Stage(
        "listed", f"{_TASKS}.touch_to_vision:TouchToVisionConfig", TRAINING, task=True, splits=_BOTH
    ),
    "decompose": Stage("listed", f"{_DATA}:DecomposeConfig", Needs(15, memory_mb=1500), hulls=True),
    "grasp_data": Stage(
        "listed", f"{_DATA}:GraspDataConfig", Needs(60, memory_mb=2000, timeout=None), hulls=True
    ),
    "grasp_stability": Stage(
        "listed",
        f"{_TASKS}.grasp_stability:GraspStabilityConfig",
        Needs(600, gpus=1.0, memory_mb=4000, timeout=None),
        task=True,
        splits=_BOTH,
    ),
    "grasp_policy": Stage(
        "listed",
        f"{_POLICIES}:GraspPolicyConfig",
        Needs(3000, memory_mb=2000, timeout=None),
        task=True,
        hulls=True,
    ),
    "reach": Stage(
        "listed", f"{_POLICIES}:ReachConfig", Needs(300, memory_mb=2000, timeout=None), task=True, hulls=True
    ),
}

#: Dataclass of each section of params.yaml: those of stages, and the encoders that benchmarks share.
SECTIONS = {name: stage.settings for name, stage in STAGES.items() if stage.settings}
SECTIONS["encode"] = f"{_POLICIES}:EncodeConfig"
#: Stages before those of the objects, of single objects, and of those that run only if others need them.
FIRST_STAGES = tuple(name for name, stage in STAGES.items() if stage.of == "first")
OBJECT_STAGES = tuple(name for name, stage in STAGES.items() if stage.of == "object")
ON_DEMAND = tuple(name for name, stage in STAGES.items() if stage.of == "on demand")
#: Benchmark tasks and their splits; none for tasks on single objects.
BENCHMARKS = {name: stage.splits for name, stage in STAGES.items() if stage.task}
#: Stages over all objects, or over those that are grasped, by split; tasks on single objects.
TASKS = tuple(name for name, splits in BENCHMARKS.items() if splits)
OBJECT_TASKS = tuple(name for name, splits in BENCHMARKS.items() if not splits)
#: Stages of robots with the objects that ``benchmarks`` lists.
ROBOT_STAGES = tuple(name for name, stage in STAGES.items() if stage.hulls)


def section_config(name: str) -> type[Any]:
    """Return the dataclass of a section."""
    module, _, qualified = SECTIONS[name].partition(":")
    config: type[Any] = getattr(import_module(f"objectfolder.{module}"), qualified)
    return config


def check_key(key: Any, where: str = "object key") -> str:
    """Return a valid object key: a slug that is not the name of a stage, or raise ObjectFolderError."""
    if key in STAGES:
        raise ObjectFolderError(
            f"{where}: {quoted(key)} is not a valid object key (it is the name of a stage); choose another"
        )
    return check_slug(key, where)
