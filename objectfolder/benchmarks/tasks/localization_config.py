"""Section ``localize`` of ``params.yaml``."""

from dataclasses import dataclass

from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.settings import Count


@dataclass(frozen=True, kw_only=True)
class LocalizeConfig(TrainingConfig):
    """Section ``localize`` of ``params.yaml``."""

    seeds: Count  #: runs whose mean is the result
    contacts: Count  #: with each object: 80 % to train with, 10 % for validation, 10 % for the test
