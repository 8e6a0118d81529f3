import dataclasses

import numpy as np
import pytest
from refusals import refused
from scipy.integrate import solve_ivp

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import material
from objectfolder.sound.contact import Striker, contact_time, effective_modulus, hertz_time, load_striker

STEEL = 2.0e11, 0.29


@pytest.mark.parametrize(
    ("modulus", "radius", "mass", "speed"),
    [
        (effective_modulus(STEEL, STEEL), 0.0125 / 2, 0.032, 0.5),
        (2e6, 0.01, 0.02, 1.0),
        (6e10, 1e-3, 1e-4, 4.0),
    ],
)
def test_the_contact_lasts_as_long_as_two_spheres_collide(modulus, radius, mass, speed):
    """Newton's law with Hertz's force, integrated until the spheres part."""
    time = hertz_time(modulus, radius, mass, speed)
    depth = speed * time  # scales that make both unknowns of order 1
    stiffness = 4 / 3 * modulus * np.sqrt(radius * depth) * time**2 / mass

    def motion(_, state):
        return state[1], -stiffness * max(state[0], 0) ** 1.5

    def parted(_, state):
        return state[0]

    parted.terminal, parted.direction = True, -1
    collision = solve_ivp(motion, (0, 2), (0, 1), events=parted, rtol=1e-9, atol=1e-12)
    assert collision.t_events[0][0] == pytest.approx(1, rel=1e-5)
    assert collision.y_events[0][0][1] == pytest.approx(-1, rel=1e-5)  # elastic


def test_soft_light_and_slow_strikes_last_longer():
    strikers = map(load_striker, ("steel", "wood", "rubber", "finger"))
    times = [contact_time(striker, material("ceramic"), 0.3) for striker in strikers]
    assert times == sorted(times)
    assert 2e-5 < times[0] < 1e-4 < 1e-3 < times[-1] < 1e-2
    steel, soft = load_striker("steel"), material("plastic")
    assert contact_time(steel, soft, 0.3) > contact_time(steel, material("steel"), 0.3)
    slow = dataclasses.replace(steel, speed=1 / 32)
    assert contact_time(slow, soft, 0.3) == pytest.approx(2 * contact_time(steel, soft, 0.3))


def test_the_lighter_body_decides():
    striker, stuff = load_striker("wood"), material("glass")
    heavy = contact_time(striker, stuff, np.inf)
    assert contact_time(striker, stuff, 1e6) == pytest.approx(heavy)
    assert contact_time(striker, stuff, striker.mass) == pytest.approx(heavy / 2**0.4)
    assert contact_time(striker, stuff, 0.0) == 0


def test_a_striker_is_in_a_file(tmp_path):
    path = tmp_path / "spoon.yaml"
    path.write_text("{youngs_modulus: 2.0e+11, poisson_ratio: 0.29, radius: 0.005, mass: 0.01}")
    assert load_striker(path) == load_striker(str(path)) == load_striker("steel")
    for text, message in (
        ("{radius: 0.005}", "spoon.yaml holds .* expected youngs_modulus, poisson_ratio, radius, mass"),
        (path.read_text().replace("0.29", "0.7"), "spoon.yaml: striker: poisson_ratio is 0.7, expected a"),
    ):
        path.write_text(text)
        refused(message, load_striker, path)
    refused(r"gone.yaml does not exist", load_striker, "gone.yaml")


def test_a_striker_is_a_name_or_one_of_your_own():
    own = Striker(7e10, 0.33, radius=0.002, mass=0.05)
    assert load_striker(own) is own
    assert load_striker("finger") is load_striker("finger")
    refused("striker 'sword' is not one of finger, rubber, steel, wood", load_striker, "sword")


@pytest.mark.parametrize(
    "wrong",
    [{"mass": 0.0}, {"radius": -1.0}, {"poisson_ratio": 0.5}, {"speed": np.nan}, {"youngs_modulus": 0}],
)
def test_an_unphysical_striker_is_refused(wrong):
    with pytest.raises(ObjectFolderError, match=f"striker: {next(iter(wrong))} is .*, expected"):
        dataclasses.replace(load_striker("steel"), **wrong)
