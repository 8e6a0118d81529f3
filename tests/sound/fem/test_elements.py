"""What every element must do, whatever its shape."""

import tracemalloc

import numpy as np
import pytest
from refusals import refused
from solids import STUFF, TURN, box, join, tetrahedral_box

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import rigid_motions, solve_modes
from objectfolder.sound.fem.elasticity import elasticity
from objectfolder.sound.fem.elements import discretize, solid_arrays, solid_from_arrays
from objectfolder.sound.fem.voxel import voxels

SIDES = np.array([1.0, 0.6, 0.4])
OFF_SIDES = np.array([0.36, 0.2, 0.12])
KINDS = ("cut_cell_hex20", "hex8", "hex8_incompatible", "tet10")


def solid(kind, counts=(10, 6, 4)):
    if kind == "tet10":
        return tetrahedral_box(SIDES, [c // 2 for c in counts])
    return discretize(*box(SIDES), kind, [counts[0]], 4, 10**6)


def inside(rng, count):
    """Points in the box of `off_grid`, which is in the others."""
    return (rng.random((count, 3)) - 0.5) * OFF_SIDES @ TURN.T


def off_grid():
    """Cells that a turned box cuts in all ways."""
    return cut_cells(*box(OFF_SIDES, (0, 0, 0), TURN), 12, 8)


@pytest.fixture(scope="module", params=[*KINDS, "off the grid"])
def element(request):
    divided = off_grid() if request.param == "off the grid" else solid(request.param)
    return divided, divided.assemble(STUFF, 0.2)


def test_volume_and_mass(element):
    divided, fem = element
    assert min(abs(divided.volume / sides.prod() - 1) for sides in (SIDES, OFF_SIDES)) < 1e-3
    assert fem.nodal_mass.sum() == pytest.approx(1000 * divided.volume * 0.2**3, rel=1e-3)


def test_degrees_of_freedom_are_known_before_assembly(element):
    divided, fem = element
    assert divided.degrees_of_freedom == fem.stiffness.shape[0] == fem.nodes.size


def test_rigid_motions_store_no_energy(element):
    fem = element[1]
    motions = rigid_motions(fem.nodes)
    assert np.abs(fem.stiffness @ motions).max() < 1e-11 * abs(fem.stiffness).max()
    assert abs(fem.stiffness - fem.stiffness.T).max() == 0


def test_a_constant_strain_stores_its_energy(element, rng):
    divided, fem = element
    gradient = rng.standard_normal((3, 3))
    e = (gradient + gradient.T) / 2
    strain = np.array([e[0, 0], e[1, 1], e[2, 2], 2 * e[0, 1], 2 * e[1, 2], 2 * e[2, 0]])
    u = (fem.nodes @ gradient.T).ravel()
    expected = strain @ elasticity(STUFF) @ strain * divided.volume * 0.2**3
    assert u @ fem.stiffness @ u == pytest.approx(expected, rel=1e-5)


def test_interpolation_holds_a_few_nodal_values_at_once(element, rng, monkeypatch):
    divided, fem = element
    points, values = inside(rng, 2000), rng.random((len(fem.nodes), 300))
    whole = divided.interpolate(values, points)
    monkeypatch.setattr("objectfolder.sound.fem.elasticity.MAX_GATHERED_VALUES", 20_000)
    tracemalloc.start()
    pieces = divided.interpolate(values, points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(pieces, whole, rtol=1e-12)
    assert peak < 4 * whole.nbytes  # a hexahedron has eight nodes
    assert divided.interpolate(values[:, :0], points).shape == (2000, 0)


def test_complete_polynomials_are_interpolated_exactly(element, rng):
    divided, fem = element
    points = inside(rng, 200)

    def field(x):
        linear = x @ np.array([1.0, -2.0, 0.5]) + 0.3
        return np.stack([linear, linear + (divided.order > 1) * x[:, 0] * x[:, 1]], 1)

    values = field(fem.nodes / 0.2)
    np.testing.assert_allclose(divided.interpolate(values, points), field(points), atol=1e-3 * 2)


def test_stored_solids_come_back(element):
    divided, fem = element
    again = solid_from_arrays({name: np.asarray(value) for name, value in solid_arrays(divided).items()})
    assert type(again) is type(divided)
    assert abs(again.assemble(STUFF, 0.2).stiffness - fem.stiffness).max() == 0


def test_what_is_not_a_solid_is_refused():
    refused(r"holds 'mesh', expected one of cut cells, voxels", solid_from_arrays, {"kind": np.array("mesh")})


def lowest(divided, count=6):
    modes = solve_modes(divided.assemble(STUFF, 1.0), 4000, count)
    return np.sqrt(modes.eigenvalues[:count]) / (2 * np.pi)


def test_all_elements_agree_on_a_block():
    frequencies = {kind: lowest(solid(kind)) for kind in KINDS}
    exact = lowest(cut_cells(*box(SIDES), 12, 4))
    for kind, error in zip(KINDS, (0.005, 0.04, 0.03, 0.025)):
        np.testing.assert_allclose(frequencies[kind], exact, rtol=error)


def test_incompatible_modes_mend_the_locking_of_voxels_in_bending():
    """A bar that is one voxel thick bends as a beam with them, and is far too stiff without."""
    bar = box((1, 0.05, 0.05), (0, 0.025, 0.025))
    beam = 22.3733 / (2 * np.pi) * 0.05 * np.sqrt(1e9 / 1000 / 12)  # Euler and Bernoulli
    locked, mended = (lowest(voxels(*bar, 20, kind), 1)[0] for kind in (False, True))
    assert mended == pytest.approx(beam, rel=0.03)
    assert locked > 1.1 * beam


def test_voxels_lose_walls_that_are_thinner_than_a_cell():
    """The reason why they are not the default."""
    sheet = box((1, 1, 0.04), (0, 0, 0.06))
    assert voxels(*sheet, 8, True).volume_error > 1.5
    assert abs(cut_cells(*sheet, 8, 4).volume_error) < 1e-3


@pytest.mark.parametrize("kind", ["cut_cell_hex20", "hex8", "tet10"])
def test_a_solid_in_two_pieces_is_refused_by_name_with_their_shares(kind):
    pair = join(box((0.2, 0.4, 0.4), (-0.35, 0, 0)), box((0.3, 0.4, 0.4), (0.35, 0, 0)))
    refused(
        r"^lamp: the solid is in 2 separate pieces.*6\d\.\d+%, .*of the volume",
        discretize,
        *pair,
        kind,
        [10],
        4,
        10**6,
        "lamp",
    )


@pytest.mark.slow
def test_a_tetrahedral_mesh_of_a_turned_box_agrees_with_cut_cells():
    solid = box(0.7 * SIDES, (0, 0, 0), TURN)
    mesh = discretize(*solid, "tet10", [16], 4, 10**6)  # 0.7 % too stiff at 8, 0.13 % at 16
    assert abs(mesh.volume_error) < 1e-3
    np.testing.assert_allclose(lowest(mesh), lowest(cut_cells(*solid, 16, 8)), rtol=5e-3)


def test_an_unknown_element_is_refused_by_name():
    with pytest.raises(ObjectFolderError, match=r"^lamp: unknown element 'hex27'.*cut_cell_hex20"):
        discretize(*box((1, 0.5, 0.5)), "hex27", [8], 4, 10**6, "lamp")
