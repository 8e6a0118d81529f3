"""Voxelization: finite elements of the solid for sound, distance grid of the surface for the rest."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from objectfolder.mesh.featurecodec import Features
from objectfolder.mesh.scanline import check_winding
from objectfolder.mesh.sdf import fit_grid
from objectfolder.mesh.topology import Mesh, signed_volume
from objectfolder.sound.fem.elasticity import Solid
from objectfolder.sound.fem.elements import discretize
from objectfolder.sound.fem.settings import VoxelizeConfig


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

    Meshes (V, 3) and (F, 3) of the unit frame: the surface to see and touch, and the solid that vibrates;
    they differ where gaps are bridged for sound only. Raises ObjectFolderError if a surface is open, crosses
    itself, or is too thin for its grid.
    """
    certificates = [check_winding(*mesh, name) for mesh in (solid, surface)]
    limits = config.subdivisions, config.max_degrees_of_freedom
    cells = discretize(*solid, config.element, config.resolutions, *limits, name)
    grid = fit_grid(*surface, config.sdf_resolution, name)
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
