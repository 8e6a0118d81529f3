"""Sounds of an Object File that stores spectrograms."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch

from objectfolder.audio.contact import Striker
from objectfolder.audio.spectrogram import DURATION, SAMPLE_RATE, invert_spectrogram
from objectfolder.audio.tuning import Tuning
from objectfolder.errors import ObjectFolderError
from objectfolder.materials import Material
from objectfolder.objectfile.radiation import Listening, Radiation
from objectfolder.objectfile.reading import StoredNet, damaged_net
from objectfolder.objectfile.sound_settings import SoundSettings, finite_sounds


class SpectralNet(Protocol):
    """Net from a point to spectrograms."""

    damped_frequency: torch.Tensor

    def spectrograms(self, points: torch.Tensor) -> torch.Tensor:
        """Complex spectrograms (N, 3, 257, 201) of unit impulses at (N, 3) points of the unit frame."""


class SpectrogramSense:
    """Sounds inverted from spectrograms of unit impulses: two seconds of displacement at 16 kHz."""

    has_modes = False

    def __init__(self, net: SpectralNet, stored: StoredNet):
        self.net = net
        self._key, self._surface = stored.key, stored.surface

    @property
    def damped_frequency(self) -> torch.Tensor:
        """Angular frequencies of the modes, rad/s; (M,), empty if they are not known."""
        return self.net.damped_frequency.cpu()

    def tuning(self, material: str | Material | None, scale: float | None) -> Tuning:
        """Refuse: the net knows no modes."""
        raise self._no_modes()

    def contact_time(
        self, striker: Striker, material: str | Material | None, scale: float | None
    ) -> float | None:
        """Return None: the spectrograms are those of ideal impulses."""
        return None

    def mode_shapes(self, points: np.ndarray, tolerance: float) -> np.ndarray:
        """Refuse: the net knows no modes."""
        raise self._no_modes()

    def impact(
        self, points: np.ndarray, impulses: np.ndarray, settings: SoundSettings, tolerance: float
    ) -> np.ndarray:
        """Return sounds of impulses (N, 3), N s, at points (N, 3); (N, samples) float32.

        Raises
        ------
        ObjectFolderError
            If a point is off the surface, or a setting asks for more than the spectrograms hold.
        """
        if settings.material is not None or settings.scale is not None or settings.contact_time:
            raise ObjectFolderError(
                f"{self._key}: its audio net stores spectrograms; material, scale and contact_time need "
                "modes, which train_audio.net: gains stores"
            )
        if settings.striker is not None:
            raise ObjectFolderError(
                f"{self._key}: its audio net stores spectrograms of ideal impulses; leave striker out"
            )
        rate, duration = settings.sample_rate, settings.duration
        samples = round(rate * duration) if 0 < duration <= DURATION else 0
        if rate != SAMPLE_RATE or settings.response != "displacement" or samples <= 0:
            raise ObjectFolderError(
                f"a spectrogram net answers displacement at {SAMPLE_RATE} Hz, up to {DURATION:g} s; "
                f"asked for {settings.response} at {rate:g} Hz, {duration:g} s. A net of kind gains answers "
                "that (train_audio.net: gains)"
            )
        places = torch.from_numpy(self._surface.to_unit(self._surface.snap(points, tolerance)))
        sounds = np.empty((len(places), samples), np.float32)
        for sound, point, force in zip(sounds, places, torch.from_numpy(impulses).float()):
            spectra = self.net.spectrograms(point[None])[0].cpu()
            if not spectra.isfinite().all():
                raise damaged_net(self._key, "audio")
            spectrum = (spectra * force[:, None, None]).sum(0)
            sound[:] = invert_spectrogram(spectrum[None])[0, :samples].numpy()
        return finite_sounds(sounds, impulses)

    def heard(
        self,
        points: np.ndarray,
        impulses: np.ndarray,
        settings: SoundSettings,
        tolerance: float,
        read_radiation: Callable[[], Radiation],
        listening: Listening,
    ) -> np.ndarray:
        """Refuse: the net knows no modes."""
        raise self._no_modes()

    def _no_modes(self) -> ObjectFolderError:
        return ObjectFolderError(
            f"{self._key}: its audio net stores spectrograms, no modes; train_audio.net: gains stores them"
        )
