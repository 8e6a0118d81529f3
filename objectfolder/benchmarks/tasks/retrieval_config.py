"""Section ``retrieve`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class RetrieveConfig(TrainingConfig):
    """Section ``retrieve`` of ``params.yaml``."""

    epochs: Count = 5
    learning_rate: Positive = 0.001
    weight_decay: NonNegative = 0.01
    patience: Count = 5
    seeds: Count = 3  #: runs whose mean is the result
    batch: Annotated[int, Ge(3)] = 32  #: pairs; each batch needs negatives
    margin: Positive = 0.5  #: of the triplet losses, cosine distance
    embedding: Count = 128  #: size of the compared embeddings
    #: in which each encoder learns to name the training objects first
    pretrain_epochs: Annotated[int, Ge(0)] = 0
    schedule: Literal["cosine", "one_cycle"] = "cosine"  #: `objectfolder.benchmarks.models.training.train`
