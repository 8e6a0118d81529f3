"""Choice of the cut-cell grid: limited by model size, refined for thin walls and inaccurate modes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge

from objectfolder.fem.accuracy import discretisation_error, lowest_frequencies
from objectfolder.fem.blocks import merge_full_blocks
from objectfolder.fem.cutcell import MAX_VOLUME_ERROR, CutCells, cut_cells
from objectfolder.fem.elasticity import Solid
from objectfolder.fem.occupancy import MARGIN
from objectfolder.materials import Material
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.topology import Mesh, signed_volume
from objectfolder.settings import Count, Positive

MIN_WALL = 0.3  #: cells; solids with thinner walls get the fine grid
_SAMPLES = 100_000  # surface points, to find the cells that the surface touches
_UNKNOWNS = 12  # lower bound per element: one corner and three edge nodes of its own
_GROWTH = 1.8  # unknowns grow at least with this power of the resolution (thin sheets with free edges)


@dataclass(frozen=True, kw_only=True)
class FineGrid:
    """Finer grid for solids whose first grid is too coarse."""

    resolution: Count  #: cells along the longest side
    subdivisions: Annotated[int, Ge(4)]  #: sub-cells along each side of a cell
    max_degrees_of_freedom: Count  #: the fine grid is not used beyond this size
    max_error: Positive  #: accepted estimated relative error of the lowest frequencies on the first grid


def adaptive_cut_cells(
    vertices: np.ndarray,
    faces: np.ndarray,
    resolutions: Sequence[int],
    subdivisions: int,
    max_degrees_of_freedom: int,
    name: str = "mesh",
) -> CutCells:
    """Cut a surface at the finest listed resolution whose model stays within a size limit.

    Blocky solids fill the grid and get a coarser one. The coarsest resolution has no size limit.

    Parameters
    ----------
    vertices : (V, 3) array, unit frame
    faces : (F, 3) int array
    resolutions : list of int
        Finest first.
    subdivisions : int
        Sub-cells along each side of a cell, at least 4.
    max_degrees_of_freedom : int
    name : str
        Name of the object in errors.
    """
    least = _least_unknowns(vertices, faces)
    for resolution in resolutions:
        if resolution != resolutions[-1] and least(resolution) > max_degrees_of_freedom:
            continue
        cells = merge_full_blocks(cut_cells(vertices, faces, resolution, subdivisions, name))
        if cells.degrees_of_freedom <= max_degrees_of_freedom:
            break
    return cells


def refined(
    solid: Solid,
    surface: Mesh,
    wall: float,
    fine: FineGrid,
    material: Material,
    scale: float,
    name: str = "object",
) -> Solid:
    """Cut a solid on the finer grid if it needs one and the size limit allows it.

    It needs one if its walls are thinner than `MIN_WALL` cells or the estimated error of its lowest
    frequencies exceeds ``fine.max_error``.

    Parameters
    ----------
    solid : Solid
        Elements other than cut cells are returned unchanged.
    surface : (V, 3) and (F, 3) arrays, unit frame
        Surface of the solid.
    wall : float
        Wall thickness, unit frame.
    fine : FineGrid
    material : Material
    scale : float
        Longest side, metres.
    name : str
        Name of the object in errors.
    """
    growth = (fine.resolution / solid.resolution) ** _GROWTH
    if (
        not isinstance(solid, CutCells)
        or growth <= 1
        or growth * solid.degrees_of_freedom > fine.max_degrees_of_freedom
        or _least_unknowns(*surface)(fine.resolution) > fine.max_degrees_of_freedom
    ):
        return solid
    if wall * solid.resolution >= MIN_WALL:
        error = discretisation_error(solid, material, scale, lowest_frequencies(solid, material, scale))
        if error is None or np.abs(error).max() <= fine.max_error:
            return solid
    finer = merge_full_blocks(cut_cells(*surface, fine.resolution, fine.subdivisions, name))
    return finer if finer.degrees_of_freedom <= fine.max_degrees_of_freedom else solid


def _least_unknowns(vertices: np.ndarray, faces: np.ndarray) -> Callable[[int], int]:
    """Return a lower bound of the unknowns as a function of the resolution, without cutting."""
    volume = (1 - MAX_VOLUME_ERROR) * signed_volume(vertices, faces)
    points = sample_surface(vertices, faces, _SAMPLES, np.random.default_rng(0))

    def least(resolution: int) -> int:
        touched = np.unique(np.floor((points + 0.5) * resolution).astype(np.int64), axis=0)
        full = volume * (resolution / 2) ** 3 * (1 - 3 * MARGIN)  # eight full cells are one element
        return int(_UNKNOWNS * max(full, len(touched)))

    return least
