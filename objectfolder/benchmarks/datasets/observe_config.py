"""Section ``observe`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, MultipleOf


@dataclass(frozen=True, kw_only=True)
class ObserveConfig:
    """Section ``observe`` of ``params.yaml``."""

    observations: Annotated[int, Ge(10), MultipleOf(10)] = 80  #: per modality
    resolution: Annotated[int, Ge(8)] = 64  #: side of the views, pixels
