"""Settings of predicting the stability of grasps: section ``grasp_stability`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, MinLen

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class GraspStabilityConfig(TrainingConfig):
    """Section ``grasp_stability`` of ``params.yaml``."""

    epochs: Count = 6
    batch: Annotated[int, Ge(2)] = 32
    learning_rate: Positive = 0.001
    weight_decay: NonNegative = 0.01
    patience: Count = 6
    seeds: Count = 1  #: runs whose mean is the result
    #: Training set sizes in grasps, ascending; sizes beyond the available grasps are replaced by all of them.
    sizes: Annotated[tuple[Annotated[int, Ge(2)], ...], MinLen(1)] = (100, 10_000)
    #: smaller training sets are repeated within an epoch until it has so many grasps
    epoch_grasps: Count = 400
    fusion_epochs: Count = 1  #: of vision and touch together, after each was trained alone
    hidden: Count = 128  #: units between both fully connected layers, for each of vision and touch
    #: height and width that touches are averaged to, instead of those of ``encode``
    touch: tuple[int, int] = (32, 24)

    def __post_init__(self) -> None:
        """Check the order of the sizes."""
        if list(self.sizes) != sorted(set(self.sizes)):
            raise ValueError(f"sizes: expected ascending numbers, none twice, got {list(self.sizes)}")
