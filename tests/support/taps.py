"""Made recordings of taps."""

import numpy as np

from objectfolder.sound.ringdown import LN_1000

RATE = 44100
#: Hz, T60 in s: two pairs of a round object, and modes of their own.
MODES = [
    (521.0, 3.0),
    (1681.0, 2.0),
    (1684.2, 1.9),
    (4160.0, 0.6),
    (4168.0, 0.5),
    (9000.0, 0.2),
    (15000.0, 0.1),
]


def taps(modes, count, noise=1e-4, seed=0, seconds=2.0, pause=0.3):
    """Recordings of one tap each, with amplitudes at random."""
    rng, time = np.random.default_rng(seed), np.arange(round(seconds * RATE)) / RATE
    sounds = []
    for _ in range(count):
        sound = np.zeros(len(time))
        for hertz, t60 in modes:
            amplitude, phase = rng.uniform(0.01, 0.05) * rng.choice([-1, 1]), rng.uniform(0, 2 * np.pi)
            sound += amplitude * np.exp(-LN_1000 / t60 * time) * np.sin(2 * np.pi * hertz * time + phase)
        before = np.zeros(round(pause * RATE))
        sound = np.concatenate([before, sound])
        sounds.append(sound + noise * rng.standard_normal(len(sound)))
    return sounds
