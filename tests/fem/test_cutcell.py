import numpy as np
import pytest
from solids import TURN, box, join, sphere

from objectfolder.errors import ObjectFolderError
from objectfolder.fem.cutcell import (
    CutCells,
    assemble,
    cut_cells,
    elasticity,
    interpolate,
    node_count,
)
from objectfolder.fem.eigen import rigid_motions
from objectfolder.fem.modal import adaptive_cut_cells
from objectfolder.materials import Material

STUFF = Material("stuff", 1000.0, 1e9, 0.3, 0.0, 0.0)
SIDES = (0.83, 0.57, 0.41)
CENTRE = (0.021, -0.013, 0.037)  # off the grid


@pytest.fixture(scope="module")
def off_grid():
    return cut_cells(*box(SIDES, CENTRE, TURN), resolution=6, subdivisions=8)


@pytest.fixture(scope="module")
def elements(off_grid):
    return assemble(off_grid, STUFF, 0.2)


def test_volume_of_an_off_grid_box(off_grid):
    assert off_grid.volume == pytest.approx(np.prod(SIDES), rel=2e-3)
    assert off_grid.dropped_volume == 0


def test_volume_error_of_an_aligned_box_is_below_a_quarter_sub_cell(off_grid):
    cells = cut_cells(*box(SIDES, CENTRE), resolution=6, subdivisions=8)
    bound = 2 * cells.cell_size / 8 / 4 * (1 / SIDES[0] + 1 / SIDES[1])
    assert abs(cells.volume / np.prod(SIDES) - 1) < bound


def test_mass_is_density_times_volume(off_grid, elements):
    ones = np.ones(elements.nodal_mass.shape[0])
    assert ones @ elements.nodal_mass @ ones == pytest.approx(1000 * off_grid.volume * 0.2**3, rel=1e-5)


def test_moments_of_inertia_of_the_mass_matrix_are_those_of_the_box():
    sides = np.array([1.0, 0.5, 0.25])
    cells = cut_cells(*box(sides), resolution=8, subdivisions=8)
    fem = assemble(cells, STUFF, 2.0)
    rotations = rigid_motions(fem.nodes)[:, 3:]
    inertia = np.diag(rotations.T @ fem.mass @ rotations)
    size = sides * 2
    expected = (
        1000 * size.prod() / 12 * np.array([size[[1, 2]], size[[2, 0]], size[[0, 1]]]).__pow__(2).sum(1)
    )
    np.testing.assert_allclose(inertia, expected, rtol=0.01)


def test_stiffness_is_symmetric_and_annihilates_rigid_motions(elements):
    k = elements.stiffness
    assert abs(k - k.T).max() == 0
    forces = k @ rigid_motions(elements.nodes)
    reference = abs(k).max() * np.abs(rigid_motions(elements.nodes)).max(0)
    assert (np.abs(forces) <= 1e-12 * reference).all()


def test_stiffness_is_positive_semidefinite_and_mass_positive_definite(elements, rng):
    u = rng.standard_normal((elements.stiffness.shape[0], 20))
    assert (np.einsum("ij,ij->j", u, elements.stiffness @ u) > 0).all()
    assert (np.einsum("ij,ij->j", u, elements.mass @ u) > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_patch_a_linear_displacement_stores_the_energy_of_its_constant_strain(off_grid, elements, seed):
    gradient = np.random.default_rng(seed).standard_normal((3, 3))
    displacement = (elements.nodes @ gradient.T).ravel()
    e = (gradient + gradient.T) / 2
    strain = np.array([e[0, 0], e[1, 1], e[2, 2], 2 * e[0, 1], 2 * e[1, 2], 2 * e[2, 0]])
    expected = strain @ elasticity(STUFF) @ strain * off_grid.volume * 0.2**3
    assert displacement @ elements.stiffness @ displacement == pytest.approx(expected, rel=1e-5)


def test_elasticity_inverts_to_youngs_modulus_and_poisson_ratio():
    compliance = np.linalg.inv(elasticity(STUFF))
    assert compliance[0, 0] == pytest.approx(1 / 1e9)
    assert compliance[0, 1] == pytest.approx(-0.3 / 1e9)
    assert compliance[3, 3] == pytest.approx(2 * 1.3 / 1e9)


def test_interpolation_reproduces_linear_fields_inside(off_grid, elements, rng):
    points = (rng.random((500, 3)) - 0.5) * SIDES @ TURN.T + CENTRE
    matrix, offset = rng.standard_normal((3, 4)), rng.standard_normal(4)
    values = elements.nodes / 0.2 @ matrix + offset
    np.testing.assert_allclose(
        interpolate(off_grid, elements.connectivity, values, points), points @ matrix + offset, atol=1e-12
    )


def test_interpolation_outside_every_element_stays_within_the_nearest_one(off_grid, elements):
    values = elements.nodes[:, :1] / 0.2
    far = interpolate(
        off_grid, elements.connectivity, values, np.array([[0.5, 0.5, 0.5], [-0.5, -0.5, -0.5]])
    )
    assert np.abs(far).max() <= 0.5001


def test_nodes_are_shared_between_neighbours():
    cells = CutCells(np.array([[0, 0, 0], [1, 0, 0]]), np.ones((2, 1, 1, 1), np.float32), 4, 0.0)
    assert node_count(cells) == 20 + 20 - 8


def test_a_speck_that_touches_nothing_is_dropped_and_reported():
    big, small = (0.5, 0.5, 0.5), (0.1, 0.1, 0.1)
    cells = cut_cells(*join(box(big, (-0.2, 0, 0)), box(small, (0.4, 0, 0))), resolution=10, subdivisions=4)
    share = 0.001 / (0.125 + 0.001)
    assert cells.dropped_volume == pytest.approx(share, rel=0.1)
    assert cells.volume == pytest.approx(0.125, rel=0.05)


def test_an_object_that_leaves_no_material_in_any_cell_is_refused():
    with pytest.raises(ObjectFolderError, match=r"too thin.*voxelize\.resolution"):
        cut_cells(*box((0.5, 1e-5, 1e-5), (0, 0.013, 0.017)), resolution=4, subdivisions=2)


def test_resolution_is_the_first_that_is_small_enough():
    solid = sphere(0.5, 3)
    sizes = [3 * node_count(cut_cells(*solid, r, 2)) for r in (8, 6, 4)]
    assert sizes[0] > sizes[1] > sizes[2]
    for limit, resolution in ((sizes[0], 8), (sizes[0] - 1, 6), (sizes[2], 4), (1, 4)):
        assert adaptive_cut_cells(*solid, [8, 6, 4], 2, limit).resolution == resolution
