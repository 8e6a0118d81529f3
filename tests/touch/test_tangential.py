"""Shear and twist of the gel against closed forms of contact mechanics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from objectfolder.base.errors import ObjectFolderError
from objectfolder.touch import tangential
from objectfolder.touch.gel import Layer, deform
from objectfolder.touch.tangential import shear_compliance, shear_contacts, slide, spreading

RADIUS = 1e-3  # m, of the contact
MODULUS = 1.5e5  # Pa
FRICTION = 0.5
LOAD = 0.3  # N


def harmonic(phase, layer):
    """Tangential and normal displacement per shear and normal stress, by Navier's equations."""
    shear = layer.young_modulus / (2 * (1 + layer.poisson_ratio))
    lame = 2 * shear * layer.poisson_ratio / (1 - 2 * layer.poisson_ratio)
    stiff, q = lame + 2 * shear, phase / layer.thickness
    system = np.zeros((4, 4))
    system[0, 2] = system[1, 3] = 1
    system[2, 0], system[2, 3] = stiff * q * q / shear, -(lame + shear) * q / shear
    system[3, 1], system[3, 2] = shear * q * q / stiff, (lame + shear) * q / stiff
    free = expm(system * layer.thickness)[:, 2:]
    stress = np.stack([shear * (free[2] + q * free[1]), stiff * free[3] - lame * q * free[0]])
    return free[:2] @ np.linalg.inv(stress)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.48])
@pytest.mark.parametrize("phase", [0.1, 0.8, 3.0])
def test_compliances_solve_the_equations_of_elasticity(poisson, phase):
    layer = Layer(0.004, MODULUS, poisson)
    exact = harmonic(phase, layer)
    wavenumber = np.array([phase / layer.thickness])
    along, across = shear_compliance(layer, wavenumber)
    shear = MODULUS / (2 * (1 + poisson))
    assert along[0] == pytest.approx(exact[0, 0], rel=1e-9)
    assert across[0] == pytest.approx(np.tanh(phase) / (shear * wavenumber[0]), rel=1e-12)
    assert spreading(layer, wavenumber)[0] == pytest.approx(exact[0, 1], rel=1e-9)
    assert layer.compliance(wavenumber)[0] == pytest.approx(exact[1, 1], rel=1e-9)


def test_compliances_of_uniform_loads_are_those_of_a_slab():
    layer = Layer(0.004, MODULUS, 0.48)
    along, across = shear_compliance(layer, np.array([0.0, 1e-3]))
    np.testing.assert_allclose([along, across], 2 * 1.48 * 0.004 / MODULUS, rtol=1e-4)
    np.testing.assert_allclose(spreading(layer, np.array([0.0, 1e-3])), 0, atol=1e-12)


@pytest.mark.parametrize("dense", [0, 10**6])
@pytest.mark.parametrize("size", [(11, 4), (3, 30), (40, 30)])
def test_a_part_of_the_image_answers_as_the_whole(size, dense, rng, monkeypatch):
    """With small transforms as with a matrix; the image is 40 x 30 pixels, and the part anywhere in it."""
    height, width = size
    layer, pitch, shape = Layer(0.004, MODULUS, 0.48), 2e-4, (40, 30)
    traction = rng.normal(size=(2, height, width)).astype(np.float32)
    row, column = (rng.integers(whole - part + 1) for whole, part in zip(shape, size))
    window = slice(row, row + height), slice(column, column + width)
    image = np.zeros((2, *shape), np.float32)
    image[:, *window] = traction
    monkeypatch.setattr(tangential, "MAX_DENSE_PIXELS", 0)
    expected = tangential._respond(image, shape, pitch, layer)[:, *window]
    monkeypatch.setattr(tangential, "MAX_DENSE_PIXELS", dense)
    found = tangential._respond(traction, shape, pitch, layer)
    assert abs(found - expected).max() < 2e-6 * abs(expected).max()


class Hertzian:
    """A sphere's contact on a layer of six contact radii, with a grid of 24 pixels to the radius."""

    pitch = RADIUS / 24
    layer = Layer(6 * RADIUS, MODULUS, 0.48)
    shear_modulus = MODULUS / (2 * 1.48)

    def __init__(self):
        side = (np.arange(51) - 25) * self.pitch
        self.right, self.up = np.broadcast_arrays(side[None], -side[:, None])
        rest = np.maximum(1 - (self.right**2 + self.up**2) / RADIUS**2, 0)
        self.pressure = (1.5 * LOAD / (np.pi * RADIUS**2) * np.sqrt(rest)).astype(np.float32)
        self.pressure *= LOAD / (self.pressure.sum() * self.pitch**2)

    def slid(self, distance, friction=FRICTION):
        motion = np.zeros((2, 51, 51), np.float32)
        motion[0] = distance
        return slide(self.pressure, motion, friction, self.pitch, self.layer)

    def twisted(self, angle, friction):
        motion = np.stack([-angle * self.up, angle * self.right]).astype(np.float32)
        found = slide(self.pressure, motion, friction, self.pitch, self.layer)
        return (found[1] * self.right - found[0] * self.up).sum() * self.pitch**2

    def base(self):
        """Displacement per force that a half space has more than the layer, m/N, uniform over the contact."""

        def missing(q):
            along, across = shear_compliance(self.layer, np.array([q]))
            half = (1 - self.layer.poisson_ratio + 1) / (self.shear_modulus * q)
            return (half - along[0] - across[0]) * q

        return quad(missing, 1e-3, 30 / self.layer.thickness, limit=200)[0] / (4 * np.pi)


@pytest.fixture(scope="module")
def hertz():
    return Hertzian()


@pytest.mark.parametrize("part", [0.15, 0.4, 0.7, 0.9])
def test_incipient_slip_of_a_sphere_is_that_of_cattaneo_and_mindlin(hertz, part):
    """Load and stick radius at the displacement that gives a part of the sliding friction."""
    limit = FRICTION * LOAD
    compliance = 3 * limit * (2 - hertz.layer.poisson_ratio) / (16 * RADIUS * hertz.shear_modulus)
    distance = compliance * (1 - (1 - part) ** (2 / 3)) - hertz.base() * part * limit
    traction = hertz.slid(distance)
    assert traction[0].sum() * hertz.pitch**2 == pytest.approx(part * limit, rel=0.03)
    stick = np.hypot(*traction) < 0.999 * FRICTION * hertz.pressure
    radius = np.sqrt(stick.sum() * hertz.pitch**2 / np.pi)
    assert radius == pytest.approx(RADIUS * (1 - part) ** (1 / 3), abs=0.03 * RADIUS)


def test_sliding_friction_is_the_load_times_the_coefficient(hertz):
    traction = hertz.slid(5e-3)
    np.testing.assert_allclose(np.hypot(*traction), FRICTION * hertz.pressure, rtol=1e-3)
    assert traction[0].sum() * hertz.pitch**2 == pytest.approx(FRICTION * LOAD, rel=2e-3)


def test_small_twist_has_the_torque_of_reissner_and_sagoci(hertz):
    angle = 1e-3
    expected = 16 / 3 * hertz.shear_modulus * RADIUS**3 * angle
    assert hertz.twisted(angle, 1e4) == pytest.approx(expected, rel=0.05)


def test_large_twist_has_the_torque_of_sliding(hertz):
    expected = 3 * np.pi / 16 * FRICTION * LOAD * RADIUS
    assert hertz.twisted(3.0, FRICTION) == pytest.approx(expected, rel=0.01)


@pytest.fixture(scope="module")
def sensor(digit):
    return replace(digit, gel_curvature=0.0)


def distances(sensor):
    """Pixels' distances from the image's centre, m."""
    rows, columns = np.indices((sensor.height, sensor.width))
    up, right = rows - (sensor.height - 1) / 2, columns - (sensor.width - 1) / 2
    return np.hypot(up, right) * sensor.pixel_pitch


def ball(sensor):
    """Pressure of a ball of 6 mm radius, 0.5 mm deep, in the middle, and of no contact."""
    height = 5e-4 - distances(sensor) ** 2 / (2 * 6e-3)
    return deform(np.stack([height, np.full_like(height, -1e-3)]).clip(-6e-4), sensor)[1]


@pytest.fixture(scope="module")
def pressed(sensor):
    return ball(sensor)


def test_gel_follows_the_object_where_it_sticks(sensor, pressed):
    shear, twist = np.array([[1e-4, 5e-5]] * 2), np.array([0.02, 0.02])
    found = shear_contacts(pressed, shear, twist, np.full(2, 2.0), sensor)
    rest = shear_contacts(pressed, 0 * shear, 0 * twist, np.full(2, 2.0), sensor)
    moved = found.displacement[0] - rest.displacement[0]
    np.testing.assert_allclose(moved[80, 60], [1e-4, 5e-5], atol=3e-6)
    assert found.force[0, 0] > found.force[0, 1] > 0
    assert found.torque[0] > 0
    assert 0 < found.slipping[0] < 0.5
    for still in (found.force[1], found.torque[1], found.slipping[1], rest.force[0], rest.slipping[0]):
        assert not np.any(still)


def test_pressure_spreads_the_surface(sensor, pressed):
    """Markers move away from a press, symmetrically."""
    found = shear_contacts(pressed, np.zeros((2, 2)), np.zeros(2), np.full(2, 0.5), sensor).displacement[0]
    assert found[80, 80, 0] > 1e-5
    assert found[60, 60, 1] > 1e-5
    np.testing.assert_allclose(found[80, 39:59, 0][::-1], -found[80, 61:81, 0], atol=3e-6)


def test_friction_bounds_the_force_and_rows_do_not_depend_on_the_batch(sensor, pressed):
    args = np.array([[3e-3, 0.0]]), np.zeros(1), np.array([0.4]), sensor
    alone = shear_contacts(pressed[:1], *args)
    load = (pressed[0] * sensor.pixel_pitch**2).sum()
    assert alone.force[0, 0] == pytest.approx(0.4 * load, rel=1e-5)
    assert alone.slipping[0] > 0.99
    motions = np.array([[0, 0], [3e-3, 0]])
    both = shear_contacts(pressed[::-1], motions, np.zeros(2), np.full(2, 0.4), sensor)
    assert np.array_equal(both.displacement[1], alone.displacement[0])


@pytest.mark.parametrize("twist", [-0.3, 1.0, 2.0, np.pi])
def test_traction_is_at_most_friction_times_pressure_and_a_large_twist_slides(sensor, pressed, twist):
    found = shear_contacts(pressed[:1], np.zeros((1, 2)), np.array([twist]), np.array([0.4]), sensor)
    bound = 0.4 * pressed[0]
    excess = np.hypot(*found.traction[0].T).T - bound
    assert excess.max() < 1e-5 * bound.max()
    sliding = (bound * distances(sensor)).sum() * sensor.pixel_pitch**2
    assert found.torque[0] == pytest.approx(np.sign(twist) * sliding, rel=0.1 if abs(twist) < 1 else 0.01)


@pytest.mark.parametrize("twist", [0.05, 0.2, 0.5])
def test_a_sticking_gel_turns_with_the_object(sensor, pressed, twist):
    found = shear_contacts(pressed[:1], np.array([[1e-4, 0.0]]), np.array([twist]), np.array([50.0]), sensor)
    rows, columns = np.array([80, 80, 76]), np.array([60, 66, 60])
    right, up = (columns - 59.5) * sensor.pixel_pitch, (79.5 - rows) * sensor.pixel_pitch
    cos, sin = np.cos(twist) - 1, np.sin(twist)
    expected = np.stack([1e-4 + cos * right - sin * up, sin * right + cos * up], axis=1)
    np.testing.assert_allclose(found.dragged[0][rows, columns], expected, atol=4e-6)


@pytest.mark.parametrize(("height", "width"), [(161, 121), (161, 120), (322, 242)])
def test_a_twist_in_the_middle_pushes_nowhere_at_any_size(sensor, height, width):
    other = replace(sensor, height=height, width=width)
    pressure = ball(other)[:1]
    found = shear_contacts(pressure, np.zeros((1, 2)), np.array([0.1]), np.array([0.5]), other)
    load = pressure.sum() * sensor.pixel_pitch**2
    assert np.abs(found.force).max() < 1e-3 * load


def test_rigid_gel_is_refused(flat):
    with pytest.raises(ObjectFolderError, match="is rigid and cannot be sheared"):
        shear_contacts(np.zeros((1, 160, 120)), np.zeros((1, 2)), np.zeros(1), np.ones(1), flat)
