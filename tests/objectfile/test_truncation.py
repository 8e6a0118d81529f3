import numpy as np
import pytest

from objectfolder.materials import material
from objectfolder.nets.audio_gains import energy_weights
from objectfolder.objectfile.evaluation import evaluate_truncation
from objectfolder.objectfile.truncation import lost_energy

LIMIT, FOUND = 20000.0, 200


@pytest.fixture
def modes(rng):
    """All modes of an object, as evenly spaced as a plate's, with shapes of equal mean square."""
    return {
        "shapes": rng.standard_normal((500, 3, FOUND)).astype(np.float32),
        "damped_frequency": 2 * np.pi * (np.arange(FOUND) + 0.5) / FOUND * LIMIT,
    }


def kept(modes, count):
    return {name: value[..., :count] for name, value in modes.items()}


@pytest.mark.parametrize("law", ["rayleigh", "loss_factor"])
@pytest.mark.parametrize("count", [10, 60, 199])
def test_the_estimate_is_the_energy_that_a_reference_with_all_modes_has_more(modes, law, count):
    wood = material("wood", law)
    w = modes["damped_frequency"]
    energy = (modes["shapes"] ** 2).mean((0, 1)) * energy_weights(w, wood.damping(w**2))
    estimate = lost_energy(*kept(modes, count).values(), wood, FOUND, LIMIT)
    assert estimate == pytest.approx(energy[count:].sum() / energy.sum(), rel=0.1)


def test_no_mode_is_lost_if_all_were_kept(modes):
    report = {"count_below_max_frequency": FOUND, "max_frequency_hz": LIMIT, "truncated": False}
    report |= {"material": "wood", "material_properties": material("wood").properties()}
    assert evaluate_truncation(modes, report) == {"modes_found": FOUND, "lost_energy": 0.0}
    few = evaluate_truncation(kept(modes, 20), report | {"truncated": True})
    assert few["modes_found"] == FOUND
    assert 0 < few["lost_energy"] < 1
    assert lost_energy(*kept(modes, 0).values(), material("wood"), FOUND, LIMIT) == 0
    # Scaled from an earlier solve, which did not count them.
    assert evaluate_truncation(modes, report | {"count_below_max_frequency": None}) == {}
