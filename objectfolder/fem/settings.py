"""Settings of the solid and its modes: sections ``voxelize`` and ``modal`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Interval, MinLen

from objectfolder.mesh.settings import FINEST
from objectfolder.settings import Count, Even, Positive

#: Kinds of finite elements.
Element = Literal["cut_cell_hex20", "hex8", "hex8_incompatible", "tet10"]


@dataclass(frozen=True, kw_only=True)
class VoxelizeConfig:
    """Section ``voxelize`` of ``params.yaml``."""

    element: Element  #: finite element of the solid (docs/modal.md)
    resolutions: Annotated[tuple[Count, ...], MinLen(1)]  #: cells along the longest side, finest first
    subdivisions: Annotated[int, Ge(4)]  #: sub-cells along each side of a cell; fewer lose walls
    max_degrees_of_freedom: Count  #: the first resolution within this size is used, else the last
    #: Samples of the distance grid along each axis, or more where walls are thin (`fit_grid`)
    sdf_resolution: Annotated[int, Interval(ge=16, le=FINEST)]

    def __post_init__(self) -> None:
        """Refuse grids on half of which no error can be estimated."""
        odd = [resolution for resolution in self.resolutions if resolution % 2]
        if odd and self.element == "cut_cell_hex20":
            raise ValueError(
                f"resolutions: {odd[0]} is odd, expected even numbers: the errors of cut cells are "
                "estimated on half of them"
            )


@dataclass(frozen=True, kw_only=True)
class FineGrids:
    """Finer grids for solids whose first grid is too coarse."""

    #: Cells along the longest side, coarsest first; even, since errors are estimated on half of them
    resolutions: Annotated[tuple[Even, ...], MinLen(1)]
    subdivisions: Annotated[int, Ge(4)]  #: sub-cells along each side of a cell
    max_degrees_of_freedom: Count  #: grids beyond this size are not used
    max_error: Positive  #: accepted estimated relative error of the lowest frequencies


@dataclass(frozen=True, kw_only=True)
class ModalConfig:
    """Section ``modal`` of ``params.yaml``."""

    fine: FineGrids  #: used where the error of the first grid is large
    max_frequency: Annotated[float, Gt(20)]  #: Hz
    max_modes: Count
    surface_points: Annotated[int, Ge(0)]  #: random points, besides the surface's vertices
    damping: Literal["rayleigh", "loss_factor"]  #: law of objects whose entry gives none
    allow_uncertain: bool  #: whether to keep modes whose estimated error exceeds `REFUSED`
