"""Cut cells of several sizes: an octree of grids, each half as fine as the one before.

An element of a coarse grid stands for the elements that it holds until it is divided. Nodes of a fine element
that lie on a coarse one are hanging nodes: they follow the shape functions of the coarse element, whatever
the ratio of their sizes, because part of a face holds the same polynomials as the whole.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from objectfolder.sound.fem.blocks import halve_cells
from objectfolder.sound.fem.cutcell import CutCells


@dataclass(frozen=True)
class MixedCells(CutCells):
    """Solid in the unit frame as cut cells of several sizes; positions are in cells of the finest grid."""

    fine_index: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.int64))  #: (C, 3) finest cells
    fine_element: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))  #: (C,) element of each
    coarser: CutCells | None = None  #: the same solid, each element but the largest twice as large

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """(C, 3) cells of the grid that hold material, and (C,) the element of each."""
        return self.fine_index, self.fine_element


@dataclass(frozen=True)
class Levels:
    """Grids of one solid, finest first, whose cells are not merged."""

    grids: list[CutCells]
    parents: list[np.ndarray]  #: of each element of all grids but the last: element of the next, or -1

    @classmethod
    def of(cls, finest: CutCells, count: int) -> "Levels":
        """Halve a grid as long as it is even and stays connected, up to ``count`` grids."""
        grids, parents = [finest], []
        while len(grids) < count and (found := halve_cells(grids[-1])) is not None:
            grids.append(found[0])
            parents.append(found[1])
        return cls(grids, parents)

    def uniform(self, level: int) -> list[np.ndarray]:
        """Return the divisions that leave elements of one level, full ones twice as large."""
        masks = [np.full(len(grid.index), own > level) for own, grid in enumerate(self.grids)]
        if level + 1 < len(self.grids):
            masks[level + 1] = ~self.grids[level + 1].is_full
        return masks

    def mesh(self, divided: Sequence[np.ndarray], coarser: CutCells | None = None) -> MixedCells:
        """Build the elements that are not divided and lie in no element that is not divided.

        ``divided`` says for every level whether each of its elements is (E,); none of the finest is.
        ``coarser`` is the same solid in larger elements.
        """
        level, element = self.leaves(divided)
        used = [own == k for k, own in enumerate(level)]
        first = np.concatenate([[0], np.cumsum([grid.connectivity.max() + 1 for grid in self.grids])])
        parts = list(zip(self.grids, used, first))
        nodes = np.concatenate([grid.connectivity[mask] + offset for grid, mask, offset in parts])
        owner = np.full(first[-1], -1)
        for k, (grid, mask, offset) in enumerate(parts):
            covered = np.flatnonzero(~mask & (level[k] > k))
            covered = covered[np.argsort(level[k][covered], kind="stable")]  # the coarsest owner comes last
            owner[grid.connectivity[covered].ravel() + offset] = np.repeat(element[k][covered], 20)
        kept, connectivity = np.unique(nodes, return_inverse=True)
        hanging = np.flatnonzero(owner[kept] >= 0)
        finest = self.grids[0]
        width = np.repeat(2 ** np.arange(len(parts)), [mask.sum() for mask in used])
        mesh = MixedCells(
            index=np.concatenate([grid.index[mask] << k for k, (grid, mask, _) in enumerate(parts)]),
            occupancy=np.concatenate([grid.occupancy[mask] for grid, mask, _ in parts]),
            connectivity=connectivity.reshape(-1, 20),
            resolution=finest.resolution,
            dropped_volume=finest.dropped_volume,
            width=width,
            hanging=hanging,
            hanging_element=owner[kept[hanging]],
            samples=finest.samples,
            sample_element=element[0][finest.sample_element],
            fine_index=finest.index,
            fine_element=element[0],
            coarser=coarser,
        )
        held = (mesh.fill * width**3).sum() / finest.fill.sum()  # coarse elements too small to keep
        return replace(mesh, volume_error=float(held * (1 + finest.volume_error) - 1))

    def coarsen(self, divided: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return the divisions that make each element but the largest twice as large."""
        masks = [np.zeros(len(grid.index), bool) for grid in self.grids]
        for level in range(1, len(masks) - 1):
            parent = self.parents[level][divided[level]]
            masks[level + 1][parent[parent >= 0]] = True
        return masks

    def leaves(self, divided: Sequence[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return for each element of every level the one of the mesh that holds it: its level and number.

        Both are -1 for a divided element, which is in several.
        """
        levels: list[np.ndarray] = []
        places: list[np.ndarray] = []
        for k in reversed(range(len(self.grids))):
            level, place = np.where(divided[k], -1, k), np.arange(len(divided[k]))
            if levels:
                parent = self.parents[k]
                held = (parent >= 0) & (levels[-1][parent] >= 0)
                level = np.where(held, levels[-1][parent], level)
                place = np.where(held, places[-1][parent], place)
            levels.append(level)
            places.append(place)
        levels, places = levels[::-1], places[::-1]
        used = [level == k for k, level in enumerate(levels)]
        first = np.cumsum([0, *(mask.sum() for mask in used)])
        elements = []
        for level, place in zip(levels, places):
            element = np.full(len(level), -1)
            for k, mask in enumerate(used):
                own = level == k
                element[own] = (first[k] + np.cumsum(mask) - 1)[place[own]]
            elements.append(element)
        return levels, elements
