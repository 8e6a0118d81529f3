"""Cut-cell finite elements: a closed surface immersed in a grid of 20-node hexahedra.

Every grid cell that the solid touches becomes one hexahedron whose stiffness and mass are integrated
over the material inside it (the finite cell method; Parvizian, Duester and Rank 2007). Plain voxels of
the same size are 30 to 70 % wrong on thin walls; cut cells stay within a few per cent.

The integral of a polynomial over the material is linear in the Legendre moments of the occupancy, so all
element matrices come from one matrix product, and only the moments are stored.

A cell with several disconnected parts of material has one element per part, and elements share the nodes of
a face only where material is continuous across it: walls with a narrow gap between them stay separate.
Blocks of full cells become larger elements (`objectfolder.sound.fem.blocks`).
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from scipy.spatial import cKDTree
from typing_extensions import override  # the standard one is there since Python 3.12

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.mesh.topology import components, signed_volume
from objectfolder.sound.fem.certainty import CUT_CELLS
from objectfolder.sound.fem.elasticity import (
    FiniteElements,
    Solid,
    elasticity,
    main_piece,
    mix_nodes,
    scatter,
    strain_displacement,
    symmetric,
    upper_blocks,
)
from objectfolder.sound.fem.hex20 import NODES, shape_functions, shape_gradients
from objectfolder.sound.fem.occupancy import DEGREE, MARGIN, Occupancy, measure

MIN_FULL_FILL = 1 - 1e-5  # fill of a cell that counts as full
EMPTY_FILL = 1e-3  # parts with a smaller fill are dropped
VOID_STIFFNESS = 1e-6  # stiffness and mass of the void in a cut cell, relative to the material
MAX_VOLUME_ERROR = 0.05  #: accepted relative volume error of the cells, before its correction


@dataclass(frozen=True)
class CutCells(Solid):
    """Solid in the unit frame as cut cells: each element is a grid cell with one part of its material."""

    name: ClassVar[str] = CUT_CELLS  #: of the element
    order: ClassVar[int] = 2  #: degree of the complete polynomials
    index: np.ndarray  #: (E, 3) int64, grid position of each element's cell
    occupancy: np.ndarray  #: (E, 5, 5, 5) float32, Legendre moments in x, y, z over [-1, 1]^3
    connectivity: np.ndarray  #: (E, 20) int64, nodes of each element
    resolution: int  #: cells along each axis of the grid
    dropped_volume: float = 0.0  #: volume fraction of pieces not connected to the main one
    volume_error: float = 0.0  #: of the elements, relative to the surface's exact volume
    #: (E,) int64, side of each element in cells; above 1 in merged blocks (`objectfolder.sound.fem.blocks`)
    width: np.ndarray = field(default_factory=lambda: np.ones(0, np.int64))
    hanging: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))  #: (H,) hanging nodes
    #: (H,) large element of each
    hanging_element: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    #: (S, 3) float32, positions in cells, throughout the material of cells with several elements
    samples: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.float32))
    sample_element: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))  #: (S,)

    def __post_init__(self) -> None:
        if len(self.width) == 0:
            object.__setattr__(self, "width", np.ones(len(self.index), np.int64))

    @property
    @override
    def degrees_of_freedom(self) -> int:
        return super().degrees_of_freedom - 3 * len(self.hanging)

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
        """(E,) fraction of its cell that each element fills."""
        return self.occupancy[:, 0, 0, 0].astype(np.float64) / 8

    @property
    def is_full(self) -> np.ndarray:
        """(E,) whether each element is full of material."""
        return self.fill > MIN_FULL_FILL

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """(C, 3) cells of the grid that the elements span, and (C,) the element of each."""
        places = np.repeat(self.index, self.width**3, axis=0)
        places += np.concatenate([np.indices((width,) * 3).reshape(3, -1).T for width in self.width])
        return places, np.repeat(np.arange(len(self.index)), self.width**3)

    @property
    def correction(self) -> float:
        """Factor on mass and stiffness that gives the solid the surface's exact volume.

        Applied to both, because the missing material is as stiff as the rest: mass and static deflections
        of a block become exact, and no frequency changes. On the mass alone it would shift all frequencies
        by half the error. A wall too thin by a fraction e keeps bending frequencies too low by e, so
        `cut_cells` also bounds the error.
        """
        return 1 / (1 + self.volume_error)

    @property
    @override
    def volume(self) -> float:
        return float((self.fill * self.width**3).sum() * self.cell_size**3 * self.correction)

    @property
    def nodes(self) -> np.ndarray:
        """(N, 3) positions of the nodes, unit frame; some coincide where a gap is narrower than a cell."""
        return self._places() * self.cell_size + self.lower

    @property
    def continuity(self) -> sp.csr_array:
        """(N, free) matrix from values at the free nodes to values at all nodes, hanging ones included."""
        count = int(self.connectivity.max()) + 1
        free = np.ones(count, bool)
        free[self.hanging] = False
        own, width = self.hanging_element, self.width[self.hanging_element, None]
        local = 2 * (self._places()[self.hanging] - self.index[own]) / width - 1
        weight = shape_functions(local)
        rows = np.concatenate([np.flatnonzero(free), np.repeat(self.hanging, 20)])
        columns = np.concatenate([np.flatnonzero(free), self.connectivity[own].ravel()])
        values = np.concatenate([np.ones(free.sum()), weight.ravel()])
        used = np.abs(values) > 1e-12
        step = sp.csr_array((values[used], (rows[used], columns[used])), shape=(count, count))
        whole = step
        while not free[whole.indices].all():  # a large element's nodes may hang on a larger one
            whole = sp.csr_array(whole @ step)
            whole.data[np.abs(whole.data) < 1e-12] = 0
            whole.eliminate_zeros()
        return sp.csr_array(whole[:, np.flatnonzero(free)])

    def _places(self) -> np.ndarray:
        """(N, 3) positions of the nodes, in cells."""
        places = np.empty((int(self.connectivity.max()) + 1, 3))
        places[self.connectivity] = self.index[:, None, :] + (NODES + 1) / 2 * self.width[:, None, None]
        return places

    @override
    def assemble(self, material: Material, scale: float) -> FiniteElements:
        size = self.cell_size * scale
        stiffness_basis, mass_basis = _reference_matrices(material, size)
        moments, width = self._moments(size), self.width[:, None]
        return FiniteElements.of(
            self._joined((moments * width) @ stiffness_basis, 3),
            self._joined((moments * width**3) @ mass_basis, 1),
            np.delete(self.nodes, self.hanging, axis=0) * scale,
        )

    def strain_energies(self, material: Material, scale: float, shapes: np.ndarray) -> np.ndarray:
        """Integrate twice the strain energy of displacements over each element; (E, M), joules.

        Displacements (3 free, M) of the free nodes, and the longest side, ``scale``, are in metres.
        """
        size, count = self.cell_size * scale, shapes.shape[1]
        basis = _reference_matrices(material, size)[0]
        moments = self._moments(size) * self.width[:, None]
        nodal = (self.continuity @ shapes.reshape(-1, 3 * count)).reshape(-1, 3, count)
        own, other = np.triu_indices(len(NODES))
        out = np.empty((self.elements, count))
        for start in range(0, self.elements, 2048):
            part = slice(start, start + 2048)
            moved = nodal[self.connectivity[part]]  # (e, 20, 3, M)
            blocks = (moments[part] @ basis).reshape(len(moved), len(own), 3, 3)
            blocks[:, own != other] *= 2  # those below the diagonal
            pushed = blocks @ moved[:, other]
            out[part] = np.einsum("epim,epim->em", moved[:, own], pushed)
        return out

    def _moments(self, size: float) -> np.ndarray:
        """(E, 125) corrected moments of material and void, for cells of a size in metres."""
        moments = self.occupancy.reshape(-1, DEGREE**3).astype(np.float64)
        full = np.eye(1, DEGREE**3) * 8
        return (moments + VOID_STIFFNESS * (full - moments)) * (self.correction * (size / 2) ** 3)

    def _joined(self, blocks: np.ndarray, size: int) -> sp.csr_matrix:
        """Sum element matrices, given by their `upper_blocks`, over the free nodes."""
        free = np.ones(int(self.connectivity.max()) + 1, bool)
        free[self.hanging] = False
        plain = free[self.connectivity].all(1)
        column = np.cumsum(free) - 1
        matrix = scatter(blocks[plain], column[self.connectivity[plain]], int(free.sum()))
        if plain.all():
            return matrix
        join = sp.kron(self.continuity, sp.eye_array(size), format="csr")
        hung = scatter(blocks[~plain], self.connectivity[~plain], len(free))
        return matrix + symmetric(join.T @ hung @ join)

    def interpolate(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Evaluate a field (free, C) of the free nodes at points (P, 3), unit frame; (P, C).

        In a cell with several elements, the element with the nearest material is used. A point in a cell
        without elements (on its boundary, or in a dropped piece) takes the value at the nearest position
        inside the nearest element.
        """
        position = (np.asarray(points, np.float64) - self.lower) / self.cell_size
        element = _element_at(self, position)
        local = np.clip(2 * (position - self.index[element]) / self.width[element, None] - 1, -1, 1)
        return mix_nodes(shape_functions(local), self.continuity @ values, self.connectivity[element])


def cut_cells(
    vertices: np.ndarray, faces: np.ndarray, resolution: int, subdivisions: int, name: str = "mesh"
) -> CutCells:
    """Cut a closed surface, (V, 3) in the unit frame and (F, 3), into grid cells.

    Occupancy is integrated exactly along columns and by quadrature across them. Fill fractions of sub-cells
    would smear walls that are one or two sub-cells thick and make them too stiff (20 to 40 % in frequency at
    1.6 sub-cells). The resolution is the number of cells along the longest side; a cell has at least 4
    sub-cells along each side, and four columns go through each.

    Raises ObjectFolderError, with the object's name, if no cell holds material, the solid is in several
    pieces, or the volume error exceeds `MAX_VOLUME_ERROR`.
    """
    material = measure(vertices, faces, resolution, subdivisions)
    kept, connectivity, pieces = glue(material)
    if len(kept) == 0:
        raise ObjectFolderError(
            f"{name}: no cell of the {resolution}^3 grid holds {EMPTY_FILL:.1%} material; the object is "
            "too thin: add a finer grid to voxelize.resolutions"
        )
    main, dropped = main_piece(pieces, material.fill[kept], name)
    kept, connectivity = kept[main], np.unique(connectivity[main], return_inverse=True)[1].reshape(-1, 20)
    element = np.full(len(material.cell), -1)
    element[kept] = np.arange(len(kept))
    sampled = element[material.sample_part] >= 0
    fill, volume = material.fill[kept].sum(), signed_volume(vertices, faces)
    cells = CutCells(
        index=material.cell[kept],
        occupancy=material.moments[kept].astype(np.float32),
        connectivity=connectivity,
        resolution=resolution,
        dropped_volume=dropped,
        volume_error=float(fill * ((1 + MARGIN) / resolution) ** 3 / volume - 1),
        samples=material.samples[sampled].astype(np.float32),
        sample_element=element[material.sample_part[sampled]],
    )
    error = cells.volume_error
    if abs(error) > MAX_VOLUME_ERROR:
        raise ObjectFolderError(
            f"{name}: the cells of the {resolution}^3 grid hold {1 + error:.1%} of the surface's volume "
            f"({cells.dropped_volume:.1%} is in other pieces), expected within {MAX_VOLUME_ERROR:.0%}: join "
            "the mesh's parts, or add a finer grid to voxelize.resolutions"
        )
    return cells


def glue(material: Occupancy) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Number the nodes of the elements; parts with continuous material between them share nodes.

    Parts too small to become elements still connect the nodes of their neighbours. Returns the parts that
    become elements (E,), the nodes of each (E, 20), numbered without gaps, and the piece of the solid,
    connected through faces, of each (E,).
    """
    first, second = material.links.T
    offset = material.cell[second] - material.cell[first]
    pairs = [(np.empty(0, np.int64),) * 2]
    for step in np.unique(offset, axis=0):
        own, other = np.nonzero((NODES[:, None] == NODES + 2 * step).all(-1))
        links = np.flatnonzero((offset == step).all(1))
        pairs.append(((20 * first[links, None] + own).ravel(), (20 * second[links, None] + other).ravel()))
    first_node, second_node = (np.concatenate(side) for side in zip(*pairs))
    node = components(first_node, second_node, 20 * len(material.cell))[1].reshape(-1, 20)
    kept = np.flatnonzero(material.fill > EMPTY_FILL)
    connectivity = np.unique(node[kept], return_inverse=True)[1].reshape(-1, 20)
    element = np.full(len(material.cell), -1)
    element[kept] = np.arange(len(kept))
    faces = element[material.links[np.abs(offset).sum(1) == 1]]
    faces = faces[(faces >= 0).all(1)]
    return kept, connectivity, components(faces[:, 0], faces[:, 1], len(kept))[1]


def _element_at(cells: CutCells, position: np.ndarray) -> np.ndarray:
    """Find the element of each position, in cells: nearest material in its cell, else nearest; (P,)."""
    shape = (cells.resolution,) * 3
    own = np.floor(position).astype(np.int64).clip(0, cells.resolution - 1)
    places, owner = cells.places
    lookup = np.full(shape, -1)
    lookup[tuple(places.T)] = owner
    outside = np.flatnonzero(lookup[tuple(own.T)] < 0)
    if len(outside):
        own[outside] = places[cKDTree(places + 0.5).query(position[outside])[1]]
    element = lookup[tuple(own.T)]
    lowest, width = cells.index[cells.sample_element], cells.width[cells.sample_element, None]
    held = np.floor(cells.samples).astype(np.int64).clip(lowest, lowest + width - 1)
    sampled = np.ravel_multi_index(held.T, shape)
    several = np.flatnonzero(np.isin(np.ravel_multi_index(own.T, shape), sampled))
    if len(several):
        # Cells are kept far apart, so that only the point's own cell is searched.
        tree = cKDTree(np.concatenate([cells.samples, 10 * held], 1))
        near = tree.query(np.concatenate([position[several], 10 * own[several]], 1))[1]
        element[several] = cells.sample_element[near]
    return element


def _reference_matrices(material: Material, size: float) -> tuple[np.ndarray, np.ndarray]:
    """`upper_blocks` of stiffness (125, 1890) and mass (125, 210) per unit Legendre moment."""
    x, w = np.polynomial.legendre.leggauss(DEGREE)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij"), -1).reshape(-1, 3)
    weights = np.einsum("a,b,c->abc", w, w, w).ravel()
    basis = np.stack([legendre.legval(points, unit) for unit in np.eye(DEGREE)], -1)  # (Q, 3, 5)
    norm = (2 * np.arange(DEGREE) + 1) / 2
    along = np.moveaxis(basis, 1, 0)
    product = np.einsum("qa,qb,qc,a,b,c->qabc", *along, norm, norm, norm).reshape(len(points), -1)
    project = (product * weights[:, None]).T
    strain = strain_displacement(shape_gradients(points) * (2 / size))
    stiffness = np.einsum("qik,ij,qjl->qkl", strain, elasticity(material), strain, optimize=True)
    shapes = shape_functions(points)
    mass = material.density * np.einsum("qi,qj->qij", shapes, shapes)
    return project @ upper_blocks(stiffness, 3), project @ upper_blocks(mass, 1)
