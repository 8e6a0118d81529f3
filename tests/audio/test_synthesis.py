import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from objectfolder.audio.synthesis import audible, gains, sinusoid_bank
from objectfolder.errors import ObjectFolderError

RATE = 16000


def mode(hertz, damping):
    return torch.tensor([2 * np.pi * hertz]), torch.tensor([float(damping)])


@settings(max_examples=30, deadline=None)
@given(st.floats(50, 7900), st.floats(0.5, 200))
def test_a_mode_is_its_closed_form(hertz, damping):
    w, c = mode(hertz, damping)
    t = np.arange(RATE) / RATE
    exact = np.exp(-c.item() * t) * np.sin(w.item() * t) / w.item()
    np.testing.assert_allclose(sinusoid_bank(w, c, RATE, 1.0)[0], exact, atol=1e-6 / w.item())


@pytest.mark.parametrize("damping", [1.0, 8.0, 40.0])
def test_energy_decays_at_twice_the_damping(damping):
    sound = sinusoid_bank(*mode(1000, damping), RATE, 1.0)[0].double().numpy()
    energy = (sound.reshape(-1, 160) ** 2).sum(1)  # ten periods each
    rate = -np.diff(np.log(energy[energy > 1e-12 * energy[0]])) * 100
    np.testing.assert_allclose(rate, 2 * damping, rtol=1e-3)


@pytest.mark.parametrize(("lower", "upper"), [("displacement", "velocity"), ("velocity", "acceleration")])
def test_each_response_is_the_derivative_of_the_one_before(lower, upper):
    w, c = torch.tensor([2 * np.pi * 300, 2 * np.pi * 2000]), torch.tensor([5.0, 80.0])
    rate = 1 << 20  # fine enough for differences
    low, high = (sinusoid_bank(w, c, rate, 0.01, r).double().numpy() for r in (lower, upper))
    difference = (low[:, 2:] - low[:, :-2]) * rate / 2
    np.testing.assert_allclose(difference, high[:, 1:-1], atol=2e-3 * np.abs(high).max())


def test_an_impulse_starts_with_the_velocity_of_its_momentum():
    """A unit impulse gives a mode of unit modal mass unit velocity."""
    w, c = mode(500, 30)
    assert sinusoid_bank(w, c)[0, 0] == 0
    assert sinusoid_bank(w, c, response="velocity")[0, 0] == pytest.approx(1)


def test_modes_at_or_above_nyquist_are_silent_and_never_alias():
    w = 2 * np.pi * torch.tensor([7990.0, 8000.5, 9000.0, 16100.0])
    c = torch.full((4,), 5.0)
    for response in ("displacement", "velocity", "acceleration"):
        bank = sinusoid_bank(w, c, RATE, 0.5, response)
        assert bank[0].abs().max() > 0
        assert not bank[1:].any()
    assert audible(w, RATE).tolist() == [True, False, False, False]
    assert audible(w, 44100).all()


def test_the_same_sound_at_two_rates():
    w, c = mode(440, 3)
    np.testing.assert_array_equal(sinusoid_bank(w, c, 16000)[0], sinusoid_bank(w, c, 48000)[0, ::3])


def test_gains_are_linear_in_the_force(rng):
    shapes = torch.from_numpy(rng.standard_normal((4, 3, 5)))
    a, b = (torch.from_numpy(rng.standard_normal((4, 3))) for _ in range(2))
    torch.testing.assert_close(gains(shapes, 2 * a - 3 * b), 2 * gains(shapes, a) - 3 * gains(shapes, b))
    torch.testing.assert_close(gains(shapes, torch.eye(3, dtype=torch.float64)[[1] * 4]), shapes[:, 1])


def test_no_modes_and_no_rows():
    none = torch.zeros(0)
    assert sinusoid_bank(none, none, RATE, 0.1).shape == (0, 1600)
    assert gains(torch.zeros(0, 3, 4), torch.zeros(0, 3)).shape == (0, 4)


@pytest.mark.parametrize(
    ("rate", "duration", "response", "message"),
    [
        (RATE, 1.0, "pressure", "'pressure' is not one of displacement"),
        (0, 1.0, "velocity", "must be positive"),
        (-RATE, -1.0, "velocity", "must be positive"),
        (RATE, 0.0, "velocity", "must be positive"),
    ],
)
def test_nonsense_is_refused(rate, duration, response, message):
    with pytest.raises(ObjectFolderError, match=message):
        sinusoid_bank(*mode(440, 3), rate, duration, response)
