"""Noise of bodies that slide or roll: the force that the roughness of a contact makes as it passes.

The load presses the bodies into each other by Hertz's indentation d over a circle of radius a. A height h of
roughness changes the load by 3 h / (2 d) of it, at most by all of it. A feature shorter than the circle is
averaged out, so that at a speed v, frequencies above v / (2 pi a) fade by 6 dB per octave (after van den
Doel, Kry and Pai, FoleyAutomatic, SIGGRAPH 2001). Where bodies roll, both surfaces pass together; the force
is then taken to be a tenth of that.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

ROLLING = 0.1  #: force of a rolling contact over that of a sliding one; assumed


def scrape_force(
    load: np.ndarray,
    slip: np.ndarray,
    rolling: np.ndarray,
    rough: np.ndarray,
    radius: np.ndarray,
    modulus: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the forces of contacts' roughness, N root mean square, and the frequencies where they fade, Hz.

    Of K contacts: load, N; speeds at which surfaces slide, and at which the contact moves over them as they
    roll, m/s, one of them positive; combined roughness, m; radius and modulus of the contact, m and Pa.
    """
    depth = (9 * load**2 / (16 * radius * modulus**2)) ** (1 / 3)  # Hertz's indentation by a static load
    speed = slip + rolling
    share = (slip + ROLLING * rolling) / speed
    return share * load * np.minimum(1.5 * rough / depth, 1.0), speed / (2 * np.pi * np.sqrt(radius * depth))


class Scrapes:
    """Noise of contacts, drawn by a generator, whose filters go on from block to block."""

    def __init__(self, rng: np.random.Generator):
        self._rng = rng
        self._last: dict[Any, float] = {}

    def play(self, samples: int, cutoffs: Mapping[Any, float]) -> np.ndarray:
        """Return noise of variance 1 that fades above a frequency, in cycles per sample; (contacts, samples).

        Contacts that are not among them have ended.
        """
        if not samples or not cutoffs:
            self._last = self._last if cutoffs else {}
            return np.zeros((len(cutoffs), samples))
        keep = np.exp(-2 * np.pi * np.array([*cutoffs.values()]))[:, None]
        drawn = np.sqrt((1 + keep) / (1 - keep)) * self._rng.standard_normal((len(keep), samples))
        noise = (1 - keep) * drawn
        noise[:, :1] += keep * [[self._last.get(contact, 0.0)] for contact in cutoffs]
        reach = 1  # y[n] = x[n] + keep y[n - 1]: each pass doubles how far back the sums reach
        while reach < samples:
            noise[:, reach:] += keep**reach * noise[:, :-reach]
            reach *= 2
        self._last = dict(zip(cutoffs, noise[:, -1].tolist()))
        return noise
