"""Section ``retrieve`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count, Positive


@dataclass(frozen=True, kw_only=True)
class RetrieveConfig(TrainingConfig):
    """Section ``retrieve`` of ``params.yaml``."""

    seeds: Count  #: runs whose mean is the result
    batch: Annotated[int, Ge(3)]  #: pairs; each batch needs negatives
    margin: Positive  #: of the triplet losses, cosine distance
    embedding: Count  #: size of the compared embeddings
    pretrain_epochs: Annotated[int, Ge(0)]  #: in which each encoder learns to name the training objects first
    schedule: Literal["cosine", "one_cycle"]  #: `objectfolder.benchmarks.models.training.train`
