"""A material fitted to recordings is the one that made them."""

import numpy as np
import pytest
from refusals import refused
from taps import MODES, RATE, taps

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import material
from objectfolder.sound.fitting import ECHO, fit_loss_factor, fit_rayleigh, fit_sound, match_modes
from objectfolder.sound.ringdown import LN_1000, Ringdown

#: Hz; of no particular object
COMPUTED = np.cumsum(np.random.default_rng(1).uniform(150, 900, 30)) + 400


@pytest.mark.parametrize("ratio", [0.83, 0.97, 1.0, 1.0235, 1.2])
def test_the_common_ratio_of_frequencies_is_found(ratio):
    rng = np.random.default_rng(2)
    rows = np.sort(rng.choice(30, 14, replace=False))
    heard = COMPUTED[rows] * ratio * (1 + 0.001 * rng.standard_normal(14))
    match = match_modes(COMPUTED, np.sort(np.append(heard, [300.0, 25000.0])))  # two that are no modes
    assert match.ratio == pytest.approx(ratio, rel=2e-3)
    assert match.stiffness == match.ratio**2
    np.testing.assert_array_equal(match.computed, rows)
    assert np.abs(match.residual).max() < 0.005
    assert match.rival < 0.6


def test_a_match_by_chance_has_rivals():
    heard = np.sort(np.random.default_rng(3).uniform(500, 15000, 8))
    assert match_modes(COMPUTED, heard).rival > 0.6


def test_two_modes_are_too_few():
    refused("only 2 of 2 heard modes are within 1%", match_modes, COMPUTED, COMPUTED[[3, 9]] * 1.01)


def rung(frequency, damping):
    return Ringdown(frequency, damping, np.ones(len(frequency)), np.zeros(len(frequency)))


def test_laws_of_damping_are_found_in_spite_of_a_mode_that_was_heard_badly():
    hertz = np.linspace(500, 15000, 24)
    angular = 2 * np.pi * hertz
    worse = np.where(np.arange(24) == 5, 4.0, 1.0)
    alpha, beta = fit_rayleigh(rung(hertz, (5.0 + 3e-8 * angular**2) / 2 * worse))
    np.testing.assert_allclose([alpha, beta], [5.0, 3e-8], rtol=0.05)
    knots = fit_loss_factor(rung(hertz, np.interp(hertz, [500, 15000], [1e-3, 2e-3]) * angular / 2 * worse))
    found = np.interp(hertz, *zip(*knots))
    np.testing.assert_allclose(found, np.interp(hertz, [500, 15000], [1e-3, 2e-3]), rtol=0.05)


@pytest.mark.parametrize("law", ["loss_factor", "rayleigh"])
def test_stiffness_and_decay_are_those_of_the_recorded_object(law):
    ceramic = material("ceramic")
    hertz, t60 = np.array(MODES).T
    computed = np.sort(np.append(hertz / 1.05**0.5, [2500.0, 7000.0, 12000.0]))
    fit = fit_sound(computed, ceramic, taps(MODES, 6), RATE, law)
    assert fit.material["base"] == "ceramic"
    assert fit.material["youngs_modulus"] == pytest.approx(1.05 * ceramic.youngs_modulus, rel=1e-3)
    assert fit.frequency_error < 1e-3
    assert len(fit.left_out) == 0
    assert fit.taps == [1] * 6
    if law == "loss_factor":
        rank = np.corrcoef(np.log(fit.decay_time), np.log(t60))[0, 1]
        assert rank > 0.9
    assert (np.abs(np.log(fit.decay_time / t60)) < np.log(3)).all()
    np.testing.assert_allclose(LN_1000 / fit.heard.damping[fit.match.heard], t60, rtol=0.05)
    assert fit.unexplained < ECHO / 5


@pytest.mark.parametrize("noise", [1e-4, 3e-3])
@pytest.mark.parametrize("t60", [0.13, 0.5])
@pytest.mark.parametrize(
    ("echoes", "flagged"),
    [
        ([], False),
        ([(0.06, 0.7), (0.13, 0.5)], True),
        ([(0.02, 0.7), (0.045, 0.5)], True),
        ([(0.03, 0.3)], True),
        ([(0.02 * n, 0.6**n) for n in range(1, 20)], True),
    ],
    ids=["clean", "two late", "two early", "one", "a row"],
)
def test_echoes_are_told(noise, t60, echoes, flagged):
    modes = [(hertz, t60) for hertz, _ in MODES]
    sounds = []
    for sound in taps(modes, 5, noise=0):
        delayed = sum(gain * np.roll(sound, round(delay * RATE)) for delay, gain in [(0, 1.0), *echoes])
        sounds.append(delayed + noise * np.random.default_rng(0).standard_normal(len(sound)))
    fit = fit_sound(np.array(MODES)[:, 0], material("ceramic"), sounds, RATE, "loss_factor")
    assert (fit.unexplained > ECHO) == flagged


def test_recordings_without_a_tap_are_refused():
    hum = 0.05 * np.sin(2 * np.pi * 500 * np.arange(RATE) / RATE)
    with pytest.raises(ObjectFolderError, match=r"no strike.*rises 10 dB within"):
        fit_sound(COMPUTED, material("steel"), [hum], RATE, "loss_factor")
