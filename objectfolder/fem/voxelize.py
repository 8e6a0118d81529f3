"""Voxelization: finite elements of the solid for sound, distance grid of the surface for the rest."""

from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Interval, MinLen

from objectfolder.fem.elasticity import Solid
from objectfolder.fem.elements import Element, discretize
from objectfolder.mesh.featurecodec import Features
from objectfolder.mesh.scanline import check_winding
from objectfolder.mesh.sdf import FINEST, fitting_grid
from objectfolder.mesh.topology import Mesh, signed_volume
from objectfolder.settings import Count


@dataclass(frozen=True, kw_only=True)
class VoxelizeConfig:
    """Section ``voxelize`` of ``params.yaml``."""

    element: Element  #: finite element of the solid (docs/modal.md)
    resolutions: Annotated[tuple[Count, ...], MinLen(1)]  #: cells along the longest side, finest first
    subdivisions: Annotated[int, Ge(4)]  #: sub-cells along each side of a cell; fewer lose walls
    max_degrees_of_freedom: Count  #: the first resolution within this size is used, else the last
    #: Samples of the distance grid along each axis, or more where walls are thin (`fitting_grid`)
    sdf_resolution: Annotated[int, Interval(ge=16, le=FINEST)]

    def __post_init__(self) -> None:
        """Refuse grids on half of which no error can be estimated."""
        odd = [resolution for resolution in self.resolutions if resolution % 2]
        if odd and self.element == "cut_cell_hex20":
            raise ValueError(
                f"resolutions: {odd[0]} is odd, expected even numbers: the errors of cut cells are "
                "estimated on half of them"
            )


@dataclass(frozen=True)
class Voxelization:
    """Elements and distance grid of one object, unit frame."""

    cells: Solid
    values: np.ndarray  #: (R, R, R) int8; see `objectfolder.mesh.grid.DistanceGrid`
    band: float
    features: Features
    report: dict[str, Any]  #: content of ``voxelize.json``


def voxelize(surface: Mesh, solid: Mesh, config: VoxelizeConfig, name: str = "mesh") -> Voxelization:
    """Certify solid and surface, divide the solid into elements, and sample the distance to the surface.

    Parameters
    ----------
    surface, solid : (V, 3) and (F, 3) arrays each, unit frame
        Surface to see and touch, and solid that vibrates; they differ where gaps are bridged for sound only.
    config : VoxelizeConfig
    name : str
        Name of the object in errors.

    Raises
    ------
    ObjectFolderError
        If a surface is open, crosses itself, or is too thin for its grid.
    """
    certificates = [check_winding(*mesh, name) for mesh in (solid, surface)]
    cells = discretize(
        *solid,
        config.element,
        config.resolutions,
        config.subdivisions,
        config.max_degrees_of_freedom,
        name,
    )
    grid = fitting_grid(*surface, config.sdf_resolution, name)
    report = {
        "cells": {
            "winding": asdict(certificates[0]),
            "volume": signed_volume(*solid),  # unit frame
            "volume_error": cells.volume_error,  # before the correction of mass and stiffness
            "dropped_volume_share": cells.dropped_volume,
            "element": cells.name,
            "resolution": cells.resolution,
            "cells": cells.elements,
            "degrees_of_freedom": cells.degrees_of_freedom,
        },
        "distance_grid": {
            "winding": asdict(certificates[1]),
            "volume": signed_volume(*surface),
            "volume_share_kept": grid.kept,
            "wall_thickness": grid.wall,  # unit frame, as the band
            "resolution": len(grid.values),
            "band": grid.band,
            "samples_in_band": int(np.count_nonzero(np.abs(grid.values) < 127)),
            "moved_crossings": len(grid.features.edges),
            "sharp_cells": len(grid.features.cells),
            "thin_wall_samples": len(grid.features.sheets),
        },
    }
    return Voxelization(cells, grid.values, grid.band, grid.features, report)
