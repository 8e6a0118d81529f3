"""Modes that ring on from block to block: the sound of one body while a simulation runs.

A mode with the pole s = -c + i w is a phasor z with z' = s z + g f(t), where f is a force and g its gain; it
is heard as the imaginary part of a complex weight times z. Of modes that are heard by their acceleration, the
force itself is heard, too (`objectfolder.audio.synthesis.pressing`). Between samples, phasors are advanced
exactly. A half sine of force is the sum of two sinusoids that begin half a period apart and cancel after the
second,

    f(t) = F sin(W (t - t0)) [t > t0] + F sin(W (t - t1)) [t > t1],    W = pi / T,  F = pi / (2 T),

with t1 = t0 + T. A sinusoid that begins leaves each mode with the free phasor F W / (W^2 + s^2), and a forced
part in which all modes move alike. So a pulse costs the same whatever its duration, and lasts over any number
of blocks.
"""

import math
from dataclasses import dataclass

import numpy as np

from objectfolder.audio.synthesis import pressing

QUIET = 2e-9  #: sound below which a body is silent, Pa; 80 dB under the threshold of hearing


@dataclass(frozen=True)
class Pulse:
    """A half sine of force that lasts some while."""

    start: int  #: sample at which it begins
    duration: float  #: samples
    gains: np.ndarray  #: impulse times the modes' shapes; (M,)


class ModalStream:
    """Modes of one body, played block by block.

    Parameters
    ----------
    poles : (M,) complex array
        -c + i w of each mode, 1/s.
    sample_rate : float
        Hz.
    longest : int
        Samples of the longest block.
    accelerated : int
        How many of the first modes are heard by their acceleration; the others by displacement and velocity.

    Attributes
    ----------
    phasors : (M,) complex array
        Of the modes at the next sample, of all that began before.
    clock : int
        Number of the next sample.
    """

    def __init__(self, poles: np.ndarray, sample_rate: float, longest: int, accelerated: int = 0):
        self._step = np.asarray(poles, np.complex128) / sample_rate  # exponent of a sample
        self._rate, self._accelerated = sample_rate, accelerated
        self._powers = np.exp(self._step[:, None] * np.arange(longest + 1))
        #: the imaginary part of a phasor times these rows is its sound; (2 M, longest)
        self._table = np.concatenate([self._powers.imag, self._powers.real])[:, :longest].copy()
        self.reset()

    def reset(self) -> None:
        """Fall silent, and start to count samples anew."""
        self.phasors = np.zeros(len(self._step), np.complex128)
        self.clock = 0
        self._weights: np.ndarray | None = None
        self._pulses: list[Pulse] = []
        self._shaking: list[tuple[np.ndarray, np.ndarray]] = []

    @property
    def sounds(self) -> bool:
        """Whether anything is to be heard."""
        return bool(self._pulses or self._shaking or self.phasors.any())

    @property
    def energy(self) -> np.ndarray:
        """Energy of each mode, J, once pulses have ended; (M,)."""
        return abs(self.phasors) ** 2 / 2

    def strike(self, pulse: Pulse) -> None:
        """Apply a pulse of force that begins in a later block, or in the next."""
        self._pulses.append(pulse)

    def shake(self, forces: np.ndarray, gains: np.ndarray) -> None:
        """Apply a force (samples,), N, to the next block, with gains (M,) of the modes per newton second."""
        self._shaking.append((np.asarray(forces, np.float64), gains))

    def play(self, samples: int, weights: np.ndarray) -> np.ndarray:
        """Return the next samples of sound, heard with weights (M,) at their end.

        Over the block, weights change linearly from those of the block before. An empty block changes
        nothing.
        """
        if not self.sounds:
            self.clock += samples
            self._weights = None
            return np.zeros(samples)
        if not samples:  # weights and pulses wait for the next block
            self._shaking = []
            return np.zeros(0)
        before = weights if self._weights is None else self._weights
        ears = weights[None] if before is weights else np.stack([before, weights])
        heard = self._ring(ears, self.phasors, 0, samples)
        phasors = self.phasors * self._powers[:, samples]
        for forces, gains in self._shaking:
            answer = self._ring(ears, gains / self._rate, 0, samples)
            heard += np.stack([np.convolve(forces, row)[:samples] for row in answer])
            heard += np.outer(self._pushed(ears, gains / self._rate), forces)
            phasors += gains / self._rate * (self._powers[:, samples:0:-1] @ forces)
        end, left = self.clock + samples, []
        for pulse in self._pulses:
            phasors += self._pulsed(pulse, ears, heard)
            if math.ceil(pulse.start + pulse.duration) >= end:  # its last edge is on a later sample
                left.append(pulse)
        self._pulses, self._shaking, self.clock = left, [], end
        self.phasors, self._weights = phasors, weights
        if not left and abs(phasors) @ abs(weights) < QUIET:
            self.phasors = np.zeros_like(phasors)
        if len(heard) == 1:
            return heard[0]
        share = np.arange(1, samples + 1) / samples
        return heard[0] + share * (heard[1] - heard[0])

    def _ring(self, ears: np.ndarray, phasors: np.ndarray, first: int, samples: int) -> np.ndarray:
        """Return the sound of phasors from sample ``first`` of a block on; (ears, samples - first)."""
        heard = ears * phasors
        return np.concatenate([heard.real, heard.imag], 1) @ self._table[:, : samples - first]

    def _pushed(self, ears: np.ndarray, gains: np.ndarray) -> np.ndarray:
        """Return how a force is heard while it shakes modes; (ears,), per unit of force.

        It cancels what modes sound of a force that does not change: bent and at rest, they move no air.
        """
        part = slice(self._accelerated)
        bent = gains[part] / -np.expm1(self._step[part])  # phasors, after long
        return -(ears[:, part] * bent).imag.sum(1)

    def _pulsed(self, pulse: Pulse, ears: np.ndarray, heard: np.ndarray) -> np.ndarray:
        """Add a pulse to a block of sound (ears, samples); return what it adds to the phasors at its end."""
        samples = heard.shape[1]
        turn = math.pi / pulse.duration  # of the force, per sample
        size = turn / 2 * pulse.gains  # impulse response of phasors: force per sample times gain
        s, added = self._step, np.zeros(len(self._step), np.complex128)
        edges = (pulse.start - self.clock, pulse.start + pulse.duration - self.clock)
        for edge in edges:
            first = math.ceil(edge)
            if 0 <= first < samples:
                free = size * turn / (turn**2 + s**2) * np.exp(s * (first - edge))
                heard[:, first:] += self._ring(ears, free, first, samples)
                added += free * self._powers[:, samples - first]
        low, high = max(math.ceil(edges[0]), 0), min(math.ceil(edges[1]), samples)
        if low < high:
            wave = np.exp(1j * turn * (np.arange(low, high) - edges[0]))
            ahead, behind = (ears @ (size / 2j / (1j * turn + sign * s)) for sign in (-1, 1))
            heard[:, low:high] += (np.outer(ahead, wave) + np.outer(behind, wave.conj())).imag
            part = slice(self._accelerated)
            by_force, by_change = (
                (ears[:, part] * factor).imag @ size[part] for factor in pressing(s[part], pulse.duration)
            )
            heard[:, low:high] += np.outer(by_force, wave.imag) + np.outer(by_change, wave.real)
        return added


def pulse_gain(poles: np.ndarray, duration: float) -> np.ndarray:
    """Return the phasors that a half sine of unit impulse leaves, over those of an ideal impulse; (M,).

    Parameters
    ----------
    poles : (M,) complex array
        1/s.
    duration : float
        Seconds.
    """
    turn = math.pi / duration
    return turn / 2 * turn / (turn**2 + poles**2) * (1 + np.exp(poles * duration))
