import numpy as np
import pytest
import torch
import trimesh
from scipy.special import spherical_jn, spherical_yn

from objectfolder.sound.click import AIR_DENSITY, SOUND_SPEED, Recoil, added_mass, recoil_pressure
from objectfolder.sound.synthesis import response_at, responses

RADIUS, MASS, CONTACT = 0.03, 0.05, 1e-4
SPHERE = Recoil(MASS, np.zeros(3), np.eye(3), np.full(3, RADIUS))
UP = np.array([[0.0, 0.0, 2.0]])


@pytest.mark.parametrize(("distance", "angle"), [(0.05, 0.0), (0.3, 1.0), (2.0, 2.5)])
def test_a_sphere_recoils_as_the_exact_field_of_an_oscillating_sphere(distance, angle):
    """Spectrum of the pulse against spherical Hankel functions, to ka = 8."""
    rate, samples = 400_000, 1 << 13
    listener = distance * np.array([[np.sin(angle), 0.0, np.cos(angle)]])
    sound = recoil_pressure(SPHERE, UP, listener, rate, samples, CONTACT)[0].astype(np.float64)
    hertz = np.fft.rfftfreq(samples, 1 / rate)[1:]
    hertz = hertz[2 * np.pi * hertz * RADIUS / SOUND_SPEED < 8]
    found = np.fft.rfft(sound)[1 : len(hertz) + 1] / rate
    k = 2 * np.pi * hertz / SOUND_SPEED

    def hankel(x, derivative=False):
        return spherical_jn(1, x, derivative) + 1j * spherical_yn(1, x, derivative)

    # Pulse of unit impulse, and the body's speed; exp(-i omega t), as of outgoing waves exp(i k r).
    pulse = np.cos(np.pi * hertz * CONTACT) / (1 - (2 * hertz * CONTACT) ** 2)
    pulse = pulse * np.exp(1j * np.pi * hertz * CONTACT)
    speed = UP[0, 2] / MASS * pulse / (-2j * np.pi * hertz)
    exact = 1j * AIR_DENSITY * SOUND_SPEED * speed * np.cos(angle) * hankel(k * distance)
    exact = exact / hankel(k * RADIUS, True) * np.exp(-1j * k * (distance - RADIUS))
    np.testing.assert_allclose(found.conj(), exact, atol=2e-3 * np.abs(exact).max())


def test_sound_comes_after_the_time_it_needs():
    rate, place = 96000, [[0.0, 0.0, 1.0]]
    now, later = (recoil_pressure(SPHERE, UP, place, rate, 2000, CONTACT, delay=d)[0] for d in (False, True))
    lag = (1 - RADIUS) / SOUND_SPEED * rate
    assert not later[: int(lag)].any()
    expected = np.interp(np.arange(300, 600) - lag, np.arange(2000), now)
    np.testing.assert_allclose(later[300:600], expected, atol=0.02 * np.abs(now).max())


def test_added_mass_of_a_sphere_a_disc_and_a_cylinder():
    np.testing.assert_allclose(added_mass(np.ones(3)), 0.5)
    radius, thin = 2.0, 1e-5
    disc = added_mass(np.array([radius, radius, thin]))
    assert disc[2] * 4 / 3 * np.pi * radius**2 * thin == pytest.approx(8 / 3 * radius**3, rel=1e-4)
    assert disc[:2].max() < 1e-4
    np.testing.assert_allclose(added_mass(np.array([1.0, 1.0, 1e4])), [1, 1, 0], atol=1e-6)


def test_the_shape_of_a_body_is_that_of_its_hull():
    ball = trimesh.creation.icosphere(4, RADIUS)
    found = Recoil.of(ball.vertices + np.array([1.0, 2.0, 3.0]), MASS)
    np.testing.assert_allclose(found.radii, RADIUS, rtol=5e-3)
    np.testing.assert_allclose(found.centre, [1, 2, 3], atol=1e-6)
    turned = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    plate = trimesh.creation.box((0.2, 0.1, 0.01)).vertices
    flat = Recoil.of(plate @ turned.T, MASS)
    assert abs(flat.axes[flat.radii.argmax()] @ turned[:, 2]) == pytest.approx(1)  # it pushes most air
    square_on, edge_on = (
        recoil_pressure(flat, [turned[:, i]], [10 * turned[:, i]], 16000, 2000, 0.1)[0] for i in (2, 0)
    )
    moments = np.sort(flat.radii**3)
    assert np.abs(square_on).max() / np.abs(edge_on).max() == pytest.approx(moments[2] / moments[0], rel=0.01)


@pytest.mark.parametrize("contact", [0.0, 3e-4])
@pytest.mark.parametrize(("order", "response"), [(0, "displacement"), (1, "velocity")])
def test_a_response_at_any_time_is_that_of_the_samples(contact, order, response):
    w, c = torch.tensor([3000.0, 40000.0]).double(), torch.tensor([50.0, 40000.0]).double()
    sampled = responses(w, c, 48000, range(200), response, contact)
    s = torch.complex(-c, w)[:, None]
    anywhere = response_at(s, torch.arange(-5, 200).double() / 48000, contact, order)
    assert not anywhere[:, :5].any()
    np.testing.assert_allclose(anywhere[:, 5:], sampled, atol=1e-6 * float(sampled.abs().max()))
