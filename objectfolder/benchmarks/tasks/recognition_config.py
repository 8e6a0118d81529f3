"""Section ``recognize`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count


@dataclass(frozen=True, kw_only=True)
class RecognizeConfig(TrainingConfig):
    """Section ``recognize`` of ``params.yaml``."""

    seeds: Count  #: runs whose mean is the result
    fusion_epochs: Count  #: of several modalities together, after each was trained alone
    schedule: Literal["cosine", "one_cycle"]  #: `objectfolder.benchmarks.models.training.train`
    label_smoothing: Annotated[float, Interval(ge=0, lt=1)]
