"""What is heard in made recordings is what rang in them."""

import numpy as np
import pytest
from taps import MODES, RATE, taps

from objectfolder.sound.ringdown import ringdown, strikes


def heard(sounds):
    return ringdown([tap for sound in sounds for tap in strikes(sound, RATE)], RATE, highest=18000.0)


def test_frequencies_and_decay_times_are_those_of_the_recording():
    found = heard(taps(MODES, 6))
    hertz, t60 = np.array(MODES).T
    assert len(found.frequency) == len(MODES)
    np.testing.assert_allclose(found.frequency, hertz, rtol=5e-5)
    np.testing.assert_allclose(found.decay_time, t60, rtol=0.05)
    assert ((found.level > 0.005) & (found.level < 0.06)).all()


@pytest.mark.parametrize("hertz", [(1000.0, 1030.0, 1076.0), (1000.0, 1060.0, 1080.0)])
def test_a_mode_where_bands_overlap_is_found_once(hertz):
    found = heard(taps([(f, 1.0) for f in hertz], 4))
    np.testing.assert_allclose(found.frequency, hertz, rtol=1e-4)


def test_one_recording_tells_a_single_mode():
    found = heard(taps([(1000.0, 1.0)], 1))
    assert found.frequency == pytest.approx([1000.0], rel=1e-5)
    assert found.decay_time == pytest.approx([1.0], rel=0.02)


def test_more_noise_costs_modes_but_makes_none():
    hertz = np.array(MODES)[:, 0]
    for noise in (1e-3, 5e-3):
        found = heard(taps(MODES, 6, noise))
        assert 3 <= len(found.frequency) <= len(MODES)
        assert (np.abs(found.frequency[:, None] / hertz - 1).min(1) < 1e-3).all()


def test_a_ring_that_outlasts_its_recording_is_heard():
    modes = [(1300.0, 5.0), (4100.0, 2.0), (9000.0, 0.3)]
    (sound,) = taps(modes, 1, seconds=0.4)
    hum = 0.01 * np.sin(2 * np.pi * 700 * np.arange(len(sound)) / RATE)
    found = heard([sound + hum])
    np.testing.assert_allclose(found.frequency, [hertz for hertz, _ in modes], rtol=1e-4)  # and no hum
    np.testing.assert_allclose(found.decay_time, [t60 for _, t60 in modes], rtol=0.1)


def test_noise_alone_rings_not():
    noise = 0.01 * np.random.default_rng(0).standard_normal(2 * RATE)
    assert strikes(noise, RATE) == []


def test_the_click_that_ends_a_recording_costs_nothing():
    (sound,) = taps(MODES, 1)
    before = heard([sound])
    sound[-100:-60] += 0.3 * np.random.default_rng(0).standard_normal(40)
    assert len(before.frequency) == len(MODES)
    np.testing.assert_allclose(heard([sound]).frequency, before.frequency, rtol=1e-3)


def test_a_recording_too_short_to_ring_has_no_taps():
    assert strikes(np.ones(10), RATE) == []


def test_every_tap_is_long_enough_to_tell_its_modes():
    for seconds in np.arange(0.2, 0.4, 0.01):
        cut = strikes(taps(MODES, 1, seconds=seconds)[0], RATE)
        assert not cut or len(ringdown(cut, RATE, highest=18000.0).frequency) >= 3
    assert cut


def test_each_tap_of_a_recording_is_cut_out():
    parts = taps(MODES, 3, pause=0.5)
    cut = strikes(np.concatenate(parts), RATE)
    assert len(strikes(parts[0][RATE // 2 :], RATE)) == 1  # cut at the strike
    assert [len(tap) / RATE for tap in cut] == pytest.approx([1.5, 1.5, 1.5], abs=0.01)
