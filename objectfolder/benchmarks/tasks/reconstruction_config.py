"""Section ``reconstruct`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class ReconstructConfig(TrainingConfig):
    """Section ``reconstruct`` of ``params.yaml``."""

    seeds: Count  #: trainings of each variant
    #: In which each encoder learns to name the training objects and then stays as it is; 0: all is learned
    #: together.
    pretrain_epochs: Annotated[int, Ge(0)]
    pretrain_rate: Positive  #: peak learning rate of these epochs
    #: Weight of the loss for naming the object from its features while all is learned together; the paper's
    #: is 0.
    naming: NonNegative
    points: Count  #: per observation and step, whose occupancy is learned
    width: Count  #: of the occupancy network
    blocks: Count
    frequencies: Annotated[int, Interval(ge=0, le=12)]  #: octaves of the encoding; the paper's is 0
    resolution: Annotated[int, Ge(8)]  #: of marching cubes
    score_points: Count  #: for IoU, and on either surface for the distances
    views: Count  #: test observations per object that are meshed
    touches: Count  #: of the object that a shape is reconstructed from, as far as its part has so many
