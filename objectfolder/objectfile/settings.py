"""Settings of the scores: section ``evaluate`` of ``params.yaml``."""

from dataclasses import dataclass

from objectfolder.base.settings import Count, section


@section("evaluate")
@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """Section ``evaluate`` of ``params.yaml``."""

    impacts: Count = 200  #: random impacts whose spectrograms are scored
