import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from objectfolder.sound.scrape import Scrapes, scrape_force
from objectfolder.sound.stream import ModalStream, Pulse, pulse_gain
from objectfolder.sound.synthesis import pulse_phasor, responses

RATE = 48000
ANGULAR = 2 * np.pi * np.array([440.0, 1900.0, 5120.0, 19000.0])
DAMPING = np.array([3.0, 8.0, 40.0, 300.0])
POLES = -DAMPING + 1j * ANGULAR
GAINS = np.array([1.0, -0.7, 0.4, 0.3])


def _stream(poles, weights, longest, accelerated=0):
    stream = ModalStream([poles], RATE, longest, [accelerated])
    stream.listen(0, weights)
    return stream


def _strike(duration, start, sizes):
    stream = _stream(POLES, 1 / ANGULAR, max(sizes))
    stream.strike(0, Pulse(start, duration * RATE, GAINS))
    return np.concatenate([stream.play(size) for size in sizes])


@pytest.mark.parametrize(
    "duration", [1e-5, 2.6e-4, 4e-3, np.pi / ANGULAR[2]], ids=["tiny", "short", "long", "in tune"]
)
def test_a_pulse_sounds_as_the_offline_synthesis_says(duration):
    """Shorter than a sample, longer than a block, and in resonance with a mode."""
    sizes = [96] * 20
    heard = _strike(duration, 130, sizes)
    expected = GAINS @ responses(
        torch.from_numpy(ANGULAR), torch.from_numpy(DAMPING), RATE, range(1790), "displacement", duration
    ).double().numpy()  # fmt: skip
    assert not heard[:130].any()
    assert abs(heard[130:] - expected).max() < 1e-6 * abs(expected).max()


@pytest.mark.parametrize("end", [64.4, 95.0, 95.3, 95.999, 96.0, 96.2])
@pytest.mark.parametrize("sizes", [[96] * 10, [1, 49, 2, 300, 8, 600]])
def test_blocks_do_not_matter_wherever_a_pulse_ends(end, sizes):
    whole, parts = (_strike((end - 50) / RATE, 50, blocks) for blocks in ([960], sizes))
    assert abs(whole - parts).max() < 1e-10 * abs(whole).max()


def test_a_constant_force_bends_a_mode_by_its_stiffness():
    """The displacement under a force F is F g / w0^2."""
    poles = np.array([-4000 + 2j * np.pi * 3000])
    stream = _stream(poles, 1 / poles.imag, 480)
    for _ in range(4):
        stream.shake(np.array([0]), np.full((1, 480), 2.0), np.array([[0.5]]))
        heard = stream.play(480)
    assert heard[-1] == pytest.approx(2.0 * 0.5 / abs(poles[0]) ** 2, rel=0.02)


def test_a_constant_force_is_not_heard_of_modes_heard_by_their_acceleration():
    """It bends them; then they are at rest."""
    poles = np.array([-4000 + 2j * np.pi * 3000, -5000 + 2j * np.pi * 9000])
    heard = []
    for accelerated in (0, 2):
        weights = np.array([0.6 + 0.8j, -1.0 + 0.3j]) * poles**2 / poles.imag
        stream = _stream(poles, weights, 480, accelerated)
        for _ in range(4):
            stream.shake(np.array([0]), np.full((1, 480), 2.0), np.array([[0.5, 0.2]]))
            last = stream.play(480)[-1]
        heard.append(abs(last))
    assert heard[1] < 1e-9 * heard[0]


def test_a_strike_leaves_the_energy_of_its_phasors():
    stream = _stream(POLES.real * 0 - 1e-6 + 1j * ANGULAR, np.ones(4), 480)
    stream.strike(0, Pulse(0, 2e-4 * RATE, GAINS))
    stream.play(480)
    expected = abs(GAINS * pulse_gain(1j * ANGULAR - 1e-6, 2e-4)) ** 2 / 2
    assert stream.energy[0] == pytest.approx(expected, rel=1e-6)


def test_the_gain_of_a_pulse_is_that_of_the_synthesis():
    expected = pulse_phasor(torch.from_numpy(POLES)[:, None], torch.ones(1, dtype=torch.float64), 3e-4)[:, 0]
    assert pulse_gain(POLES, 3e-4) == pytest.approx(expected.numpy(), rel=1e-12)


def test_weights_change_linearly_over_a_block():
    def rung(before, after):
        stream = _stream(POLES, before, 96)
        stream.strike(0, Pulse(0, 5.0, GAINS))
        stream.play(96)
        stream.listen(0, after)
        return stream.play(96)

    one, two = np.full(4, 1.0 + 0j), np.full(4, -2.0 + 1j)
    share = np.arange(1, 97) / 96
    first, last = rung(one, one), rung(two, two)
    assert rung(one, two) == pytest.approx(first + share * (last - first), abs=1e-12)


def test_an_empty_block_changes_nothing():
    def played(sizes):
        stream = _stream(POLES, np.ones(4), 96)
        stream.strike(0, Pulse(30, 40.5, GAINS))
        parts = []
        for k, size in enumerate(sizes):
            stream.shake(np.array([0]), np.full((1, size), 0.1), GAINS[None])
            stream.listen(0, np.full(4, 1.0 + 1j * (k == len(sizes) - 1)))
            parts.append(stream.play(size))
        return np.concatenate(parts)

    expected = played([96, 96]).tobytes()
    assert played([96, 0, 96]).tobytes() == expected
    assert played([0, 96, 0, 0, 96]).tobytes() == expected


def test_what_is_not_heard_any_more_stops():
    stream = _stream(np.array([-2000 + 2j * np.pi * 1000]), np.ones(1), 4800)
    stream.strike(0, Pulse(0, 5.0, np.array([1e-3])))
    stream.play(4800)
    assert not stream.sounds.any()
    assert not stream.play(100).any()


@pytest.mark.parametrize("together", [(0, 1, 2), (1,), (2, 0)])
def test_bodies_sound_together_as_the_sum_of_each(together, rng):
    """Of other numbers of modes, silent ones among them, and with weights that change for some."""
    poles = [POLES, POLES[:1], POLES[1:3]]
    weights = [rng.normal(size=len(row)) + 1j * rng.normal(size=len(row)) for row in poles]
    forces = rng.normal(size=(3, 2, 96))

    def played(bodies):
        stream = ModalStream([poles[body] for body in bodies], RATE, 96, bodies)
        heard = []
        for block in range(4):
            for row, body in enumerate(bodies):
                stream.listen(row, weights[body] * (1 + body * block))
                if body not in together:
                    continue
                if block == 1:
                    stream.strike(row, Pulse(130 + body, 20.5, GAINS[: len(poles[body])]))
                if block > 1 and body:
                    gains = np.zeros((body, stream.modes))
                    gains[:, : len(poles[body])] = GAINS[: len(poles[body])]
                    stream.shake(np.full(body, row), forces[body, :body], gains)
            heard.append(stream.play(96))
        return np.concatenate(heard), stream.phasors

    whole, phasors = played([0, 1, 2])
    each = [played([body]) for body in range(3)]
    total = sum(sound for sound, _ in each)
    assert abs(total).max() > 0
    assert whole == pytest.approx(total, abs=1e-12 * abs(total).max())
    for row, (_, alone) in zip(phasors, each):
        assert row[: alone.shape[1]] == pytest.approx(alone[0], abs=1e-12)
        assert not row[alone.shape[1] :].any()


def test_noise_does_not_depend_on_blocks():
    one, many = Scrapes(np.random.default_rng(1)), Scrapes(np.random.default_rng(1))
    blocks = [many.play(size, {"a": 0.01})[0] for size in (100, 0, 99, 1, 200)]
    assert one.play(400, {"a": 0.01})[0] == pytest.approx(np.concatenate(blocks))


def test_noise_of_a_contact_is_that_of_a_filter_of_first_order():
    drawn = np.random.default_rng(1).standard_normal((2, 400))
    noise = Scrapes(np.random.default_rng(1)).play(400, {"a": 0.01, "b": 0.2})
    for row, white, cutoff in zip(noise, drawn, (0.01, 0.2)):
        keep = np.exp(-2 * np.pi * cutoff)
        size = np.sqrt((1 + keep) / (1 - keep))
        assert row == pytest.approx(lfilter([1 - keep], [1, -keep], size * white), abs=1e-12)


def test_a_contact_that_ended_begins_anew():
    def last(between):
        scrapes = Scrapes(np.random.default_rng(1))
        scrapes.play(100, {"a": 1e-4})
        for cutoffs in between:
            scrapes.play(0 if cutoffs else 100, cutoffs)
        return scrapes._last

    assert last([{"a": 1e-4}]) == last([]) != {}
    assert last([{}]) == {}


def test_faster_slides_are_brighter_and_rolling_is_quieter():
    slow, fast, rolls = (
        scrape_force(2.0, slip, roll, 1e-6, 0.005, 1e10) for slip, roll in ((0.1, 0), (1.0, 0), (0, 1.0))
    )
    assert fast[1] == pytest.approx(10 * slow[1])
    assert fast[0] == slow[0]
    assert rolls[0] == pytest.approx(0.1 * fast[0])
    assert scrape_force(2.0, 1.0, 0, 1.0, 0.005, 1e10)[0] == 2.0  # never more than the load
