"""Settings of every training of a benchmark."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge

from objectfolder.settings import Count, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings that the sections of all trained tasks share."""

    epochs: Count  #: at most
    batch: Annotated[int, Ge(2)]
    learning_rate: Positive
    weight_decay: NonNegative
    patience: Count  #: epochs without a better validation score after which training stops
