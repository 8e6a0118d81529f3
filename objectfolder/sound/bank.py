"""Synthesis of many strikes on the same modes: responses are computed once, then mixed by gains."""

import numpy as np
import torch

from objectfolder.sound.synthesis import count_samples, is_audible, responses
from objectfolder.sound.tuning import Tuning

BLOCK = 16  # sounds mixed at once; fixed, so that a row's bits do not depend on its batch
PIECE = 1 << 15  # samples mixed at once
MIN_COLUMNS = 16  # samples of a piece; of fewer columns, the bits of a product depend on the row
MAX_CACHED_BYTES = 1 << 27  # bytes; larger responses are recomputed for every block of sounds


class Bank:
    """Responses of modes to unit impulses, without modes at or above half the sample rate, which would alias.

    Sounds are mixed on a device; with ``phases``, gains are complex. ``heard`` (H,) int64 holds the indices
    of the tuning's modes below half the sample rate. Other parameters, and errors, are those of
    `objectfolder.sound.synthesis.sinusoid_bank`.
    """

    def __init__(
        self,
        tuning: Tuning,
        sample_rate: float,
        duration: float,
        response: str,
        contact_time: float,
        device: torch.device | str = "cpu",
        phases: bool = False,
    ):
        self.sample_rate = sample_rate
        self.samples = count_samples(sample_rate, duration)
        self.heard = torch.nonzero(is_audible(tuning.damped_frequency, sample_rate))[:, 0]
        self.device = torch.device(device)
        self._modes = tuning.damped_frequency[self.heard], tuning.damping[self.heard]
        self._strike = response, contact_time
        self._phases = phases
        kept = 4 * (1 + phases) * len(self.heard) * self.samples <= MAX_CACHED_BYTES
        self._pieces = [self._piece(start) for start in range(0, self.samples, PIECE)] if kept else []
        if not kept:
            self._piece(self.samples - 1)  # validates the response and the contact time

    def mix(self, gains: torch.Tensor) -> np.ndarray:
        """Return the sounds (N, samples), float32, for gains (N, H) of the modes in ``heard``.

        With phases, gains are complex64 and turn the modes ahead.
        """
        if self._phases:
            gains = torch.cat([gains.real, gains.imag], dim=1)
        sounds = np.empty((len(gains), self.samples), np.float32)
        for first in range(0, len(gains), BLOCK):
            rows = gains[first : first + BLOCK]
            block = torch.zeros(BLOCK, gains.shape[1], dtype=torch.float32, device=self.device)
            block[: len(rows)] = rows
            out = torch.from_numpy(sounds[first : first + BLOCK])
            for i, start in enumerate(range(0, self.samples, PIECE)):
                piece = self._pieces[i] if self._pieces else self._piece(start)
                out[:, start : start + PIECE] = (block @ piece)[: len(rows), : self.samples - start]
        return sounds

    def _piece(self, start: int) -> torch.Tensor:
        span = range(start, max(min(start + PIECE, self.samples), start + MIN_COLUMNS))
        parts = [
            responses(*self._modes, self.sample_rate, span, *self._strike, ahead)
            for ahead in (False, True)[: 1 + self._phases]
        ]
        return torch.cat(parts).to(self.device)
