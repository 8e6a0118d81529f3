import dataclasses
import math

import numpy as np
import pytest
import torch

from objectfolder.errors import ObjectFolderError
from objectfolder.materials import MATERIALS, Material, material, own_material
from objectfolder.objectfile.header import checked_name


@pytest.mark.parametrize("name", [*MATERIALS, "unknown", "Stainless steel 304", "PVC+ABS", "a", "x_1-2.5"])
def test_names_of_materials_are_those_of_object_files(name):
    assert checked_name("material", name, "material") == name


def test_table_is_that_of_the_supplement():
    assert set(MATERIALS) == {"ceramic", "glass", "wood", "plastic", "iron", "polycarbonate", "steel"}
    steel = material("Steel")
    assert (steel.density, steel.youngs_modulus, steel.poisson_ratio, steel.alpha, steel.beta) == (
        7850,
        2e11,
        0.29,
        5,
        3e-8,
    )


@pytest.mark.parametrize("m", MATERIALS.values(), ids=MATERIALS)
def test_materials_are_physical(m):
    assert 100 < m.density < 20000
    assert 1e8 < m.youngs_modulus < 1e12
    assert 0 < m.poisson_ratio < 0.5
    assert m.alpha > 0
    assert m.beta > 0
    # Sound travels at hundreds to thousands of metres per second.
    assert 500 < (m.youngs_modulus / m.density) ** 0.5 < 7000


@pytest.mark.parametrize("name", ["gold", "", None, 3])
def test_an_unknown_material_lists_the_known_ones(name):
    with pytest.raises(ObjectFolderError, match=r"unknown material .*ceramic, glass"):
        material(name)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((f, v) for f in ("density", "youngs_modulus") for v in (0.0, -1.0, math.nan, math.inf)),
        *(("poisson_ratio", v) for v in (-1.0, 0.5, 0.7, -2.0, math.nan)),
        *((f, v) for f in ("alpha", "beta") for v in (-1e-9, math.nan, math.inf)),
    ],
)
def test_an_unphysical_material_is_refused(field, value):
    with pytest.raises(ObjectFolderError, match=f"material 'steel': {field} is {value}, expected a"):
        dataclasses.replace(material("steel"), **{field: value})


def test_auxetic_and_undamped_materials_exist():
    m = dataclasses.replace(material("steel"), poisson_ratio=-0.7, alpha=0.0, beta=0.0)
    assert m.poisson_ratio == -0.7
    assert Material("steel", 7850.0, 2e11, -0.7) == m
    with pytest.raises(ObjectFolderError, match="'steel': an undamped object rings for ever; give alpha"):
        m.require_damping()


@pytest.mark.parametrize("damping", [{"alpha": 1.0}, {"beta": 1e-8}, {"loss_factor": ((1000.0, 5e-4),)}])
def test_one_kind_of_damping_is_enough(damping):
    brass = Material("brass", 8500.0, 1.0e11, 0.34, **damping)
    brass.require_damping()
    assert (brass.damping(np.array([1e6, 1e9])) > 0).all()


def test_a_loss_factor_is_the_inverse_of_the_quality_factor():
    flat = dataclasses.replace(material("steel"), loss_factor=((1000, 0.002),))
    angular = 2 * np.pi * np.array([50.0, 1000.0, 15000.0])
    np.testing.assert_allclose(angular / (2 * flat.damping(angular**2)), 500, rtol=1e-12)


def test_a_loss_factor_is_linear_between_its_knots_and_constant_beyond():
    knots = ((1000.0, 0.001), (2000.0, 0.003), (8000.0, 0.002))
    loss = dataclasses.replace(material("steel"), loss_factor=knots)
    hertz = np.array([10.0, 1000.0, 1500.0, 2000.0, 5000.0, 8000.0, 20000.0])
    angular = 2 * np.pi * hertz
    found = loss.damping(torch.from_numpy(angular**2)).numpy()
    np.testing.assert_allclose(found, np.interp(hertz, *zip(*knots)) * angular / 2, rtol=1e-12)


def test_the_named_materials_differ_by_their_damping_only():
    for name in MATERIALS:
        other = material(name, "loss_factor")
        assert (material(name).law, other.law) == ("rayleigh", "loss_factor")
        assert dataclasses.replace(other, loss_factor=()) == material(name)


@pytest.mark.parametrize(
    "knots",
    [
        [[1000, 0.1], [1000, 0.2]],
        [[2000, 0.1], [1000, 0.2]],
        [[1000, 0.0]],
        [[1000, 1.5]],
        [[-1, 0.1]],
        [1000, 0.1],
    ],
)
def test_an_unphysical_loss_factor_is_refused(knots):
    with pytest.raises(ObjectFolderError, match=r"'steel': loss_factor is .* pairs of a frequency in Hz"):
        dataclasses.replace(material("steel"), loss_factor=knots)


def test_an_object_may_have_a_material_of_its_own():
    assert own_material("Steel", "loss_factor") == material("steel", "loss_factor")
    own = own_material({"base": "ceramic", "youngs_modulus": 7.5e10}, "loss_factor")
    assert own == dataclasses.replace(material("ceramic", "loss_factor"), youngs_modulus=7.5e10)
    damped = own_material({"base": "ceramic", "alpha": 1.0, "beta": 1e-8}, "loss_factor")
    assert damped == dataclasses.replace(material("ceramic"), alpha=1.0, beta=1e-8)
    # as JSON and YAML give it back
    listed = own_material({"base": "wood", "loss_factor": [[100, 0.01]]})
    assert Material("wood", **listed.properties()) == listed


@pytest.mark.parametrize(
    ("described", "message"),
    [
        ({"youngs_modulus": 7e10}, "unknown material ''"),
        ({"base": "gold"}, "unknown material 'gold'"),
        ({"base": "wood", "young": 1e9}, "unknown property 'young': expected base or one of density"),
        ({"base": "wood", "name": "oak"}, "unknown property 'name'"),
        ({"base": "wood", "density": -1.0}, "density is -1.0, expected a positive number"),
        ({"base": "wood", "alpha": 0.0, "beta": 0.0}, "an undamped object rings for ever; give alpha, beta"),
    ],
)
def test_a_material_of_its_own_that_is_none_is_refused(described, message):
    with pytest.raises(ObjectFolderError, match=message):
        own_material(described)


def test_rayleigh_damping_is_half_of_alpha_and_beta_times_the_eigenvalue():
    """Steel of Table 1 at 1 kHz: (5 + 3e-8 (2 pi 1000)^2) / 2 = 3.0922 per second."""
    assert material("steel").damping(np.array([(2 * np.pi * 1000) ** 2])) == pytest.approx(3.09218, rel=1e-5)
    assert material("wood").damping(np.zeros(1)) == pytest.approx(30)


@pytest.mark.parametrize("number", [np.array(7850.0), np.float32(7850), torch.tensor(7850.0), 7850])
def test_a_number_of_any_kind_makes_the_same_material(number):
    steel = dataclasses.replace(material("steel"), density=number)
    assert steel == material("steel")
    assert hash(steel) == hash(material("steel"))
