"""Settings of meshes: section ``normalize`` of ``params.yaml``, and a limit of the distance grid."""

from dataclasses import dataclass

from objectfolder.base.settings import Count, section


@section("normalize")
@dataclass(frozen=True, kw_only=True)
class NormalizeConfig:
    """Section ``normalize`` of ``params.yaml``."""

    texture_size: Count = 1024  #: longest side of the kept texture, pixels


FINEST = 384  #: samples along each axis; finer grids make files and queries of megabytes and seconds
