"""Merge blocks of 2 x 2 x 2 cells into single elements: full blocks, or all blocks for a coarser grid.

A face of a large element meets four small faces. Their nodes that are not nodes of the large face are
hanging nodes: they follow its shape functions, which keeps displacements continuous (a quarter of the large
face holds the same polynomials as a small face).
"""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre

from objectfolder.mesh.topology import components
from objectfolder.sound.fem.cutcell import CutCells, glue
from objectfolder.sound.fem.hex20 import NODES
from objectfolder.sound.fem.occupancy import DEGREE, Occupancy

_CHILDREN = np.indices((2, 2, 2)).reshape(3, 8).T  # (8, 3) positions of a block's cells
_CHILD = (NODES > 0) @ np.array([4, 2, 1])  # cell of the block at each node of the large element
_CORNER = np.nonzero((NODES[:8] == np.where(NODES < 0, -1, 1)[:, None]).all(-1))[1]  # and its corner there


def merge_full_blocks(cells: CutCells) -> CutCells:
    """Merge every block of 2 x 2 x 2 full cells at even grid positions into one element."""
    full = np.flatnonzero(cells.is_full)
    shape = (cells.resolution // 2 + 1,) * 3
    parent = np.ravel_multi_index((cells.index[full] // 2).T, shape)
    child = (cells.index[full] % 2) @ np.array([4, 2, 1])
    order = np.lexsort((child, parent))
    _, first, count = np.unique(parent[order], return_index=True, return_counts=True)
    if not (count == 8).any():
        return cells
    members = full[order][first[count == 8][:, None] + np.arange(8)]  # (B, 8)
    connectivity = cells.connectivity[members[:, _CHILD], _CORNER]
    small = np.ones(len(cells.index), bool)
    small[members] = False
    inner, owner = np.unique(cells.connectivity[members].reshape(len(members), -1), return_index=True)
    hangs = np.isin(inner, cells.connectivity[small]) & ~np.isin(inner, connectivity)
    element = np.full(len(small), -1)
    element[small] = np.arange(small.sum())
    # Renumber without gaps: the inner nodes of the blocks are gone.
    nodes, numbers = np.unique(np.concatenate([cells.connectivity[small], connectivity]), return_inverse=True)
    return replace(
        cells,
        index=np.concatenate([cells.index[small], cells.index[members[:, 0]]]),
        width=np.repeat([1, 2], [small.sum(), len(members)]),
        occupancy=np.concatenate([cells.occupancy[small], cells.occupancy[members[:, 0]]]),
        connectivity=numbers.reshape(-1, 20),
        hanging=np.searchsorted(nodes, inner[hangs]),
        hanging_element=small.sum() + owner[hangs] // 160,
        sample_element=element[cells.sample_element],
    )


def halve_cells(cells: CutCells) -> tuple[CutCells, np.ndarray] | None:
    """Return the same solid on a grid of half the resolution, and the coarse element of each one (E,), or -1.

    Its moments are computed from the fine ones. None if the resolution is odd or the coarse elements are not
    connected.
    """
    if cells.resolution % 2:
        return None
    count, resolution = len(cells.index), cells.resolution // 2
    parent = np.ravel_multi_index((cells.index // 2).T, (resolution,) * 3)
    # Elements of a block that share nodes are one part of the coarse cell.
    own = np.repeat(np.arange(count), 20)
    node = cells.connectivity.ravel()
    _, seat = np.unique(parent[own] * (node.max() + 1) + node, return_inverse=True)
    joined = components(own, count + seat, count + int(seat.max()) + 1)[1][:count]
    parts, part = np.unique(joined, return_inverse=True)
    touch = sp.csr_array((np.ones(len(node)), (part[own], node)), shape=(len(parts), node.max() + 1))
    pairs = sp.triu(touch @ touch.T, k=1).tocoo()
    cell = np.zeros(len(parts), np.int64)
    cell[part] = parent
    moments = np.zeros((len(parts), *(DEGREE,) * 3))
    rules = _halving()
    for corner in _CHILDREN:
        small = np.flatnonzero((cells.width == 1) & (cells.index % 2 == corner).all(1))
        turns = (rules[side] for side in corner)
        turned = np.einsum("eabc,ia,jb,kc->eijk", cells.occupancy[small], *turns, optimize=True)
        np.add.at(moments, part[small], turned)
    large = np.flatnonzero(cells.width == 2)
    moments[part[large]] = cells.occupancy[large]
    links = np.stack([pairs.row, pairs.col], 1)
    place = np.stack(np.unravel_index(cell, (resolution,) * 3), 1)
    none = np.empty((0, 3)), np.empty(0, np.int64)
    kept, connectivity, pieces = glue(Occupancy(place, moments, links, *none))
    if not len(pieces) or pieces.max() > 0:
        return None
    element = np.full(len(parts), -1)
    element[kept] = np.arange(len(kept))
    coarse = CutCells(
        index=place[kept],
        occupancy=moments[kept].astype(np.float32),
        connectivity=connectivity,
        resolution=resolution,
        volume_error=cells.volume_error,
    )
    return coarse, element[part]


def _halving() -> np.ndarray:
    """Matrices from Legendre moments over the halves of an interval to those over the whole; (2, 5, 5)."""
    x, w = legendre.leggauss(DEGREE)
    small = legendre.legvander(x, DEGREE - 1) * (np.arange(DEGREE) + 0.5)
    large = np.stack([legendre.legvander((x + side) / 2, DEGREE - 1) for side in (-1, 1)])
    return np.einsum("q,sqa,qb->sab", w / 2, large, small)
