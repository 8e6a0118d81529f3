import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from scipy.integrate import solve_ivp

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sound.synthesis import gains, is_audible, sinusoid_bank

RATE = 16000


def mode(hertz, damping) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor([2 * np.pi * hertz]), torch.tensor([float(damping)])


@settings(max_examples=30, deadline=None)
@given(st.floats(50, 7900), st.floats(0.5, 200))
def test_a_mode_is_its_closed_form(hertz, damping):
    w, c = mode(hertz, damping)
    t = np.arange(RATE) / RATE
    exact = np.exp(-c.item() * t) * np.sin(w.item() * t) / w.item()
    np.testing.assert_allclose(sinusoid_bank(w, c, RATE, 1.0)[0], exact, atol=1e-6 / w.item())


# Strikes of finite duration

CONTACTS = [
    # Hz, decay rate, contact time: short, in tune with the mode, long, strongly damped, longer than the sound
    (440.0, 3.0, 2e-4),
    (2000.0, 40.0, 1 / 4000),
    (1000.0, 1e-9, 1 / 2000),
    (1500.0, 10.0, 4e-3),
    (700.0, 4000.0, 1e-3),
    (300.0, 20.0, 0.03),
]
RESPONSES = ("displacement", "velocity", "acceleration")


def integrated(w, c, contact, times):
    """Displacement, velocity and acceleration of one mode, by numerical integration in two pieces."""

    def force(t):
        return np.pi / (2 * contact) * np.sin(np.pi * t / contact) if t < contact else 0.0

    def motion(t, y, push):
        return [y[1], push(t) - 2 * c * y[1] - (w * w + c * c) * y[0]]

    end = times[-1]
    state, answers = [0.0, 0.0], []
    for start, stop, push in ((0.0, min(contact, end), force), (contact, end, lambda t: 0.0)):
        if start < stop:
            options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-16, "dense_output": True}
            solved = solve_ivp(motion, (start, stop), state, args=(push,), **options)
            state = solved.y[:, -1]
            inside = times[(times >= start) & ((times < stop) | (times == end) & (stop == end))]
            y, v = solved.sol(inside)
            a = [motion(t, (p, q), push)[1] for t, p, q in zip(inside, y, v)]
            answers.append(np.stack([y, v, np.array(a)]))
    return np.concatenate(answers, 1)


@pytest.mark.parametrize(("hertz", "damping", "contact"), CONTACTS)
def test_a_contact_is_the_solution_of_the_equation_of_motion(hertz, damping, contact):
    rate = 48000
    w, c = (x.double() for x in mode(hertz, damping))
    times = np.arange(960) / rate
    assert (times < contact).sum() > 5
    exact = integrated(w.item(), c.item(), contact, times)
    for response, expected in zip(RESPONSES, exact):
        answer = sinusoid_bank(w, c, rate, 0.02, response, contact)[0]
        np.testing.assert_allclose(answer, expected, atol=3e-7 * np.abs(expected).max(), err_msg=response)


@pytest.mark.parametrize("response", RESPONSES)
def test_a_contact_in_tune_with_an_undamped_mode_stays_finite(response):
    w = torch.tensor([2 * np.pi * 1000], dtype=torch.float64)
    none = torch.zeros(1, dtype=torch.float64)
    at, near = (sinusoid_bank(w, none, 48000, 0.01, response, t)[0] for t in (5e-4, 5e-4 * (1 + 1e-9)))
    assert torch.isfinite(at).all()
    np.testing.assert_allclose(at, near, atol=1e-6 * at.abs().max().item())


@pytest.mark.parametrize("response", RESPONSES)
def test_a_vanishing_contact_is_an_impulse(response):
    """A symmetric pulse acts like an impulse at half its duration, to second order."""
    w, c = torch.tensor([2 * np.pi * 300, 2 * np.pi * 5000]), torch.tensor([5.0, 80.0])
    impulse = sinusoid_bank(w, c, RATE, 0.1, response)
    for contact in (1e-9, 1e-30, 1e-300):
        bank = sinusoid_bank(w, c, RATE, 0.1, response, contact)
        np.testing.assert_allclose(bank[:, 1:], impulse[:, 1:], atol=1e-4 * impulse.abs().max().item())
        if response != "velocity":  # which jumps at an impulse
            assert bank[:, 0].abs().max() <= impulse[:, 0].abs().max() + 1e-6


def test_modes_at_or_above_nyquist_are_silent_and_never_alias():
    w = 2 * np.pi * torch.tensor([7990.0, 8000.5, 9000.0, 16100.0])
    c = torch.full((4,), 5.0)
    for response in ("displacement", "velocity", "acceleration"):
        bank = sinusoid_bank(w, c, RATE, 0.5, response)
        assert bank[0].abs().max() > 0
        assert not bank[1:].any()
    assert is_audible(w, RATE).tolist() == [True, False, False, False]
    assert is_audible(w, 44100).all()


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
        (RATE, 0.0, "velocity", "must be positive"),
        (RATE, 1e-5, "velocity", r"duration is 1e-05 s, expected at least one sample of 6.25e-05 s at 16000"),
        (math.nan, 1.0, "velocity", "expected a finite number"),
        (RATE, math.inf, "velocity", "expected a finite number"),
    ],
)
def test_nonsense_is_refused(rate, duration, response, message):
    refused(message, sinusoid_bank, *mode(440, 3), rate, duration, response)


@pytest.mark.parametrize("contact", [-1e-3, math.nan, math.inf, -math.inf])
def test_a_contact_time_must_be_a_duration(contact):
    expected = rf"contact time is {contact}( s, expected 0 or more|, expected a finite)"
    with pytest.raises(ObjectFolderError, match=expected):
        sinusoid_bank(*mode(440, 3), contact_time=contact)
