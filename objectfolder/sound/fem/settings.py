"""Settings of the solid and its modes: sections ``voxelize`` and ``modal`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Interval, MinLen

from objectfolder.base.settings import Count, Even, Positive, section
from objectfolder.mesh.settings import FINEST

#: Kinds of finite elements.
Element = Literal["cut_cell_hex20", "hex8", "hex8_incompatible", "tet10"]


@section("voxelize")
@dataclass(frozen=True, kw_only=True)
class VoxelizeConfig:
    """Section ``voxelize`` of ``params.yaml``."""

    element: Element = "cut_cell_hex20"  #: finite element of the solid (docs/modal.md)
    #: cells along the longest side, finest first
    resolutions: Annotated[tuple[Count, ...], MinLen(1)] = (32, 24, 16, 12)
    subdivisions: Annotated[int, Ge(4)] = 8  #: sub-cells along each side of a cell; fewer lose walls
    max_degrees_of_freedom: Count = 120_000  #: the first resolution within this size is used, else the last
    #: Samples of the distance grid along each axis, or more where walls are thin (`fit_grid`)
    sdf_resolution: Annotated[int, Interval(ge=16, le=FINEST)] = 192

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
    resolutions: Annotated[tuple[Even, ...], MinLen(1)] = (40, 48, 56, 64, 80, 96, 112, 128, 160, 192)
    subdivisions: Annotated[int, Ge(4)] = 6  #: sub-cells along each side of a cell
    max_degrees_of_freedom: Count = 200_000  #: grids beyond this size are not used
    max_error: Positive = 0.02  #: accepted estimated relative error of the lowest frequencies


@section("modal")
@dataclass(frozen=True, kw_only=True)
class ModalConfig:
    """Section ``modal`` of ``params.yaml``."""

    fine: FineGrids = FineGrids()  #: used where the error of the first grid is large
    max_frequency: Annotated[float, Gt(20)] = 20000.0  #: Hz
    max_modes: Count = 256
    surface_points: Annotated[int, Ge(0)] = 8000  #: random points, besides the surface's vertices
    damping: Literal["rayleigh", "loss_factor"] = "loss_factor"  #: law of objects whose entry gives none
    allow_uncertain: bool = False  #: whether sounds whose estimated error exceeds `MAX_ERROR` get no mark
