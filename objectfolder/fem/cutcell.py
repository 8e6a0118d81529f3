"""Cut-cell finite elements: a closed surface immersed in a grid of 20-node hexahedra.

Every grid cell that the solid touches becomes one hexahedron whose stiffness and mass are integrated
over the material inside it (the finite cell method; Parvizian, Duester and Rank 2007). Plain voxels of
the same size are 30 to 70 % wrong on thin walls; cut cells stay within a few per cent.

The integral of a polynomial over the material is linear in the Legendre moments of the occupancy, so
all element matrices are one matrix product, and the moments are all that is kept of the occupancy.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from scipy.ndimage import label
from scipy.spatial import cKDTree

from objectfolder.errors import ObjectFolderError
from objectfolder.fem.hex20 import NODES, shape_functions, shape_gradients
from objectfolder.materials import Material
from objectfolder.mesh.scanline import crossings
from objectfolder.mesh.topology import signed_volume

DEGREE = 5  # Legendre polynomials per axis; products of two shape functions have degree 4
MARGIN = 1e-4  # the grid is this much larger than the object
EMPTY_FILL = 1e-3  # cells with less material are left out
FICTITIOUS = 1e-6  # stiffness and mass of the void in a cut cell, relative to the material
MAX_VOLUME_ERROR = 0.05  # of the cells, before it is corrected
_ORDERS = 300  # of the columns' shifts that are tried
_CHUNK = 1 << 17  # crossings whose moments are held at once


@dataclass(frozen=True)
class CutCells:
    """The solid in the unit frame: grid cells with the occupancy inside them."""

    index: np.ndarray  #: (E, 3) int64, position of each cell in the grid
    occupancy: np.ndarray  #: (E, 5, 5, 5) float32, its Legendre moments in x, y, z over [-1, 1]^3
    resolution: int  #: cells along each axis of the grid
    dropped_volume: float  #: share of the volume in pieces that touch the main one nowhere
    volume_error: float = 0.0  #: of the cells' occupancy, relative to the surface's exact volume

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> "CutCells":
        """Return the cells that ``solid.npz`` holds."""
        return cls(
            arrays["index"],
            arrays["occupancy"].astype(np.float32),
            int(arrays["resolution"]),
            float(arrays["dropped_volume"]),
            float(arrays["volume_error"]),
        )

    @property
    def cell_size(self) -> float:
        """Side of a cell."""
        return (1 + MARGIN) / self.resolution

    @property
    def lower(self) -> np.ndarray:
        """(3,) lower corner of the grid."""
        return np.full(3, -(1 + MARGIN) / 2)

    @property
    def fill(self) -> np.ndarray:
        """(E,) fraction of each cell that is material."""
        return self.occupancy[:, 0, 0, 0].astype(np.float64) / 8

    @property
    def correction(self) -> float:
        """Factor on mass and stiffness that gives the solid the surface's exact volume.

        On both, because the missing material is as stiff as the rest: mass and every static deflection of a
        block become right and no frequency changes. On the mass alone it would shift all frequencies by
        half the error. A wall that is too thin by a share e stays e low in its bending frequencies, so the
        error itself must be small: `cut_cells`.
        """
        return 1 / (1 + self.volume_error)

    @property
    def volume(self) -> float:
        """Volume of the material, corrected."""
        return float(self.fill.sum() * self.cell_size**3 * self.correction)


@dataclass(frozen=True)
class FiniteElements:
    """Assembled matrices in SI units."""

    stiffness: sp.csr_matrix  #: (3N, 3N), N/m
    mass: sp.csr_matrix  #: (3N, 3N), kg
    nodal_mass: sp.csr_matrix  #: (N, N), kg; ``mass`` is its Kronecker product with the identity
    nodes: np.ndarray  #: (N, 3), object frame, metres
    connectivity: np.ndarray  #: (E, 20)


def cut_cells(vertices: np.ndarray, faces: np.ndarray, resolution: int, subdivisions: int) -> CutCells:
    """Cut a closed surface into grid cells.

    Columns along z, whose crossings with the surface are exact, are a quadrature rule across. Fractions of
    sub-cells would smear walls that are one or two sub-cells thick and make them too stiff (20 to 40 % in
    frequency at 1.6 sub-cells).

    Parameters
    ----------
    vertices : (V, 3) array, unit frame
    faces : (F, 3) int array
    resolution : int
        Cells along the longest side.
    subdivisions : int
        Sub-cells along each side of a cell, at least 4; four columns go through each.

    Raises
    ------
    ObjectFolderError
        If no cell holds material, or the cells' volume is wrong by more than `MAX_VOLUME_ERROR`.
    """
    moments = _column_moments(vertices, faces, resolution, subdivisions)
    fill = moments[..., 0, 0, 0] / 8
    pieces, number = label(fill > EMPTY_FILL)
    if number == 0:
        raise ObjectFolderError(
            f"no cell of the {resolution}^3 grid holds {EMPTY_FILL:.1%} material; the object is too thin: "
            "put a finer one in voxelize.resolutions"
        )
    volumes = np.bincount(pieces.ravel(), weights=fill.ravel())[1:]
    cells = CutCells(
        index=np.argwhere(pieces == volumes.argmax() + 1),
        occupancy=moments[pieces == volumes.argmax() + 1].astype(np.float32),
        resolution=resolution,
        dropped_volume=float(1 - volumes.max() / volumes.sum()),
    )
    error = cells.volume / signed_volume(vertices, faces) - 1
    if abs(error) > MAX_VOLUME_ERROR:
        raise ObjectFolderError(
            f"the cells of the {resolution}^3 grid hold {1 + error:.1%} of the surface's volume "
            f"({cells.dropped_volume:.1%} is in other pieces), expected within {MAX_VOLUME_ERROR:.0%}: join "
            "the mesh's parts, or put a finer grid in voxelize.resolutions"
        )
    return replace(cells, volume_error=error)


def node_count(cells: CutCells) -> int:
    """Nodes of the hexahedra, before assembling anything."""
    return len(_number_nodes(cells)[1])


def assemble(cells: CutCells, material: Material, scale: float) -> FiniteElements:
    """Stiffness and mass of the solid.

    Parameters
    ----------
    cells : CutCells
    material : Material
    scale : float
        Longest side, metres.
    """
    size = cells.cell_size * scale
    moments = cells.occupancy.reshape(-1, DEGREE**3).astype(np.float64)
    full = np.eye(1, DEGREE**3) * 8
    moments = (moments + FICTITIOUS * (full - moments)) * (cells.correction * (size / 2) ** 3)
    stiffness_basis, mass_basis = _reference_matrices(material, size)
    connectivity, grid_nodes = _number_nodes(cells)
    dof = (3 * connectivity[:, :, None] + np.arange(3)).reshape(len(connectivity), 60)
    nodal_mass = _scatter(moments @ mass_basis, connectivity, len(grid_nodes))
    return FiniteElements(
        stiffness=_scatter(moments @ stiffness_basis, dof, 3 * len(grid_nodes)),
        mass=sp.kron(nodal_mass, sp.eye_array(3), format="csr"),
        nodal_mass=nodal_mass,
        nodes=(grid_nodes * cells.cell_size + cells.lower) * scale,
        connectivity=connectivity,
    )


def interpolate(
    cells: CutCells, connectivity: np.ndarray, values: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Evaluate a nodal field at points with the elements' own shape functions.

    A point in a cell that holds no element (on its boundary, or in a dropped speck) takes the nearest
    element's polynomial at the nearest place inside that element.

    Parameters
    ----------
    values : (N, C) array
        C columns of a nodal field.
    points : (P, 3) array, unit frame

    Returns
    -------
    (P, C) array
    """
    position = (np.asarray(points, np.float64) - cells.lower) / cells.cell_size
    element = cKDTree(cells.index + 0.5).query(position)[1]
    lookup = np.full((cells.resolution,) * 3, -1)
    lookup[tuple(cells.index.T)] = np.arange(len(cells.index))
    own = lookup[tuple(np.floor(position).astype(np.int64).clip(0, cells.resolution - 1).T)]
    element = np.where(own >= 0, own, element)
    local = np.clip(2 * (position - cells.index[element]) - 1, -1, 1)
    weights = shape_functions(local)
    out = np.empty((len(points), values.shape[1]))
    for start in range(0, len(points), 2048):
        part = slice(start, start + 2048)
        out[part] = np.einsum("pi,pic->pc", weights[part], values[connectivity[element[part]]])
    return out


def _number_nodes(cells: CutCells) -> tuple[np.ndarray, np.ndarray]:
    """Connectivity (E, 20) and node positions in cells (N, 3)."""
    shape = (2 * cells.resolution + 1,) * 3
    lattice = 2 * cells.index[:, None, :] + (NODES + 1).astype(np.int64)
    flat, inverse = np.unique(np.ravel_multi_index(lattice.reshape(-1, 3).T, shape), return_inverse=True)
    return inverse.reshape(-1, 20), np.stack(np.unravel_index(flat, shape), 1) / 2


def _column_moments(
    vertices: np.ndarray, faces: np.ndarray, resolution: int, subdivisions: int
) -> np.ndarray:
    """Legendre moments of the occupancy of every cell of the grid; (R, R, R, 5, 5, 5)."""
    across = 2 * subdivisions  # columns along each side of a cell
    count, side = resolution * across, 1 + MARGIN
    place, weight = _columns(across)
    shift = np.tile(across * place[0] - 0.5, resolution)
    origin = -side / 2 + np.array([0.5, 0.5, 0]) * side / count
    found = crossings(vertices, faces, count, origin, side / count, np.stack([shift, shift]))
    inner = np.zeros((DEGREE, resolution**3, DEGREE**2))  # by degree in z: of cells that the surface crosses
    above = np.zeros((resolution**2 * (resolution + 1), DEGREE**2))  # of the whole cells over a crossing
    for start in range(0, len(found[0]), _CHUNK):
        column, height, sign = (part[start : start + _CHUNK] for part in found)
        (i, a), (j, b) = (np.divmod(part, across) for part in np.divmod(column, count))
        z = np.clip(height / across, 0, resolution - 1e-9)
        k = z.astype(np.int64)
        flat = _products(_legendre(place[a, b]) * (weight[a, b] * sign)[:, None], _legendre(place[b, a]))
        pillar = i * resolution + j
        for moment, rise in zip(inner, _legendre_above(z - k).T):
            moment += _sum_rows(flat, rise, pillar * resolution + k, len(moment))
        above += _sum_rows(flat, np.full(len(k), 2.0), pillar * (resolution + 1) + k + 1, len(above))
    above = np.cumsum(above.reshape(resolution**2, resolution + 1, -1), axis=1)[:, :resolution]
    inner[0] += above.reshape(inner[0].shape)
    return np.moveaxis(inner, 0, -1).reshape(*(resolution,) * 3, *(DEGREE,) * 3)


@cache
def _columns(across: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of a cell's columns and their weights, a quadrature rule over [-1, 1]^2.

    Each row is shifted by its own share of a column, so that all places along an axis differ: an aligned
    lattice would quantise the thickness of walls that are parallel to it (a table top by several per
    cent). The weights are the nearest to equal ones that integrate a full cell's polynomials exactly; of
    some point-symmetric orders of the shifts, the one with the most equal weights is taken.

    Parameters
    ----------
    across : int, even
        Columns along each side of a cell.

    Returns
    -------
    place : (across, across) array
        Column (a, b) stands at x = place[a, b], y = place[b, a] of the unit cell.
    weight : (across, across) array, positive
    """
    rng, half = np.random.default_rng(0), across // 2
    equal, rules = 4 / across**2, []
    for _ in range(_ORDERS):
        order = rng.permutation(half)
        order = np.where(rng.random(half) < 0.5, order, across - 1 - order)
        order = np.concatenate([order, across - 1 - order[::-1]])
        place = (np.arange(across)[:, None] + (order + 0.5) / across) / across
        basis = _products(_legendre(place.ravel()), _legendre(place.T.ravel()))
        missing = np.eye(1, DEGREE**2)[0] * 4 - equal * basis.sum(0)
        gram = basis.T @ basis
        if np.linalg.cond(gram) < 1e6:
            shift = basis @ np.linalg.solve(gram, missing)
            rules.append((float(np.abs(shift).max()), place, equal + shift.reshape(across, across)))
    return min(rules, key=lambda rule: rule[0])[1:]


def _legendre(place: np.ndarray) -> np.ndarray:
    """Legendre polynomials of the unit interval; (Q,) -> (Q, 5)."""
    return legendre.legvander(2 * place - 1, DEGREE - 1)


def _legendre_above(place: np.ndarray) -> np.ndarray:
    """Twice their integrals from places to the interval's upper end; (Q,) -> (Q, 5)."""
    p = legendre.legvander(2 * place - 1, DEGREE)
    below = (p[:, 2:] - p[:, :-2]) / (2 * np.arange(1, DEGREE) + 1)  # zero at both ends
    return np.concatenate([1 - p[:, 1:2], -below], 1)


def _products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """All products of two sets of values; (Q, A), (Q, B) -> (Q, A B)."""
    return (left[:, :, None] * right[:, None, :]).reshape(len(left), -1)


def _sum_rows(rows: np.ndarray, factor: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Sum rows times factors by group; (Q, M), (Q,), (Q,) -> (count, M)."""
    return sp.csr_array((factor, (group, np.arange(len(rows)))), shape=(count, len(rows))) @ rows


def _reference_matrices(material: Material, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Element matrices per unit Legendre moment: stiffness (125, 3600) and scalar mass (125, 400)."""
    x, w = np.polynomial.legendre.leggauss(DEGREE)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij"), -1).reshape(-1, 3)
    weights = np.einsum("a,b,c->abc", w, w, w).ravel()
    basis = np.stack([legendre.legval(points, unit) for unit in np.eye(DEGREE)], -1)  # (Q, 3, 5)
    norm = (2 * np.arange(DEGREE) + 1) / 2
    product = np.einsum(
        "qa,qb,qc,a,b,c->qabc", basis[:, 0], basis[:, 1], basis[:, 2], norm, norm, norm
    ).reshape(len(points), -1)
    project = (product * weights[:, None]).T
    strain = strain_displacement(shape_gradients(points) * (2 / size))
    stiffness = np.einsum("qik,ij,qjl->qkl", strain, elasticity(material), strain, optimize=True)
    shapes = shape_functions(points)
    mass = material.density * np.einsum("qi,qj->qij", shapes, shapes)
    return project @ stiffness.reshape(len(points), -1), project @ mass.reshape(len(points), -1)


def elasticity(material: Material) -> np.ndarray:
    """Isotropic elasticity matrix in Voigt notation (xx, yy, zz, xy, yz, zx); (6, 6), Pa."""
    e, nu = material.youngs_modulus, material.poisson_ratio
    lame, shear = e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))
    c = np.diag([2 * shear] * 3 + [shear] * 3)
    c[:3, :3] += lame
    return c


def strain_displacement(gradients: np.ndarray) -> np.ndarray:
    """Strain-displacement matrices; shape gradients (Q, n, 3) -> (Q, 6, 3n)."""
    count, n, _ = gradients.shape
    strain = np.zeros((count, 6, n, 3))
    dx, dy, dz = gradients[..., 0], gradients[..., 1], gradients[..., 2]
    strain[:, 0, :, 0], strain[:, 1, :, 1], strain[:, 2, :, 2] = dx, dy, dz
    strain[:, 3, :, 0], strain[:, 3, :, 1] = dy, dx
    strain[:, 4, :, 1], strain[:, 4, :, 2] = dz, dy
    strain[:, 5, :, 0], strain[:, 5, :, 2] = dz, dx
    return strain.reshape(count, 6, 3 * n)


def _scatter(element: np.ndarray, dof: np.ndarray, size: int) -> sp.csr_matrix:
    """Sum element matrices into one symmetric sparse matrix."""
    n = dof.shape[1]
    dof = dof.astype(np.int32)
    rows, columns = np.repeat(dof, n, axis=1).ravel(), np.tile(dof, (1, n)).ravel()
    matrix = sp.coo_matrix((element.ravel(), (rows, columns)), shape=(size, size)).tocsr()
    return ((matrix + matrix.T) / 2).tocsr()
