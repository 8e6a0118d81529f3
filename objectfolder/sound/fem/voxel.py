"""Voxels of 8-node hexahedra: a literal reading of the paper's supplementary material, for reference.

Every grid cell whose centre is inside the solid is one full hexahedron. The plain element locks in bending;
Wilson's incompatible modes (Taylor, Beresford and Wilson 1976), condensed out of each element, remove the
locking. Neither resolves walls thinner than a cell.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.ndimage import label
from scipy.spatial import cKDTree
from typing_extensions import override  # the standard one is there since Python 3.12

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.mesh.scanline import inside
from objectfolder.mesh.topology import signed_volume
from objectfolder.sound.fem.elasticity import (
    FiniteElements,
    Solid,
    elasticity,
    main_piece,
    mix_nodes,
    scatter,
    strain_displacement,
    upper_blocks,
)
from objectfolder.sound.fem.hex20 import NODES
from objectfolder.sound.fem.occupancy import MARGIN

CORNERS = NODES[:8]  #: (8, 3) nodes of the hexahedron on [-1, 1]^3
_GAUSS = 1 / np.sqrt(3)


@dataclass(frozen=True)
class Voxels(Solid):
    """Solid in the unit frame as whole cells of a grid."""

    order: ClassVar[int] = 1  #: degree of the complete polynomials
    index: np.ndarray  #: (E, 3) int64, grid position of each voxel
    connectivity: np.ndarray  #: (E, 8) int64
    resolution: int  #: cells along each axis of the grid
    incompatible: bool  #: whether the elements have Wilson's incompatible modes
    dropped_volume: float = 0.0  #: volume fraction of pieces not connected to the main one
    volume_error: float = 0.0  #: relative to the surface's volume; not corrected

    @property
    @override
    def name(self) -> str:
        return "hex8 voxels" + " with incompatible modes" * self.incompatible

    @property
    def cell_size(self) -> float:
        """Side of a voxel."""
        return (1 + MARGIN) / self.resolution

    @property
    @override
    def volume(self) -> float:
        return len(self.index) * self.cell_size**3

    @property
    def nodes(self) -> np.ndarray:
        """(N, 3) positions of the nodes, unit frame."""
        places = np.empty((int(self.connectivity.max()) + 1, 3))
        places[self.connectivity] = self.index[:, None, :] + (CORNERS + 1) / 2
        return places * self.cell_size - (1 + MARGIN) / 2

    @override
    def assemble(self, material: Material, scale: float) -> FiniteElements:
        stiffness, mass = _element_matrices(material, self.cell_size * scale, self.incompatible)
        count, size = len(self.index), int(self.connectivity.max()) + 1
        return FiniteElements.of(
            scatter(np.tile(upper_blocks(stiffness, 3), (count, 1)), self.connectivity, size),
            scatter(np.tile(upper_blocks(mass, 1), (count, 1)), self.connectivity, size),
            self.nodes * scale,
        )

    def interpolate(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Evaluate a nodal field (N, C) at points (P, 3) of the unit frame, in the nearest voxel; (P, C)."""
        position = (np.asarray(points, np.float64) + (1 + MARGIN) / 2) / self.cell_size
        element = cKDTree(self.index + 0.5).query(position, p=np.inf)[1]
        local = np.clip(2 * (position - self.index[element]) - 1, -1, 1)
        weights = (1 + CORNERS * local[:, None, :]).prod(-1) / 8
        return mix_nodes(weights, values, self.connectivity[element])


def voxels(
    vertices: np.ndarray, faces: np.ndarray, resolution: int, incompatible: bool, name: str = "mesh"
) -> Voxels:
    """Fill the grid's cells whose centres are inside a closed surface, (V, 3), unit frame, and (F, 3).

    The resolution is the number of cells along the longest side; elements may have Wilson's incompatible
    modes. Raises ObjectFolderError, with the object's name, if no cell centre is inside, or the voxels are in
    several pieces.
    """
    side = 1 + MARGIN
    spacing = side / resolution
    filled = inside(vertices, faces, resolution, np.full(3, (spacing - side) / 2), spacing)
    pieces, number = label(filled)
    if number == 0:
        raise ObjectFolderError(
            f"{name}: no voxel of the {resolution}^3 grid has its centre inside the solid; it is "
            "too thin: set voxelize.element to cut_cell_hex20"
        )
    index = np.argwhere(filled)
    main, dropped = main_piece(pieces[filled] - 1, np.ones(len(index)), name)
    index = index[main]
    solid = Voxels(index, lattice_connectivity(index, CORNERS), resolution, incompatible, dropped)
    return replace(solid, volume_error=solid.volume / signed_volume(vertices, faces) - 1)


def lattice_connectivity(index: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Number the nodes of hexahedra that share all common nodes; (E, 3), (n, 3) -> (E, n)."""
    lattice = 2 * index[:, None, :] + (nodes + 1).astype(np.int64)
    flat = np.ravel_multi_index(lattice.reshape(-1, 3).T, (lattice.max() + 1,) * 3)
    _, inverse = np.unique(flat, return_inverse=True)
    return inverse.reshape(len(index), len(nodes))


def _element_matrices(material: Material, size: float, incompatible: bool) -> tuple[np.ndarray, np.ndarray]:
    """Compute stiffness (24, 24) and scalar mass (8, 8) of a cube."""
    points, volume = CORNERS * _GAUSS, (size / 2) ** 3
    factor = (1 + CORNERS[None] * points[:, None, :]) / 2  # (Q, 8, 3)
    shapes = factor.prod(-1)
    others = np.stack([factor[..., (a + 1) % 3] * factor[..., (a + 2) % 3] for a in range(3)], -1)
    gradients = CORNERS / 2 * others
    if incompatible:  # 1 - x^2 along each axis
        gradients = np.concatenate([gradients, -2 * points[:, :, None] * np.eye(3)], 1)
    strain = strain_displacement(gradients * (2 / size))
    stiffness = np.einsum("qik,ij,qjl->kl", strain, elasticity(material), strain, optimize=True) * volume
    if incompatible:
        coupling = stiffness[:24, 24:]
        stiffness = stiffness[:24, :24] - coupling @ np.linalg.solve(stiffness[24:, 24:], coupling.T)
    return stiffness, material.density * volume * shapes.T @ shapes
