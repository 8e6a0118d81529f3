"""From a closed surface to what the modalities share: cut cells for the FEM, a distance grid for the rest."""

from dataclasses import asdict, dataclass

import numpy as np

from objectfolder.fem.cutcell import CutCells, node_count
from objectfolder.fem.modal import adaptive_cut_cells
from objectfolder.mesh.scanline import check_winding
from objectfolder.mesh.sdf import check_resolved, distance_grid
from objectfolder.mesh.topology import Mesh, signed_volume


@dataclass(frozen=True)
class Voxels:
    """Both grids of one object, unit frame."""

    cells: CutCells
    values: np.ndarray  #: (R, R, R) int8; see `objectfolder.mesh.grid.DistanceGrid`
    band: float
    report: dict  #: what ``voxelize.json`` holds


def voxelize(
    surface: Mesh,
    solid: Mesh,
    resolutions: list[int],
    subdivisions: int,
    max_degrees_of_freedom: int,
    sdf_resolution: int,
    name: str = "mesh",
) -> Voxels:
    """Cut a solid into cells and sample the distance to a surface, after certifying that both bound solids.

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
    name : str
        Named in errors.

    Raises
    ------
    ObjectFolderError
        If a surface is open, crosses itself, or is too thin for its grid.
    """
    certificates = [check_winding(*mesh, name) for mesh in (solid, surface)]
    cells = adaptive_cut_cells(*solid, resolutions, subdivisions, max_degrees_of_freedom)
    values, band = distance_grid(*surface, sdf_resolution)
    kept = check_resolved(values, *surface, name)
    report = {
        "cells": {
            "winding": asdict(certificates[0]),
            "volume": signed_volume(*solid),  # unit frame
            "volume_error": cells.volume_error,  # before mass and stiffness are corrected for it
            "dropped_volume_share": cells.dropped_volume,
            "resolution": cells.resolution,
            "cells": len(cells.index),
            "degrees_of_freedom": 3 * node_count(cells),
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
