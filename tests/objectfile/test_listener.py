"""Sound pressure at a listener."""

import dataclasses

import numpy as np
import pytest
from refusals import refused
from scipy.interpolate import CubicSpline

from objectfolder import ObjectFile
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material, material
from objectfolder.sound.click import recoil_pressure
from objectfolder.sound.far_field import Radiation
from objectfolder.sound.stream import ModalStream, Pulse

UP = [[0.0, 0.0, 1.0]]
AS_FAST_A_BAR = dataclasses.replace(material("plastic"), poisson_ratio=0.1)


@pytest.fixture
def struck(brick):
    return brick.sample_surface(3, seed=4)


def test_rows_are_independent_and_linear(brick, struck):
    forces = np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 2.0, 1.0]])
    places = np.array([[0, 0, 1.0], [0.5, 0.2, 0], [0, -3.0, 1.0]])
    sounds = brick.impact(struck, forces, duration=0.2, listener=places)
    assert sounds.shape == (3, 3200)
    one = brick.impact(struck[1], forces[1], duration=0.2, listener=places[1])
    np.testing.assert_array_equal(one[0], sounds[1])
    twice = brick.impact(struck, 2 * forces, duration=0.2, listener=places)
    np.testing.assert_allclose(twice, 2 * sounds, rtol=1e-5, atol=1e-6 * np.abs(sounds).max())
    around = brick.impact(struck[:1], UP, duration=0.2, listener=places)
    assert around.shape == (3, 3200)


def test_far_away_it_falls_as_one_over_the_distance(brick, struck):
    near, far = (brick.impact(struck, UP, duration=0.2, listener=[[0, r, r]])[:, 400:] for r in (10.0, 40.0))
    np.testing.assert_allclose(near, 4 * far, atol=0.02 * np.abs(near).max())


def test_the_ringing_is_that_of_the_modes(brick, struck):
    """After the click: an amplitude of gain, acceleration and the far field for each mode."""
    place, rate = np.array([[0.3, 0.4, 1.2]]), 96000
    sound = brick.impact(struck[:1], UP, rate, 0.5, contact_time=0.0, listener=place)[0, 200:]
    tuning = brick.tuning()
    s = -tuning.damping.numpy() + 1j * tuning.damped_frequency.numpy()
    gain = brick.mode_shapes(struck[:1])[0, 2]
    pressure = brick._parts.radiation.field.pressure(s.imag / 343.2, place)[0]
    time = np.arange(200, 48000)[:, None] / rate
    exact = (pressure.conj() * s**2 / s.imag * gain * np.exp(s * time)).imag.sum(1)
    np.testing.assert_allclose(sound, exact, atol=1e-3 * np.abs(exact).max())


RATE = 44100


def _ringing(brick, point, place, striker, **options):
    """Sound of the modes, without the click; (samples,)."""
    sound = brick.impact(point, UP, RATE, 0.1, striker=striker, listener=place, **options)[0]
    body = brick._parts.radiation.recoil(material("plastic").density, brick.scale)
    return sound - recoil_pressure(body, np.array(UP), place, RATE, 4410, brick.contact_time(striker))[0]


def _reference(brick, point, place, contact):
    """The modes' acceleration and their fields, both at all frequencies, as a spectrum; (samples,)."""
    over, samples = 8, 1 << 18
    tuning = brick.tuning()
    s = -tuning.damping.double().numpy() + 1j * tuning.damped_frequency.double().numpy()
    kept = s.imag < np.pi * RATE
    s, gain = s[kept], brick.mode_shapes(point)[0, 2][kept]
    pressure = brick._parts.radiation.field.pressure(s.imag / 343.2, place)[0].conj()
    time = np.arange(samples) / (over * RATE)
    force = np.where(time < contact, np.pi / (2 * contact) * np.sin(np.pi * time / contact), 0)
    w = 2 * np.pi * over * RATE * np.fft.rfftfreq(samples)
    moved = sum(-g * p * w**2 / ((1j * w - a) * (1j * w - a.conj())) for g, p, a in zip(gain, pressure, s))
    return np.fft.irfft(moved * np.fft.rfft(force), samples)[: 4410 * over : over]


@pytest.mark.parametrize("striker", ["wood", "rubber", "finger"])
def test_during_the_contact_it_is_that_of_the_modes_acceleration(brick, struck, striker):
    """Not of the force: a slow one bends the object, which moves no air."""
    place = np.array([[0.3, 0.4, 1.2]])
    contact = brick.contact_time(striker)
    sound = _ringing(brick, struck[:1], place, striker)
    expected = _reference(brick, struck[:1], place, contact)
    during = slice(0, int(contact * RATE) + 1)
    error, size = (np.sqrt(np.square(x[during]).mean()) for x in (sound - expected, expected))
    assert error < 0.2 * size


@pytest.mark.parametrize("striker", ["rubber", "finger"])
def test_a_soft_striker_makes_no_thump(brick, struck, striker):
    sound = _ringing(brick, struck[:1], np.array([[0.3, 0.4, 1.2]]), striker)
    end = int(brick.contact_time(striker) * RATE) + 1
    during, after = (np.sqrt(np.square(x).mean()) for x in (sound[:end], sound[end : 2 * end]))
    assert during < 2 * after
    power, hertz = abs(np.fft.rfft(sound)) ** 2, np.fft.rfftfreq(len(sound), 1 / RATE)
    lowest = float(brick.tuning().frequencies.min())
    assert power[hertz < lowest / 2].sum() < 0.02 * power.sum()


@pytest.mark.parametrize("contact", [0.0, 2e-4, 3e-3])
def test_a_late_sound_is_that_of_a_finer_rate(brick, struck, contact):
    """The click, too, starts between two samples."""
    place, options = [[0.3, 0.4, 1.2]], {"contact_time": contact, "delay": True}
    coarse, fine = (
        brick.impact(struck[:1], UP, rate, 0.02, listener=place, **options)[0] for rate in (48000, 480000)
    )
    np.testing.assert_allclose(coarse, fine[::10], atol=1e-5 * np.abs(fine).max())


def test_a_vanishing_contact_is_an_impulse(brick, struck):
    options = {"duration": 0.01, "listener": [[0.3, 0.4, 1.2]]}
    one, other = (brick.impact(struck, UP, **options, contact_time=t)[:, 1:] for t in (1e-300, 0.0))
    np.testing.assert_allclose(one, other, atol=1e-5 * np.abs(other).max())


@pytest.mark.parametrize("striker", ["steel", "finger"])
def test_a_stream_sounds_the_same(brick, struck, striker):
    place, contact = np.array([[0.3, 0.4, 1.2]]), brick.contact_time(striker)
    expected = brick.impact(struck[:1], UP, RATE, 0.05, striker=striker, listener=place)[0]
    voice = brick.voice(RATE)
    stream = ModalStream([voice.poles], RATE, 100, [voice.accelerated])
    stream.listen(0, voice.weights(place[0]))
    stream.strike(0, Pulse(0, contact * RATE, voice.gains(struck[:1], np.array(UP))[0]))
    heard = np.concatenate([stream.play(100) for _ in range(22)])
    np.testing.assert_allclose(heard, expected[:2200], atol=1e-5 * np.abs(expected).max())


def test_strikes_are_heard_in_batches(brick, struck, monkeypatch):
    points, listener = np.tile(struck, (4, 1)), np.array([[0, 0, 1.0 + 0.1 * n] for n in range(12)])
    options = {"duration": 0.02, "striker": "rubber", "listener": listener}
    ways = [options | {"delay": delay} for delay in (False, True)]
    whole = [brick.impact(points, UP, **way) for way in ways]
    monkeypatch.setattr("objectfolder.sound.senses._BATCH", 4)
    places, pressure = [], Radiation.pressure
    monkeypatch.setattr(
        Radiation, "pressure", lambda self, *given: places.append(len(given[1])) or pressure(self, *given)
    )
    for way, sounds in zip(ways, whole):
        np.testing.assert_array_equal(brick.impact(points, UP, **way), sounds)
    assert places == [4] * 6


def test_a_delay_is_the_time_that_sound_takes(brick, struck):
    distance, rate = 5.0, 96000
    options = {"sample_rate": rate, "duration": 0.1, "listener": [[0, 0, distance]]}
    now, later = (brick.impact(struck, UP, **options, delay=delay) for delay in (False, True))
    lag = (distance - brick._parts.radiation.field.radius) / 343.2 * rate
    assert not later[:, : int(lag)].any()
    ringing = np.arange(int(lag) + 300, 9600)
    then = CubicSpline(np.arange(9600), now, axis=1)(ringing - lag)
    np.testing.assert_allclose(later[:, ringing], then, atol=5e-3 * np.abs(then).max())


def test_a_stiff_body_sounds_of_its_recoil_alone(brick, struck):
    """Below all modes only the click is heard."""
    place = np.array([[0.1, 0.2, 0.6]])
    sound = brick.impact(struck[:1], UP, 2000, 0.1, listener=place)
    body = brick._parts.radiation.recoil(material("plastic").density, brick.scale)
    click = recoil_pressure(body, np.array(UP), place, 2000, 200, brick.contact_time())
    np.testing.assert_array_equal(sound, click)
    assert np.abs(sound).max() > 0


def test_only_what_is_silent_is_called_silent(brick, struck, caplog):
    brick.impact(struck, UP, 2000, 0.1, listener=[[0, 0, 1.0]])
    assert "silent" not in caplog.text
    assert "only the recoil is heard: none of its" in caplog.text
    brick.impact(struck, UP, 2000, 0.1)
    assert "silent" in caplog.text


def test_another_size_sounds_the_same_at_proportional_places(brick, struck):
    """Pressure per impulse falls with the third power of the size, as one over the mass."""
    own = {k: v for k, v in brick.header["material_properties"].items() if k != "loss_factor"}
    undamped = Material("own", **own | {"alpha": 1e-9, "beta": 0.0})  # none at all is refused
    options = {"contact_time": 0.0, "material": undamped}
    small = brick.impact(struck, UP, 96000, 0.1, listener=[[0.0, 0.3, 0.4]], **options)
    options |= {"scale": 2 * brick.scale, "listener": [[0.0, 0.6, 0.8]]}
    large = brick.impact(2 * struck, UP, 48000, 0.2, **options)
    np.testing.assert_allclose(8 * large, small, atol=2e-3 * np.abs(small).max())


@pytest.mark.parametrize(
    ("changed", "match"),
    [
        ({"listener": [[0, 0, 0.01]]}, "expected one outside the ball"),
        ({"listener": [[0, 0, 1e9]]}, "expected one outside the ball"),
        ({"listener": [[0, 0, np.nan]]}, "listener: row 0"),
        ({"listener": [[0, 0]]}, "listener has shape"),
        ({"listener": np.ones((2, 3))}, "points has 3 rows, listener 2"),
        ({"response": "velocity"}, "leave response out"),
        ({"material": "steel"}, "build the object in this material"),
        (
            {"material": AS_FAST_A_BAR},
            r"0\.6\d to 1\.1\d times these\. Leave listener out, or build the object in this material",
        ),
        ({"delay": 1}, "delay is of type int"),
        (
            {"points": np.zeros(3), "forces": np.ones((4, 3)), "listener": np.ones((2, 3))},
            "forces has 4 rows, listener 2",
        ),
    ],
)
def test_what_cannot_be_heard_is_refused(brick, struck, changed, match):
    asked = {"points": struck, "forces": UP, "listener": [[0, 0, 1.0]]}
    refused(match, brick.impact, **asked | changed)


def test_older_files_say_what_they_lack(brick, struck):
    header = {name: value for name, value in brick.header.items() if name != "radiation"}
    old = ObjectFile(header | {"format": "1.2"}, brick.tensors)
    assert old.impact(struck, UP, duration=0.1).shape == (3, 1600)
    refused("rebuild it", old.impact, struck, UP, listener=[[0, 0, 1]])


def test_damage_is_named(brick, struck):
    tensors = dict(brick.tensors) | {"radiation.orders": brick.tensors["radiation.orders"] + np.uint8(1)}
    with pytest.raises(ObjectFolderError, match="radiation is damaged"):
        ObjectFile(brick.header, tensors).impact(struck, UP, listener=[[0, 0, 1]])


def test_a_voice_takes_lists_and_single_rows(brick):
    voice, points = brick.voice(RATE), brick.sample_surface(2)
    both = voice.gains(points, np.tile([0.0, 0, 1], (2, 1)))
    np.testing.assert_array_equal(voice.gains(points[0].tolist(), [0, 0, 1]), both[:1])
    np.testing.assert_array_equal(voice.weights([1, 1, 1]), voice.weights(np.ones(3)))
    np.testing.assert_array_equal(voice.gains(points, [0, 0, 1]), both)
    refused("impulses", voice.gains, points, [[0, 0, np.nan]])
    refused("points has 2 rows, impulses 3", voice.gains, points, np.ones((3, 3)))
    for place in ([1, 0], [np.nan, 0, 0], np.ones((2, 3))):
        refused("place", voice.weights, place)
