"""Section ``recognize`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Interval

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class RecognizeConfig(TrainingConfig):
    """Section ``recognize`` of ``params.yaml``."""

    epochs: Count = 5
    batch: Annotated[int, Ge(2)] = 32
    learning_rate: Positive = 0.001
    weight_decay: NonNegative = 0.01
    patience: Count = 2
    seeds: Count = 3  #: runs whose mean is the result
    fusion_epochs: Count = 1  #: of several modalities together, after each was trained alone
    schedule: Literal["cosine", "one_cycle"] = "cosine"  #: `objectfolder.benchmarks.models.training.train`
    label_smoothing: Annotated[float, Interval(ge=0, lt=1)] = 0.0
