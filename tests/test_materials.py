import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refused

import objectfolder.base.materials
from objectfolder.base.materials import (
    LAWS,
    Material,
    friction_of,
    material,
    material_names,
    material_properties,
    own_material,
    read_material,
    roughness_of,
    stored_material,
)
from objectfolder.base.yamlfile import read_yaml
from objectfolder.stored.header import checked_name

FOLDER = Path(objectfolder.base.materials.__file__).with_suffix("")


@pytest.mark.parametrize(
    "name", [*material_names(), "unknown", "Stainless steel 304", "PVC+ABS", "a", "x_1-2.5"]
)
def test_names_of_materials_are_those_of_object_files(name):
    assert checked_name("material", name, "material") == name


def test_table_is_that_of_the_supplement():
    assert set(material_names()) == {"ceramic", "glass", "wood", "plastic", "iron", "polycarbonate", "steel"}
    assert dataclasses.astuple(material("Steel"))[:6] == ("steel", 7850, 2e11, 0.29, 5, 3e-8)


@pytest.mark.parametrize("name", material_names())
def test_materials_are_physical_and_say_where_each_number_is_from(name):
    m = material(name)
    assert 100 < m.density < 20000
    assert 1e8 < m.youngs_modulus < 1e12
    assert 0 < m.poisson_ratio < 0.5
    assert m.alpha > 0
    assert m.beta > 0
    # Sound travels at hundreds to thousands of metres per second.
    assert 500 < (m.youngs_modulus / m.density) ** 0.5 < 7000
    assert 0 < m.friction < 1
    assert 1e-7 < m.roughness < 1e-5
    path = FOLDER / f"{name}.yaml"
    assert list(read_yaml(path)["sources"]) == list(material_properties(path))


@pytest.mark.parametrize("name", ["gold", "", None, 3])
def test_an_unknown_material_lists_the_known_ones(name):
    refused(r"unknown material .*ceramic, glass", material, name)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((f, v) for f in ("density", "youngs_modulus") for v in (0.0, -1.0, math.nan, math.inf)),
        *(("poisson_ratio", v) for v in (-1.0, 0.5, 0.7, -2.0, math.nan)),
        *((f, v) for f in ("alpha", "beta", "friction") for v in (-1e-9, math.nan, math.inf)),
        *(("roughness", v) for v in (0.0, 1.0, math.nan)),
    ],
)
def test_an_unphysical_material_is_refused(field, value):
    wrong = f"material 'steel': {field} is {value}, expected a"
    refused(wrong, dataclasses.replace, material("steel"), **{field: value})


def test_auxetic_and_undamped_materials_exist():
    m = dataclasses.replace(material("steel"), poisson_ratio=-0.7, alpha=0.0, beta=0.0)
    assert m.poisson_ratio == -0.7
    assert Material("steel", 7850.0, 2e11, -0.7, friction=m.friction, roughness=m.roughness) == m
    refused("'steel': an undamped object rings for ever; give alpha", m.require_damping)
    for damping in ({"alpha": 1.0}, {"beta": 1e-8}, {"loss_factor": ((1000.0, 5e-4),)}):  # one is enough
        brass = Material("brass", 8500.0, 1.0e11, 0.34, **damping)
        brass.require_damping()
        assert (brass.damping(np.array([1e6, 1e9])) > 0).all()


def test_a_loss_factor_is_linear_between_its_knots_and_constant_beyond():
    """It is the inverse of the quality factor, which is half the angular frequency over the damping."""
    knots = ((1000.0, 0.001), (2000.0, 0.003), (8000.0, 0.002))
    loss = dataclasses.replace(material("steel"), loss_factor=knots)
    hertz = np.array([10.0, 1000.0, 1500.0, 2000.0, 5000.0, 8000.0, 20000.0])
    angular = 2 * np.pi * hertz
    found = loss.damping(torch.from_numpy(angular**2)).numpy()
    np.testing.assert_allclose(found, np.interp(hertz, *zip(*knots)) * angular / 2, rtol=1e-12)


def test_the_named_materials_differ_by_their_damping_only():
    for name in material_names():
        other = material(name, "loss_factor")
        assert (material(name).law, other.law) == ("rayleigh", "loss_factor")
        assert dataclasses.replace(other, loss_factor=()) == material(name)


FALLING = [[[1000, 0.1], [1000, 0.2]], [[2000, 0.1], [1000, 0.2]]]


@pytest.mark.parametrize("knots", [*FALLING, [[1000, 0.0]], [[1000, 1.5]], [[-1, 0.1]], [1000, 0.1]])
def test_an_unphysical_loss_factor_is_refused(knots):
    wrong = r"'steel': loss_factor is .* pairs of a frequency in Hz"
    refused(wrong, dataclasses.replace, material("steel"), loss_factor=knots)


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
    refused(message, own_material, described)


OLIVE = """
density: 990.0
youngs_modulus: 1.2e+10
poisson_ratio: 0.3
loss_factor: [[500, 0.008]]
friction: 0.55
roughness: 3.0e-6
"""


def test_a_file_of_ones_own_is_a_material(tmp_path):
    path = tmp_path / "olive_wood.yaml"
    path.write_text(OLIVE)
    olive = Material("olive_wood", 990.0, 1.2e10, 0.3, 0.0, 0.0, ((500, 0.008),), 0.55, 3e-6)
    assert own_material("olive_wood.yaml", root=tmp_path) == read_material(path) == material(path) == olive
    changed = own_material({"base": "olive_wood.yaml", "density": 900.0}, root=tmp_path)
    assert changed == dataclasses.replace(olive, density=900.0)
    both = tmp_path / "both.yaml"
    both.write_text(OLIVE + "alpha: 60.0\nbeta: 2.0e-6\n")
    assert [read_material(both, law).law for law in LAWS] == [*LAWS]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", r"olive_wood.yaml holds \[\], expected density"),
        (OLIVE.replace("friction: 0.55\n", ""), "olive_wood.yaml lacks friction; copy one of"),
        (OLIVE + "young: 3.0\n", "olive_wood.yaml: unknown 'young', expected density"),
        (OLIVE + "sources: {name: me}\n", "olive_wood.yaml: unknown 'name', expected density"),
        (OLIVE + "sources: weighed\n", "olive_wood.yaml: unknown 'sources'"),
        (OLIVE.replace("990.0", "-1"), "olive_wood.yaml: material 'olive_wood': density is -1.0"),
        (OLIVE.replace("990.0", "heavy"), "olive_wood.yaml: material 'olive_wood': density is 'heavy'"),
        (OLIVE.replace("loss_factor: [[500, 0.008]]\n", ""), "olive_wood.yaml: material .* undamped"),
    ],
)
def test_a_file_that_is_no_material_is_refused(tmp_path, text, message):
    (tmp_path / "olive_wood.yaml").write_text(text)
    refused(message, own_material, "olive_wood.yaml", root=tmp_path)


def test_a_file_must_be_there_and_have_a_name_of_its_own(tmp_path):
    refused(r"gone.yaml does not exist; expected a material's file", own_material, "gone.yaml", root=tmp_path)
    (tmp_path / "steel.yaml").write_text(OLIVE)
    refused("steel.yaml has the name of a material of the package", own_material, "steel.yaml", root=tmp_path)


def test_the_surface_of_an_older_file_is_that_of_its_materials_name():
    header = {"density": 700.0, "youngs_modulus": 1e10, "poisson_ratio": 0.2, "alpha": 1.0, "beta": 0.0}
    old = stored_material("Wood", header)
    assert (old.friction, old.roughness) == (friction_of("wood"), roughness_of("wood")) == (0.6, 5e-6)
    assert stored_material("olive", header).friction == friction_of("olive") == 0.5
    assert stored_material("wood", header | {"friction": 0.2, "newer": 1}).friction == 0.2


def test_rayleigh_damping_is_half_of_alpha_and_beta_times_the_eigenvalue():
    """Steel of Table 1 at 1 kHz: (5 + 3e-8 (2 pi 1000)^2) / 2 = 3.0922 per second."""
    assert material("steel").damping(np.array([(2 * np.pi * 1000) ** 2])) == pytest.approx(3.09218, rel=1e-5)
    assert material("wood").damping(np.zeros(1)) == pytest.approx(30)


@pytest.mark.parametrize("number", [np.array(7850.0), np.float32(7850), torch.tensor(7850.0), 7850])
def test_a_number_of_any_kind_makes_the_same_material(number):
    steel = dataclasses.replace(material("steel"), density=number)
    assert steel == material("steel")
    assert hash(steel) == hash(material("steel"))
