"""From a closed surface to what the modalities share: elements for the FEM, a distance grid for the rest."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from objectfolder.fem.elasticity import Solid
from objectfolder.fem.elements import Element, discretize
from objectfolder.mesh.closing.topology import Mesh, signed_volume
from objectfolder.mesh.scanline import check_winding
from objectfolder.mesh.sdf import check_resolved, distance_grid


@dataclass(frozen=True)
class Voxels:
    """Both grids of one object, unit frame."""

    cells: Solid
    values: np.ndarray  #: (R, R, R) int8; see `objectfolder.mesh.grid.DistanceGrid`
    band: float
    report: dict[str, Any]  #: what ``voxelize.json`` holds


def voxelize(
    surface: Mesh,
    solid: Mesh,
    resolutions: list[int],
    subdivisions: int,
    max_degrees_of_freedom: int,
    sdf_resolution: int,
    element: Element = "cut_cell_hex20",
    name: str = "mesh",
) -> Voxels:
    """Divide a solid into elements and sample the distance to a surface; both are certified first.

    Parameters
    ----------
    surface, solid : (V, 3) and (F, 3) arrays each, unit frame
        What is seen and touched, and what vibrates; they differ where gaps are bridged for the sound alone.
    resolutions : list of int
        Cells along the longest side, finest first.
    subdivisions : int
        Sub-cells along each side of a cell.
    max_degrees_of_freedom : int
        The first resolution under this size is taken, or the last.
    sdf_resolution : int
        Samples of the distance grid along each axis.
    element : str
        What the solid is divided into; see `objectfolder.fem.elements`.
    name : str
        Named in errors.

    Raises
    ------
    ObjectFolderError
        If a surface is open, crosses itself, or is too thin for its grid.
    """
    certificates = [check_winding(*mesh, name) for mesh in (solid, surface)]
    cells = discretize(*solid, element, resolutions, subdivisions, max_degrees_of_freedom, name)
    values, band = distance_grid(*surface, sdf_resolution)
    kept = check_resolved(values, *surface, name)
    report = {
        "cells": {
            "winding": asdict(certificates[0]),
            "volume": signed_volume(*solid),  # unit frame
            "volume_error": cells.volume_error,  # before mass and stiffness are corrected for it
            "dropped_volume_share": cells.dropped_volume,
            "element": cells.name,
            "resolution": cells.resolution,
            "cells": cells.elements,
            "degrees_of_freedom": cells.degrees_of_freedom,
        },
        "distance_grid": {
            "winding": asdict(certificates[1]),
            "volume": signed_volume(*surface),
            "volume_share_kept": kept,
            "resolution": sdf_resolution,
            "band": band,
            "samples_in_band": int(np.count_nonzero(np.abs(values) < 127)),
        },
    }
    return Voxels(cells, values, band, report)
