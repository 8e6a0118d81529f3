"""Choice of the mesh: cut cells, refined until the lowest modes are accurate, or else tetrahedra."""

from collections.abc import Callable, Sequence
from functools import cache
from math import ceil

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.mesh.normals import area_vectors
from objectfolder.mesh.raycast import wall_thickness
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.topology import Mesh, signed_volume
from objectfolder.sound.fem.accuracy import ORDER, Discretisation
from objectfolder.sound.fem.blocks import merge_full_blocks
from objectfolder.sound.fem.cutcell import MAX_VOLUME_ERROR, CutCells, cut_cells
from objectfolder.sound.fem.elasticity import Solid
from objectfolder.sound.fem.local import refine_locally
from objectfolder.sound.fem.occupancy import MARGIN
from objectfolder.sound.fem.settings import FineGrids
from objectfolder.sound.fem.tetrahedra import simplified, tetrahedra

_SAMPLES, _MORE_SAMPLES = 100_000, 400_000  # surface points, to find the cells that the surface touches
_UNKNOWNS = 12  # lower bound per element: one corner and three edge nodes of its own
_GROWTH = 1.8  # unknowns grow at least with this power of the resolution (thin sheets with free edges)
# Where uniform grids within the limit are coarser than wanted by this factor, sizes are mixed
_MAX_COARSENESS = 1.5
_MIN_BULK_SHARE = 2 / 3  # share of the volume in full elements; thin shells need all their cells alike
_MIXED_RESOLUTIONS = 192, 160, 128, 96  # cells along the longest side where sizes are mixed
_SUBDIVISIONS = 4  # of its cells: eight columns through each suffice, and cutting costs less than half
_MAX_CUT_CELLS = 60_000  # at the surface, and eight times as many inside, that may be cut for it
_EXTRA_SIZE, _EXTRA_ERROR = 1 / 5, 1 / 3  # grids of this share of the limit refine to that share of the error
_UNSURE = 2.5  # estimated error of cut cells, over the accepted one, above which tetrahedra are tried
# Of the coarse tetrahedra. Longest edge: share of the longest side, thicknesses of walls. Distance from the
# surface: share of the diagonal, of the walls; it falls with the square of the edge.
_EDGE, _SLENDERNESS, _ENVELOPE, _OFFSET = 1 / 6, 6.0, 3e-3, 0.2
_LEAST = 6 / (3**0.5 / 4)  # unknowns per area of the surface, over the edge squared: equilateral triangles
_OF_TRIANGLE = 6  # unknowns per triangle of the surface: of half a corner and three halves of an edge
_TETRAHEDRAL = 1.5  # their unknowns, over the limit for cut cells, whose matrices are denser
_FINENESS = 2.8  # power of the edge with which the unknowns grow
_FINER, _FINEST = 0.75, 0.45  # edges of the fine mesh, over the coarse ones'; the error follows from both


def adaptive_cut_cells(
    vertices: np.ndarray,
    faces: np.ndarray,
    resolutions: Sequence[int],
    subdivisions: int,
    max_degrees_of_freedom: int,
    name: str = "mesh",
) -> CutCells:
    """Cut a surface at the finest listed resolution whose model stays within a size limit.

    Blocky solids fill the grid and get a coarser one. Resolutions are listed finest first; the coarsest has
    no size limit. Other parameters are those of `cut_cells`.
    """
    least = _least_unknowns(vertices, faces)
    for resolution in resolutions:
        if resolution != resolutions[-1] and least(resolution) > max_degrees_of_freedom:
            continue
        cells = merge_full_blocks(cut_cells(vertices, faces, resolution, subdivisions, name))
        if cells.degrees_of_freedom <= max_degrees_of_freedom:
            break
    return cells


def refine_grid(
    solid: Solid, surface: Mesh, fine: FineGrids, material: Material, scale: float, name: str = "object"
) -> Discretisation:
    """Cut a solid on finer grids until the estimated error of its lowest frequencies is accepted.

    Each step goes to the coarsest grid that should suffice if the error falls with the power ``ORDER`` of the
    cells' size, or to the finest one within the size limit. Where that is much too coarse and most of the
    solid is bulk, cells get several sizes (`objectfolder.sound.fem.local`). An estimate may be a
    third of the error; so where it is accepted, grids go on to a third of it while they stay small. Elements
    other than cut cells are returned unchanged. The surface is in the unit frame, the longest side,
    ``scale``, in metres.
    """
    candidate = Discretisation(solid, material, scale)
    if not isinstance(solid, CutCells):
        return candidate
    least = _least_unknowns(*surface)

    def possible(resolution: int, grid: CutCells, limit: float) -> bool:
        growth = (resolution / grid.resolution) ** _GROWTH
        return growth > 1 and max(growth * grid.degrees_of_freedom, least(resolution)) <= limit

    resolutions, wanted, limit = sorted(fine.resolutions), None, float(fine.max_degrees_of_freedom)
    while resolutions := [step for step in resolutions if possible(step, solid, limit)]:
        if wanted is None:
            error = candidate.errors(candidate.lowest_frequencies())
            if error is None:  # half of the grid falls apart
                wanted = float(resolutions[0])
                continue
            worst, accepted = max(error), fine.max_error
            if worst <= accepted:
                accepted, limit = _EXTRA_ERROR * accepted, _EXTRA_SIZE * fine.max_degrees_of_freedom
            if worst <= accepted:
                break
            wanted = solid.resolution * (worst / accepted) ** (1 / ORDER)
            beyond = worst > fine.max_error and wanted > _MAX_COARSENESS * resolutions[-1]
            if beyond and _bulk(solid) > _MIN_BULK_SHARE:
                mixed = _mixed(surface, fine, material, scale, name)
                if mixed is not None:
                    return mixed
            continue  # fewer resolutions may be left
        chosen = next((step for step in resolutions if step >= wanted), resolutions[-1])
        finer = merge_full_blocks(cut_cells(*surface, chosen, fine.subdivisions, name))
        if finer.degrees_of_freedom <= fine.max_degrees_of_freedom:
            solid, candidate, wanted = finer, Discretisation(finer, material, scale), None
        else:
            resolutions = [step for step in resolutions if step < chosen]
    return candidate


def fill_unsure(
    candidate: Discretisation, surface: Mesh, fine: FineGrids, name: str = "object"
) -> Discretisation:
    """Return a solid in tetrahedra where cut cells stay unsure and the tetrahedra are surer.

    A mesh that follows the surface is fine where joints are slender and panels thinner than a cell. Its error
    is estimated from a coarser one. The surface is in the unit frame.
    """
    if not isinstance(candidate.solid, CutCells):
        return candidate
    errors = candidate.errors(candidate.lowest_frequencies())
    if errors is not None and max(errors) <= _UNSURE * fine.max_error:
        return candidate
    wall, diagonal = wall_thickness(*surface), float(np.linalg.norm(np.ptp(surface[0], axis=0)))
    edge, envelope = min(_EDGE, _SLENDERNESS * wall), min(_ENVELOPE, _OFFSET * wall / diagonal)
    area = 0.5 * float(np.linalg.norm(area_vectors(*surface), axis=1).sum())
    limit = _TETRAHEDRAL * fine.max_degrees_of_freedom
    most = limit * _FINER**_FINENESS  # of the coarse mesh
    if _LEAST * area / edge**2 > most:
        return candidate
    kept = simplified(*surface, envelope * diagonal)[1]  # about as many as tetrahedra would leave
    if _OF_TRIANGLE * len(kept) > most:
        return candidate
    try:
        coarse = tetrahedra(*surface, ceil(1 / edge), name, envelope)
        if coarse.degrees_of_freedom > most:
            return candidate
        finer = max((coarse.degrees_of_freedom / limit) ** (1 / _FINENESS), _FINEST)
        filled = tetrahedra(*surface, ceil(1 / (finer * edge)), name, finer**2 * envelope)
    except ObjectFolderError:  # it falls apart
        return candidate
    found = Discretisation(filled, candidate.material, candidate.scale, coarse)
    estimates = found.errors(found.lowest_frequencies())
    return found if estimates and (errors is None or max(estimates) < max(errors)) else candidate


def _mixed(
    surface: Mesh, fine: FineGrids, material: Material, scale: float, name: str
) -> Discretisation | None:
    """Cut a solid in cells of several sizes, the smallest as small as `_MAX_CUT_CELLS` allows."""
    touched, volume = _touched(*surface, _MORE_SAMPLES), signed_volume(*surface)
    fits = (step for step in _MIXED_RESOLUTIONS if touched(step) + volume * step**3 / 8 <= _MAX_CUT_CELLS)
    finest = next(fits, _MIXED_RESOLUTIONS[-1])
    cells = cut_cells(*surface, finest, _SUBDIVISIONS, name)
    return refine_locally(cells, fine.max_degrees_of_freedom, material, scale)


def _bulk(cells: CutCells) -> float:
    """Return the share of the volume in full elements."""
    volume = cells.fill * cells.width**3
    return float(volume[cells.is_full].sum() / volume.sum())


def _least_unknowns(vertices: np.ndarray, faces: np.ndarray) -> Callable[[int], int]:
    """Return a lower bound of the unknowns as a function of the resolution, without cutting."""
    volume = (1 - MAX_VOLUME_ERROR) * signed_volume(vertices, faces)
    touched = _touched(vertices, faces, _SAMPLES)

    def least(resolution: int) -> int:
        full = volume * (resolution / 2) ** 3 * (1 - 3 * MARGIN)  # eight full cells are one element
        return int(_UNKNOWNS * max(full, touched(resolution)))

    return least


def _touched(vertices: np.ndarray, faces: np.ndarray, samples: int) -> Callable[[int], int]:
    """Return a lower bound of the cells that a surface touches as a function of the resolution."""
    points = sample_surface(vertices, faces, samples, np.random.default_rng(0))

    @cache
    def touched(resolution: int) -> int:
        cell = np.floor((points + 0.5) * resolution).astype(np.int64) + 1  # the cube's rim may be rounded
        return len(np.unique(cell @ np.array([1, resolution + 3, (resolution + 3) ** 2])))

    return touched
