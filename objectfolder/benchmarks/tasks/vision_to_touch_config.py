"""Section ``vision_to_touch`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, MultipleOf

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count


@dataclass(frozen=True, kw_only=True)
class VisionToTouchConfig(TrainingConfig):
    """Section ``vision_to_touch`` of ``params.yaml``."""

    seeds: Count  #: runs whose mean is the result
    contacts: Annotated[int, Ge(10), MultipleOf(10)]  #: with each object
    width: Count  #: channels of the net at full size
