"""Settings of sound in the air: section ``radiation`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge

from objectfolder.base.settings import section


@section("radiation")
@dataclass(frozen=True, kw_only=True)
class RadiationConfig:
    """Section ``radiation`` of ``params.yaml``."""

    triangles: Annotated[int, Ge(100)] = 4000  #: at most, of the surface on which the sound is solved
    kilobytes: Annotated[int, Ge(1)] = 56  #: that the Object File may grow by
