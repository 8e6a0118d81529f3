"""What `pack` says in the header."""

import numpy as np
import pytest
from refusals import refused
from solids import box

from objectfolder.mesh.normalize import mass_properties
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.packing import ESTIMATING, certainty, pack_object_file
from objectfolder.sound.fem.certainty import CUT_CELLS


@pytest.mark.parametrize(
    ("error", "element", "modes", "said"),
    [
        (0.02, CUT_CELLS, 9, {"frequency_uncertainty": 0.02}),
        (None, CUT_CELLS, 9, {"frequency_uncertainty_unknown": True}),
        (None, CUT_CELLS, 0, {}),
        (None, "tet10", 9, {}),
    ],
)
def test_an_error_that_cells_could_not_estimate_is_said_to_be_unknown(error, element, modes, said):
    report = {"frequency_uncertainty": error, "element": element, "modes": modes}
    assert certainty(report) == said
    assert certainty(report | {"uncertain": True}) == (said | {"uncertain": True} if said else {})
    assert ESTIMATING == CUT_CELLS


def packed(**options):
    """Header and tensors of a cube of 10 cm and nothing else."""
    properties = {"density": 1000.0, "youngs_modulus": 1e9, "poisson_ratio": 0.3, "alpha": 0.0, "beta": 0.0}
    modal = {"material": "wood", "material_properties": properties, "scale_m": 0.1}
    source = {"source_centre": [0, 0, 0], "source_size": 1.0, "source_up": "z"}
    normalize = source | {"solid": mass_properties(box((1, 1, 1)))}
    sdf = {"values": np.zeros((4, 4, 4), np.int8), "band": np.float64(0.1)}
    nets = {sense: ({}, {"kind": "none"}) for sense in ("vision", "audio", "touch")}
    return pack_object_file("cube", modal, normalize, sdf, nets, {}, **options)


def test_a_mass_is_one_more_field_of_the_header():
    (header, tensors), (weighed, same) = packed(), packed(mass=0.2)
    assert "mass" not in header
    assert weighed == header | {"mass": 0.2}
    assert {name: value.tobytes() for name, value in same.items()} == {
        name: value.tobytes() for name, value in tensors.items()
    }


@pytest.mark.parametrize(
    ("mass", "said"),
    [
        (
            200.0,
            r"in its volume of 1000 cm³ a density of 2e\+05 kg/m³, .* kilograms: 0\.2 for 200 g, or check",
        ),
        (
            0.0009,
            r"in its volume of 1000 cm³ a density of 0\.9 kg/m³, expected 1 to 25,000; give kilograms, or",
        ),
    ],
)
def test_a_mass_that_no_body_of_the_volume_has_is_refused(mass, said):
    refused(f"cube: mass is {mass:g} kg, {said}", packed, mass=mass)


@pytest.mark.parametrize("mass", [0, -1, "heavy", True, 1e7])
def test_a_header_with_an_impossible_mass_is_refused(brick, mass):
    refused(r"brick: mass: ", ObjectFile, brick.header | {"mass": mass}, brick.tensors, "brick")


def test_a_mass_needs_the_solid_that_it_fills(brick):
    header = {name: value for name, value in brick.header.items() if name != "solid"}
    refused("'solid' is a dependency of 'mass'", ObjectFile, header | {"mass": 0.1}, brick.tensors)


def test_no_sound_depends_on_the_mass(brick):
    real = ObjectFile(brick.header | {"mass": 0.01}, brick.tensors)
    points, listener = brick.sample_surface(4, seed=0), [0.5, 0.1, 0.3]
    for options in (
        {},
        {"listener": listener},
        {"striker": "steel"},
        {"material": "steel", "scale": 0.2},
    ):
        struck = points * options.get("scale", brick.scale) / brick.scale
        sounds = [file.impact(struck, [0, 0, 1.0], 48000, 0.1, **options) for file in (brick, real)]
        assert sounds[0].any()
        assert sounds[0].tobytes() == sounds[1].tobytes()
    assert brick.voice(48000).weights(listener).tobytes() == real.voice(48000).weights(listener).tobytes()
