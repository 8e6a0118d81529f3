"""Quadratic tetrahedra on a surface-conforming mesh: where cut cells stay uncertain, and as a check of them.

fTetWild (Hu et al. 2020; through pytetwild, MPL-2.0) makes the mesh. It is not reproducible.
"""

from contextlib import chdir
from dataclasses import dataclass, replace
from functools import cached_property
from tempfile import TemporaryDirectory
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import roots_jacobi
from typing_extensions import override  # the standard one is there since Python 3.12

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.mesh.topology import components, signed_volume
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

ENVELOPE = 5e-4  #: allowed distance of the mesh from the surface, in bounding-box diagonals
EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])  # their midpoints are nodes 5 to 10
_SIMPLIFIED = 0.2  # share of the envelope by which the surface is simplified before: fTetWild takes minutes
_SEARCHED = 32  # nearest centroids among which a point's tetrahedron is searched


@dataclass(frozen=True)
class Tetrahedra(Solid):
    """Solid in the unit frame as 10-node tetrahedra with straight edges."""

    name: ClassVar[str] = "tet10"  #: of the element
    order: ClassVar[int] = 2  #: degree of the complete polynomials
    vertices: np.ndarray  #: (N, 3) nodes, midpoints of edges included
    connectivity: np.ndarray  #: (E, 10) int64
    resolution: int  #: longest side divided by the requested edge length
    dropped_volume: float = 0.0  #: volume fraction of pieces not connected to the main one
    volume_error: float = 0.0  #: relative to the surface's volume; not corrected

    @property
    @override
    def volume(self) -> float:
        return float(self._volumes.sum())

    @cached_property
    def _volumes(self) -> np.ndarray:
        corner = self.vertices[self.connectivity[:, :4]]
        return np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6

    @cached_property
    def _gradients(self) -> np.ndarray:
        """(E, 4, 3) gradients of the barycentric coordinates."""
        corner = self.vertices[self.connectivity[:, :4]]
        inverse = np.linalg.inv(corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1)
        return np.concatenate([-inverse.sum(1, keepdims=True), inverse], 1)

    @override
    def assemble(self, material: Material, scale: float) -> FiniteElements:
        points, weights = _quadrature(2)  # exact for products of strains, which are linear
        rigidity = elasticity(material)
        volumes = self._volumes * scale**3
        stiffness = np.zeros((self.elements, 30, 30))
        for point, weight in zip(points, weights):
            slope = np.einsum("ij,ejd->eid", _slopes(point), self._gradients / scale)
            strain = strain_displacement(slope)
            stress = np.einsum("ij,ejk->eik", rigidity, strain)
            stiffness += (weight * volumes)[:, None, None] * (strain.transpose(0, 2, 1) @ stress)
        points, weights = _quadrature(3)
        shapes = _shapes(points)
        mass = material.density * (shapes.T * weights) @ shapes
        return FiniteElements.of(
            scatter(upper_blocks(stiffness, 3), self.connectivity, len(self.vertices)),
            scatter(volumes[:, None] * upper_blocks(mass, 1), self.connectivity, len(self.vertices)),
            self.vertices * scale,
        )

    def interpolate(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Evaluate a nodal field (N, C) at points (P, 3) of the unit frame, clamped to the solid; (P, C)."""
        first = self.vertices[self.connectivity[:, 0]]
        centroid = self.vertices[self.connectivity[:, :4]].mean(1)
        near = cKDTree(centroid).query(points, k=min(_SEARCHED, self.elements))[1].reshape(len(points), -1)
        share = np.einsum("pkij,pkj->pki", self._gradients[near], points[:, None] - first[near])
        share[..., 0] += 1
        best = share.min(-1).argmax(1)
        row = np.arange(len(points))
        share = share[row, best].clip(0)
        weights = _shapes(share / share.sum(1, keepdims=True))
        return mix_nodes(weights, values, self.connectivity[near[row, best]])


def tetrahedra(
    vertices: np.ndarray, faces: np.ndarray, resolution: int, name: str = "mesh", envelope: float = ENVELOPE
) -> Tetrahedra:
    """Fill a closed surface, (V, 3) in the unit frame and (F, 3), with tetrahedra.

    The resolution is the longest side divided by the largest edge; the mesh is within the envelope, in
    diagonals of the bounding box. Raises ObjectFolderError, with the object's name, if pytetwild is not
    installed, or the solid is in several pieces.
    """
    try:
        import pytetwild
    except ImportError as missing:
        raise ObjectFolderError(
            "element tet10 needs pytetwild: install objectfolder[build] or choose another voxelize.element"
        ) from missing
    plain = simplified(
        vertices, faces, _SIMPLIFIED * envelope * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    )
    with TemporaryDirectory() as folder, chdir(folder):  # fTetWild writes a file into the working directory
        points, cells = pytetwild.tetrahedralize(
            *plain,
            edge_length_abs=1 / resolution,
            epsilon=envelope,
            num_threads=1,
        )
    cells = cells.astype(np.int64)
    corner = points[cells]
    volumes = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1]))
    piece = joined_by_faces(cells)
    keep, dropped = main_piece(piece, volumes, name)
    solid = quadratic(points, cells[keep], resolution)
    error = solid.volume / signed_volume(vertices, faces) - 1
    return replace(solid, dropped_volume=dropped, volume_error=error)


def simplified(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a closed surface with fewer faces, within a tolerance; as it is if it is no manifold."""
    import manifold3d

    mesh = manifold3d.Mesh64(np.asarray(vertices, np.float64), np.asarray(faces, np.uint64))
    if not (solid := manifold3d.Manifold(mesh)).is_empty():
        mesh = solid.simplify(tolerance).to_mesh64()
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts).astype(np.int32)


def joined_by_faces(cells: np.ndarray) -> np.ndarray:
    """Return the piece of each tetrahedron; (E, 4) -> (E,). What shares an edge or a corner is a hinge."""
    sides = np.sort(cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    side = np.unique(sides, axis=0, return_inverse=True)[1].ravel()
    link = np.repeat(np.arange(len(cells)), 4), side + len(cells)
    return components(*link, len(cells) + int(side.max()) + 1)[1][: len(cells)]


def quadratic(points: np.ndarray, cells: np.ndarray, resolution: int) -> Tetrahedra:
    """Add nodes at the midpoints of the edges of linear tetrahedra; (N, 3), (E, 4) -> `Tetrahedra`."""
    corner = points[cells]
    flipped = np.linalg.det(corner[:, 1:] - corner[:, :1]) < 0
    cells = np.where(flipped[:, None], cells[:, [1, 0, 2, 3]], cells)
    ends = np.sort(cells[:, EDGES].reshape(-1, 2), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    nodes = np.concatenate([points, points[edges].mean(1)])
    connectivity = np.concatenate([cells, len(points) + number.reshape(-1, 6)], 1)
    used, connectivity = np.unique(connectivity, return_inverse=True)
    return Tetrahedra(nodes[used], connectivity.reshape(-1, 10), resolution)


def _shapes(share: np.ndarray) -> np.ndarray:
    """Evaluate the shape functions at barycentric coordinates; (Q, 4) -> (Q, 10)."""
    return np.concatenate([share * (2 * share - 1), 4 * share[:, EDGES].prod(-1)], 1)


def _slopes(share: np.ndarray) -> np.ndarray:
    """Evaluate their derivatives by the barycentric coordinates at one point; (4,) -> (10, 4)."""
    edges = np.zeros((6, 4))
    edges[np.arange(6), EDGES[:, 0]], edges[np.arange(6), EDGES[:, 1]] = 4 * share[EDGES[:, ::-1]].T
    return np.concatenate([np.diag(4 * share - 1), edges])


def _quadrature(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a conical product rule: barycentric points (Q, 4) and weights (Q,) that sum to one."""
    (a, wa), (b, wb), (c, wc) = (roots_jacobi(order, power, 0) for power in (2, 1, 0))
    a, b, c = (grid.ravel() for grid in np.meshgrid((1 + a) / 2, (1 + b) / 2, (1 + c) / 2, indexing="ij"))
    weight = np.einsum("i,j,k->ijk", wa, wb, wc).ravel()
    x, y, z = a, b * (1 - a), c * (1 - a) * (1 - b)
    return np.stack([1 - x - y - z, x, y, z], 1), weight / weight.sum()
