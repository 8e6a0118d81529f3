import dataclasses
import math

import pytest

from objectfolder.errors import ObjectFolderError
from objectfolder.materials import MATERIALS, material


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
