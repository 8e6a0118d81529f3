"""Local refinement: a mesh whose cells are small where small cells change the lowest modes."""

from dataclasses import dataclass

import numpy as np

from objectfolder.base.materials import Material
from objectfolder.sound.fem.accuracy import ORDER, Discretisation
from objectfolder.sound.fem.cutcell import CutCells
from objectfolder.sound.fem.levels import Levels, MixedCells

LEVELS = 6  #: grids of an octree
MAX_WIDTH = 8  #: side of the largest element, in cells of the finest grid
_INDICATOR_SIZE = 0.3  # share of the size limit that the uniform grid of the indicator may take
_HALVINGS = 16  # steps of the search for the threshold


@dataclass(frozen=True)
class _Solved:
    energy: np.ndarray  # (E, M) share of each element of one level in the energy of each mode
    eigenvalues: np.ndarray  # (M,)


def refine_locally(
    finest: CutCells, max_degrees_of_freedom: int, material: Material, scale: float
) -> Discretisation | None:
    """Choose the sizes of cells within a size limit; None if the solid has no two coarse grids.

    Modes are solved on the finest uniform grid within 30 % of the limit, and on its half. Where the energy of
    a block differs between the two, small cells matter: the difference is what dividing the block is worth,
    and each further division is worth less by the power ``ORDER`` of the cells' size. Elements are divided in
    order of this worth until the limit is reached. Full elements are never divided. ``finest`` are cells of
    the finest size, not merged; the longest side, ``scale``, is in metres.
    """
    levels = Levels.of(finest, LEVELS)
    start = next(
        (
            level
            for level in range(1, len(levels.grids) - 1)
            if levels.mesh(levels.uniform(level)).degrees_of_freedom
            <= _INDICATOR_SIZE * max_degrees_of_freedom
        ),
        None,
    )
    if start is None:
        return None
    worth = _worth(levels, start, material, scale)
    low, high, best = -40.0, 1.0, None  # powers of two
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        divided = [own > 2**middle for own in worth]
        for level, mask in enumerate(divided):
            mask |= 2**level > MAX_WIDTH
        mesh = levels.mesh(divided)
        if mesh.degrees_of_freedom > max_degrees_of_freedom:
            low = middle
        else:
            high, best = middle, divided
    return None if best is None else Discretisation(_with_coarser(levels, best), material, scale)


def _worth(levels: Levels, start: int, material: Material, scale: float) -> list[np.ndarray]:
    """For every level, the change of an eigenvalue (relative, the largest) by dividing each element; (E,)."""
    fine, coarse = (_solved(levels, level, material, scale) for level in (start, start + 1))
    parent = levels.parents[start]
    inner = np.zeros_like(coarse.energy)
    np.add.at(inner, parent[parent >= 0], fine.energy[parent >= 0])
    ratio = coarse.eigenvalues / fine.eigenvalues
    worth = {start + 1: np.abs(coarse.energy * ratio - inner).max(1)}
    for level in range(start, 0, -1):
        parent, above = levels.parents[level], worth[level + 1]
        siblings = np.bincount(parent[parent >= 0], minlength=len(above))
        worth[level] = np.where(parent >= 0, (above / np.maximum(siblings, 1))[parent] / 2**ORDER, 0.0)
    for level in range(start + 2, len(levels.grids)):
        parent = levels.parents[level - 1]
        total = np.zeros(levels.grids[level].elements)
        np.add.at(total, parent[parent >= 0], worth[level - 1][parent >= 0])
        worth[level] = total * 2**ORDER
    worth[0] = np.zeros(levels.grids[0].elements)
    return [np.where(grid.is_full, 0.0, worth[level]) for level, grid in enumerate(levels.grids)]


def _solved(levels: Levels, level: int, material: Material, scale: float) -> _Solved:
    """Solve the lowest modes on the uniform grid of a level."""
    divided = levels.uniform(level)
    mesh = levels.mesh(divided)
    values, shapes = Discretisation(mesh, material, scale).lowest_modes()
    energy = mesh.strain_energies(material, scale, shapes) / values
    # An element of the mesh is one of the level, or a full one that holds eight.
    own = levels.leaves(divided)[1][level]
    share = np.bincount(own, minlength=mesh.elements)
    return _Solved(energy[own] / share[own, None], values)


def _with_coarser(levels: Levels, divided: list[np.ndarray]) -> MixedCells:
    """Build the mesh, and the two coarser ones of its error estimate."""
    mesh = None
    steps = [divided]
    for _ in range(2):
        steps.append(levels.coarsen(steps[-1]))
    for step in reversed(steps):
        mesh = levels.mesh(step, mesh)
    assert mesh is not None
    return mesh
