"""Settings of the vision nets: section ``train_vision`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval

from objectfolder.base.settings import Count, Octaves, Positive, section
from objectfolder.nets.settings import PapersNetConfig


@dataclass(frozen=True, kw_only=True)
class SurfaceConfig:
    """Shape and training of a net of kind ``surface``."""

    levels: Count = 8
    features: Count = 2
    table_bits: Annotated[int, Interval(ge=4, le=24)] = 15
    coarsest: Count = 16
    finest: Count = 320
    width: Count = 64  #: hidden width of the MLPs
    points: Count = 400_000  #: surface points for training base colour and normals
    point_steps: Count = 250
    point_batch: Count = 16_384
    pixels: Count = 400_000  #: pixels for training indirect light, over all training views
    steps: Count = 600
    batch: Count = 4096
    learning_rate: Positive = 0.01


@dataclass(frozen=True, kw_only=True)
class OsfConfig(PapersNetConfig):
    """Shape and training of a net of kind ``osf``; width and depth are those of the density network."""

    branch_width: Count = 128  #: of the scattering network
    branch_depth: Count = 4
    direction_octaves: Octaves = 4
    coarse_samples: Count = 64  #: per ray, stratified
    fine_samples: Count = 128  #: per ray, drawn from the weights of the coarse samples
    hull_cells: Annotated[int, Interval(ge=0, le=256)] = 64
    """Along each axis of the cube. Nothing is computed in cells that the views to learn from show to be
    empty; 0: everything is computed, as in the paper."""
    batch: Count = 1024  #: rays


@section("train_vision")
@dataclass(frozen=True, kw_only=True)
class VisionConfig(SurfaceConfig):
    """Kind of the vision net, with settings for both kinds."""

    net: Literal["surface", "osf"] = "surface"
    osf: OsfConfig = OsfConfig()
