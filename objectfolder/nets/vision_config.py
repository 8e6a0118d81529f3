"""Settings of the vision nets: section ``train_vision`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval

from objectfolder.settings import Count, Octaves, Positive, Precision, Share


@dataclass(frozen=True, kw_only=True)
class SurfaceConfig:
    """Shape and training of a net of kind ``surface``."""

    levels: Count
    features: Count
    table_bits: Annotated[int, Interval(ge=4, le=24)]
    coarsest: Count
    finest: Count
    width: Count  #: hidden width of the MLPs
    points: Count  #: surface points for training base colour and normals
    point_steps: Count
    point_batch: Count
    pixels: Count  #: pixels for training indirect light, over all training views
    steps: Count
    batch: Count
    learning_rate: Positive


@dataclass(frozen=True, kw_only=True)
class OsfConfig:
    """Shape and training of a net of kind ``osf``."""

    width: Count  #: of the density network
    depth: Count
    branch_width: Count  #: of the scattering network
    branch_depth: Count
    point_octaves: Octaves
    direction_octaves: Octaves
    coarse_samples: Count  #: per ray, stratified
    fine_samples: Count  #: per ray, drawn from the weights of the coarse samples
    hull_cells: Annotated[int, Interval(ge=0, le=256)]
    """Along each axis of the cube. Nothing is computed in cells that the views to learn from show to be
    empty; 0: everything is computed, as in the paper."""
    steps: Count
    batch: Count  #: rays
    learning_rate: Positive
    final_rate: Share  #: of the learning rate, at the end of a cosine; 1: constant, as the paper's
    precision: Precision  #: of the hidden layers in training


@dataclass(frozen=True, kw_only=True)
class VisionConfig(SurfaceConfig):
    """Kind of the vision net, with settings for both kinds."""

    net: Literal["surface", "osf"]
    osf: OsfConfig
