"""Section ``reconstruct`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class ReconstructConfig(TrainingConfig):
    """Section ``reconstruct`` of ``params.yaml``."""

    epochs: Count = 6
    batch: Annotated[int, Ge(2)] = 32
    learning_rate: Positive = 0.001
    weight_decay: NonNegative = 0.01
    patience: Count = 5
    seeds: Count = 3  #: trainings of each variant
    #: In which each encoder learns to name the training objects and then stays as it is; 0: all is learned
    #: together.
    pretrain_epochs: Annotated[int, Ge(0)] = 0
    pretrain_rate: Positive = 0.004  #: peak learning rate of these epochs
    #: Weight of the loss for naming the object from its features while all is learned together; the paper's
    #: is 0.
    naming: NonNegative = 1.0
    points: Count = 96  #: per observation and step, whose occupancy is learned
    width: Count = 128  #: of the occupancy network
    blocks: Count = 5
    frequencies: Annotated[int, Interval(ge=0, le=12)] = 6  #: octaves of the encoding; the paper's is 0
    resolution: Annotated[int, Ge(8)] = 64  #: of marching cubes
    score_points: Count = 30_000  #: for IoU, and on either surface for the distances
    views: Count = 2  #: test observations per object that are meshed
    touches: Count = 16  #: of the object that a shape is reconstructed from, as far as its part has so many
