"""Settings of predicting the stability of grasps: section ``grasp_stability`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, MinLen

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count


@dataclass(frozen=True, kw_only=True)
class GraspStabilityConfig(TrainingConfig):
    """Section ``grasp_stability`` of ``params.yaml``."""

    seeds: Count  #: runs whose mean is the result
    #: Training set sizes in grasps, ascending; sizes beyond the available grasps are replaced by all of them.
    sizes: Annotated[tuple[Annotated[int, Ge(2)], ...], MinLen(1)]
    epoch_grasps: Count  #: smaller training sets are repeated within an epoch until it has so many grasps
    fusion_epochs: Count  #: of vision and touch together, after each was trained alone
    hidden: Count  #: units between both fully connected layers, for each of vision and touch
    touch: tuple[int, int]  #: height and width that touches are averaged to, instead of those of ``encode``

    def __post_init__(self) -> None:
        """Check the order of the sizes."""
        if list(self.sizes) != sorted(set(self.sizes)):
            raise ValueError(f"sizes: expected ascending numbers, none twice, got {list(self.sizes)}")
