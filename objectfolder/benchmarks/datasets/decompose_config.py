"""Section ``decompose`` of ``params.yaml``."""

from dataclasses import dataclass

from objectfolder.settings import Count


@dataclass(frozen=True, kw_only=True)
class DecomposeConfig:
    """Section ``decompose`` of ``params.yaml``."""

    hulls: Count = 8  #: greatest number of hulls of an object
