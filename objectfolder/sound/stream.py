"""Modes that ring on from block to block: the sound of bodies while a simulation runs.

A mode with the pole s = -c + i w is a phasor z with z' = s z + g f(t), where f is a force and g its gain; it
is heard as the imaginary part of a complex weight times z. Of modes that are heard by their acceleration, the
force itself is heard, too (`force_factors`). Between samples, phasors are advanced
exactly. A half sine of force is the sum of two sinusoids that begin half a period apart and cancel after the
second,

    f(t) = F sin(W (t - t0)) [t > t0] + F sin(W (t - t1)) [t > t1],    W = pi / T,  F = pi / (2 T),

with t1 = t0 + T. A sinusoid that begins leaves each mode with the free phasor F W / (W^2 + s^2), and a forced
part in which all modes move alike. So a pulse costs the same whatever its duration, and lasts over any number
of blocks.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from objectfolder.sound.synthesis import force_factors

#: Sound below which a body is silent: Pa, 80 dB under the threshold of hearing; of channels, m/s^2.
SILENCE_LEVEL = 2e-9


@dataclass(frozen=True)
class Pulse:
    """A half sine of force that lasts some while."""

    start: int  #: sample at which it begins
    duration: float  #: samples
    gains: np.ndarray  #: impulse times the modes' shapes; (M,)


class ModalStream:
    """Modes of some bodies, played block by block: what is heard of all of them together.

    Poles are -c + i w of the modes of each body, (M,) complex, 1/s; ``longest`` is the number of samples of
    the longest block. The first modes of each body, as many as ``accelerated`` says, are heard by their
    acceleration; the others, by default all, by displacement and velocity. Bodies have rows of one array, so
    that a block costs about the same for ten bodies as for one: ``phasors`` (B, M) are those of the modes at
    the sample ``clock``, the next, of all that began before; 0 beyond the modes of a body. ``modes`` is M, of
    the body that has most.

    With a number of ``channels``, C, weights are (C, M) and blocks (C, samples). ``loudest``, (M,) of each
    body, is then how large weights may become: a body falls silent where nothing would be heard with these.
    """

    def __init__(
        self,
        poles: Sequence[np.ndarray],
        sample_rate: float,
        longest: int,
        accelerated: Sequence[int] | None = None,
        channels: int | None = None,
        loudest: Sequence[np.ndarray] | None = None,
    ):
        self._rate, self.modes = sample_rate, max(len(row) for row in poles)
        self._accelerated = [0] * len(poles) if accelerated is None else [*accelerated]
        self._channels, self._loudest = channels, None if loudest is None else self._rows(loudest)
        self._step = np.full((len(poles), self.modes), -1 + 0j)  # exponent of a sample; -1: of no mode
        #: real and imaginary part of a phasor times these rows are its sound; (B, 2 M, longest + 1)
        self._table = np.empty((len(poles), 2 * self.modes, longest + 1))
        self._bent = np.zeros_like(self._step)  # phasors, after long, per unit of force
        for body, row in enumerate(poles):
            self.retune(body, row)
        self.reset()

    def _rows(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Return values (M,) of each body as rows of one array, 0 beyond their modes."""
        out = np.zeros((len(values), self.modes))
        for row, value in zip(out, values):
            row[: len(value)] = value
        return out

    def retune(self, body: int, poles: np.ndarray) -> None:
        """Let the modes of a body ring with other poles (M,), 1/s, from the next block on."""
        step = self._step[body]
        step[: len(poles)] = np.asarray(poles, np.complex128) / self._rate
        powers = np.exp(step[:, None] * np.arange(self._table.shape[2]))
        self._table[body, : self.modes], self._table[body, self.modes :] = powers.imag, powers.real
        pushed = slice(self._accelerated[body])
        self._bent[body, pushed] = -1 / np.expm1(step[pushed])

    def reset(self) -> None:
        """Fall silent, and start to count samples anew."""
        self.phasors = np.zeros_like(self._step)
        self.clock = 0
        shape = (self._channels or 1, *self._step.shape)
        self._weights, self._before = (np.zeros(shape, np.complex128) for _ in range(2))
        self._sounded = np.zeros(len(self._step), bool)  # in the last block
        self._pulses: list[tuple[int, Pulse]] = []
        self._shaking: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    @property
    def sounds(self) -> np.ndarray:
        """Whether anything is to be heard of each body; (B,) bool."""
        out = np.zeros(len(self._step), bool)
        out[[body for body, _ in self._pulses]] = True
        for bodies, _, _ in self._shaking:
            out[bodies] = True
        return out | self.phasors.any(1)

    @property
    def energy(self) -> np.ndarray:
        """Energy of each mode, J, once pulses have ended; (B, M)."""
        return abs(self.phasors) ** 2 / 2

    def listen(self, body: int, weights: np.ndarray) -> None:
        """Hear a body with weights (M,) or (C, M) at the end of the next block, and from then on.

        Over the block, they change linearly from those of the block before, if the body was heard in it.
        """
        self._weights[:, body, : weights.shape[-1]] = weights

    def strike(self, body: int, pulse: Pulse) -> None:
        """Apply a pulse of force that begins in a later block, or in the next."""
        gains = np.zeros(self.modes)
        gains[: len(pulse.gains)] = pulse.gains
        self._pulses.append((body, replace(pulse, gains=gains)))

    def shake(self, bodies: np.ndarray, forces: np.ndarray, gains: np.ndarray) -> None:
        """Apply forces (K, samples), N, to bodies (K,) in the next block; one may be there several times.

        Gains (K, M) of the modes are per newton second, 0 beyond those of a body.
        """
        self._shaking.append((bodies, forces, gains / self._rate))

    def play(self, samples: int) -> np.ndarray:
        """Return the next samples of sound. An empty block changes nothing."""
        if not samples:  # weights and pulses wait for the next block
            self._shaking = []
            return self._silence(0)
        sounding = self.sounds
        rows = np.flatnonzero(sounding)
        begins = sounding & ~self._sounded
        self._before[:, begins] = self._weights[:, begins]
        self._sounded, end = sounding, self.clock + samples
        if not len(rows):
            self.clock = end
            return self._silence(samples)
        fixed = (self._before[:, rows] == self._weights[:, rows]).all()
        ears = self._weights if fixed else np.concatenate([self._before, self._weights])
        heard = self._ring(ears, self.phasors, rows, samples)
        phasors = self.phasors * self._complex(self._table[:, :, samples])
        for bodies, forces, gains in self._shaking:
            phasors += self._shaken(bodies, forces, gains, ears, heard)
        left = []
        for body, pulse in self._pulses:
            phasors[body] += self._pulsed(pulse, body, ears, heard)
            if math.ceil(pulse.start + pulse.duration) >= end:  # its last edge is on a later sample
                left.append((body, pulse))
        loudest = abs(self._weights).max(0) if self._loudest is None else self._loudest
        quiet = (abs(phasors) * loudest).sum(1) < SILENCE_LEVEL
        quiet[[body for body, _ in left]] = False
        phasors[quiet] = 0
        self._pulses, self._shaking, self.clock, self.phasors = left, [], end, phasors
        self._before = self._weights.copy()
        out = heard[: len(self._weights)]
        if not fixed:
            out = out + np.arange(1, samples + 1) / samples * (heard[len(self._weights) :] - out)
        return out[0] if self._channels is None else out

    def _silence(self, samples: int) -> np.ndarray:
        return np.zeros(samples if self._channels is None else (self._channels, samples))

    def _complex(self, parts: np.ndarray) -> np.ndarray:
        """Return numbers (..., M) from what the table has of them, (..., 2 M)."""
        out: np.ndarray = parts[..., self.modes :] + 1j * parts[..., : self.modes]
        return out

    def _ring(self, ears: np.ndarray, phasors: np.ndarray, rows: np.ndarray, samples: int) -> np.ndarray:
        """Return the sound of the phasors (B, M) of some rows; (ears, samples)."""
        heard = (ears * phasors)[:, rows]
        every = len(rows) == len(self._table)
        table = self._table if every else self._table[rows]
        parts = np.concatenate([heard.real, heard.imag], 2).reshape(len(ears), -1)
        return parts @ table.reshape(-1, table.shape[2])[:, :samples]

    def _shaken(
        self, bodies: np.ndarray, forces: np.ndarray, gains: np.ndarray, ears: np.ndarray, heard: np.ndarray
    ) -> np.ndarray:
        """Add forces that shake bodies to a block of sound; return what they add to the phasors at its end.

        While a force shakes modes that are heard by their acceleration, it cancels what they sound of a force
        that does not change: bent and at rest, they move no air.
        """
        samples = heard.shape[1]
        each = np.moveaxis(ears[:, bodies] * gains, 0, 1)
        parts = np.concatenate([each.real, each.imag], 2)
        answers = np.stack([part @ self._table[body, :, :samples] for part, body in zip(parts, bodies)])
        answers[..., 0] -= (each * self._bent[bodies, None]).imag.sum(2)
        size = 2 * samples
        spectra = np.fft.rfft(answers, size) * np.fft.rfft(forces, size)[:, None]
        heard += np.fft.irfft(spectra.sum(0), size)[:, :samples]
        turned, added = forces[:, ::-1].copy(), np.zeros_like(self.phasors)
        rung = np.stack([self._table[body, :, 1 : samples + 1] @ row for row, body in zip(turned, bodies)])
        np.add.at(added, bodies, gains * self._complex(rung))
        return added

    def _pulsed(self, pulse: Pulse, body: int, ears: np.ndarray, heard: np.ndarray) -> np.ndarray:
        """Add a pulse to a block of sound (ears, samples); return what it adds to the phasors at its end."""
        samples, ears = heard.shape[1], ears[:, body]
        turn = math.pi / pulse.duration  # of the force, per sample
        size = turn / 2 * pulse.gains  # impulse response of phasors: force per sample times gain
        s, added = self._step[body], np.zeros(self.modes, np.complex128)
        edges = (pulse.start - self.clock, pulse.start + pulse.duration - self.clock)
        for edge in edges:
            first = math.ceil(edge)
            if 0 <= first < samples:
                free = size * turn / (turn**2 + s**2) * np.exp(s * (first - edge))
                rung = ears * free
                heard[:, first:] += (
                    np.concatenate([rung.real, rung.imag], 1) @ self._table[body, :, : samples - first]
                )
                added += free * self._complex(self._table[body, :, samples - first])
        low, high = max(math.ceil(edges[0]), 0), min(math.ceil(edges[1]), samples)
        if low < high:
            wave = np.exp(1j * turn * (np.arange(low, high) - edges[0]))
            ahead, behind = (ears @ (size / 2j / (1j * turn + sign * s)) for sign in (-1, 1))
            heard[:, low:high] += (np.outer(ahead, wave) + np.outer(behind, wave.conj())).imag
            part = slice(self._accelerated[body])
            by_force, by_change = (
                (ears[:, part] * factor).imag @ size[part]
                for factor in force_factors(s[part], pulse.duration)
            )
            heard[:, low:high] += np.outer(by_force, wave.imag) + np.outer(by_change, wave.real)
        return added


def pulse_gain(poles: np.ndarray, duration: float) -> np.ndarray:
    """Return the phasors that a half sine of unit impulse leaves, over those of an ideal impulse; (M,).

    Poles (M,) are complex, 1/s; the duration is in seconds.
    """
    turn = math.pi / duration
    return turn / 2 * turn / (turn**2 + poles**2) * (1 + np.exp(poles * duration))
