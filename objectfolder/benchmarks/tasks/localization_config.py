"""Section ``localize`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class LocalizeConfig(TrainingConfig):
    """Section ``localize`` of ``params.yaml``."""

    epochs: Count = 30
    batch: Annotated[int, Ge(2)] = 32
    learning_rate: Positive = 0.003
    weight_decay: NonNegative = 0.05
    patience: Count = 30
    seeds: Count = 1  #: runs whose mean is the result
    contacts: Count = 500  #: with each object: 80 % to train with, 10 % for validation, 10 % for the test
