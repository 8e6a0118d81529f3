"""Section ``vision_to_touch`` of ``params.yaml``."""

from dataclasses import dataclass

from objectfolder.benchmarks.models.training import TrainingConfig
from objectfolder.settings import Count


@dataclass(frozen=True, kw_only=True)
class VisionToTouchConfig(TrainingConfig):
    """Section ``vision_to_touch`` of ``params.yaml``."""

    seeds: Count  #: runs whose mean is the result
    contacts: Count  #: with each object, a multiple of ten
    width: Count  #: channels of the net at full size
