"""Section ``vision_to_touch`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, MultipleOf

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class VisionToTouchConfig(TrainingConfig):
    """Section ``vision_to_touch`` of ``params.yaml``."""

    epochs: Count = 8
    batch: Annotated[int, Ge(2)] = 32
    learning_rate: Positive = 0.004
    weight_decay: NonNegative = 0.05
    patience: Count = 8
    seeds: Count = 1  #: runs whose mean is the result
    contacts: Annotated[int, Ge(10), MultipleOf(10)] = 100  #: with each object
    width: Count = 16  #: channels of the net at full size
