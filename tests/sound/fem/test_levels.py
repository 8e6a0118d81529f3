import numpy as np
import pytest
from solids import STUFF, box, sphere, united

from objectfolder.sound.fem.accuracy import Discretisation, coarser
from objectfolder.sound.fem.blocks import halve_cells
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import rigid_motions
from objectfolder.sound.fem.levels import Levels


@pytest.fixture(scope="module")
def egg():
    vertices, faces = sphere(0.5, 3)
    return cut_cells(vertices * [0.5, 0.6, 1], faces, 16, 4)


@pytest.fixture(scope="module")
def levels(egg):
    return Levels.of(egg, 4)


@pytest.fixture(scope="module")
def mixed(levels):
    rng = np.random.default_rng(0)
    return levels.mesh([np.zeros(levels.grids[0].elements, bool), *(_coin(rng, g) for g in levels.grids[1:])])


def _coin(rng, grid):
    return rng.random(grid.elements) < 0.6


def frequencies(cells, count=4):
    return Discretisation(cells, STUFF, 1.0).lowest_frequencies(count)


def test_grids_are_halved_while_they_are_even():
    assert [grid.resolution for grid in Levels.of(cut_cells(*box((1, 1, 0.5)), 12, 4), 9).grids] == [12, 6, 3]


def test_elements_of_all_sizes_fill_the_solid_once(egg, mixed):
    assert set(mixed.width) == {1, 2, 4, 8}
    assert mixed.volume == pytest.approx(egg.volume, rel=1e-9)
    places, owner = mixed.places
    size = mixed.width[owner, None]
    assert ((places >= mixed.index[owner]) & (places < mixed.index[owner] + size)).all()


def test_quadratic_fields_and_rigid_motions_survive_every_ratio_of_sizes(mixed, rng):
    def field(x):
        return np.stack([x[:, 0] * x[:, 1] - x[:, 2] ** 2, x @ np.array([1.0, 2, 3])], 1)

    free = np.delete(mixed.nodes, mixed.hanging, axis=0)
    np.testing.assert_allclose(mixed.continuity @ field(free), field(mixed.nodes), atol=1e-12)
    points = rng.uniform(-0.25, 0.25, (300, 3))
    np.testing.assert_allclose(mixed.interpolate(field(free), points), field(points), atol=1e-12)
    fem = mixed.assemble(STUFF, 1.0)
    assert np.abs(fem.stiffness @ rigid_motions(fem.nodes)).max() < 1e-11 * abs(fem.stiffness).max()


def test_a_mesh_of_one_size_is_that_grid(levels):
    """But for specks that only the finer grids keep."""
    found = frequencies(levels.mesh(levels.uniform(3)))
    np.testing.assert_allclose(found, frequencies(levels.grids[3]), rtol=1e-3)


def test_more_elements_never_raise_a_frequency(egg, levels, mixed):
    """Every mesh spans a subspace of the finest one's displacements."""
    fine, some, coarse = (frequencies(cells) for cells in (egg, mixed, levels.grids[3]))
    assert (fine <= some * (1 + 1e-6)).all()
    assert (some < coarse).all()


def test_the_coarser_mesh_has_elements_twice_as_large(levels):
    masks = levels.uniform(1)
    mesh = levels.mesh(masks, levels.mesh(levels.coarsen(masks)))
    expected = frequencies(halve_cells(halve_cells(levels.grids[0])[0])[0])
    np.testing.assert_allclose(frequencies(coarser(mesh)), expected, rtol=1e-3)
    assert coarser(coarser(mesh)) is None


def test_energies_of_elements_add_up_to_the_eigenvalue(mixed):
    values, shapes = Discretisation(mixed, STUFF, 1.0).lowest_modes(3)
    np.testing.assert_allclose(mixed.strain_energies(STUFF, 1.0, shapes).sum(0), values, rtol=1e-6)


def test_walls_beside_a_narrow_gap_stay_separate():
    """The prongs of a fork, less than a cell apart, move against each other in large elements, too."""
    prong = (0.2, 0.45, 1.0)
    fork = united(
        box(prong, (0, 0.25, 0.0)), box(prong, (0, -0.25, 0.0)), box((0.2, 0.95, 0.1), (0, 0, 0.45))
    )
    levels = Levels.of(cut_cells(*fork, 8, 8), 2)
    mesh = levels.mesh(levels.uniform(1))
    _, shapes = Discretisation(mesh, STUFF, 1.0).lowest_modes(1)
    sides = [np.array([[0.0, side * 0.03, z] for z in (-0.45, -0.3)]) for side in (-1, 1)]
    one, other = (mesh.interpolate(shapes.reshape(-1, 3), points) for points in sides)
    assert np.abs(one - other).max() > 0.5 * max(np.abs(one).max(), np.abs(other).max())
