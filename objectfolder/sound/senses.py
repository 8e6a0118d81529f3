"""Audio nets by kind, as an Object File asks them."""

import logging
import math
from collections.abc import Callable, Iterator

import numpy as np
import torch
from typing_extensions import override  # the standard one is there since Python 3.12

from objectfolder.base import materials
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material, stored_material
from objectfolder.base.recent import Recent
from objectfolder.sound.bank import Bank
from objectfolder.sound.click import SOUND_SPEED, recoil_pressure
from objectfolder.sound.contact import Striker, contact_time, load_striker
from objectfolder.sound.far_field import Radiation
from objectfolder.sound.query import SoundSense, SoundSettings, Strikes, no_modes
from objectfolder.sound.spectrogram import DURATION, SAMPLE_RATE, invert_spectrogram
from objectfolder.sound.synthesis import force_factors, gains, half_sine, response_at
from objectfolder.sound.tuning import Tuning, retune, stored_modes
from objectfolder.stored.reading import StoredNet, damaged_net, report_damage

_PIECE = 512  # samples of a contact computed at once
_BATCH = 1024  # strikes whose mode shapes are in memory at once
_ALIKE = 0.01  # relative change of a mode's wavenumber times the size at which its stored radiation holds
_BANKS = 4  # sounds whose mode responses are kept
log = logging.getLogger(__name__)


def sound_sense(stored: StoredNet) -> SoundSense:
    """Load an audio net."""
    return SENSES[stored.answers](stored)


class ModalSense(SoundSense):
    """Sounds synthesised from modes."""

    has_modes = True

    def __init__(self, stored: StoredNet):
        super().__init__(stored)
        self._banks: Recent[tuple[Tuning, Bank]] = Recent(_BANKS)

    @override
    def tuning(self, material: str | Material | None, scale: float | None) -> Tuning:
        modes = self.net.damped_frequency.cpu().clone(), self.net.damping.cpu().clone()
        if material is None and scale is None:
            return stored_modes(*modes, self._band())
        own = self.own_material, self._surface.scale
        return retune(*modes, self._band(), own, self.struck(material, scale))

    @override
    def contact_time(
        self, striker: Striker, material: str | Material | None, scale: float | None
    ) -> float | None:
        # An object whose volume is not stored, as before format 1.1, counts as heavy. Imported files do not
        # say what their modes are of.
        if not self._described and material is None and scale is None:
            return None
        self.tuning(material, scale)  # refuses impossible ones
        (stuff, size), solid = self.struck(material, scale), self._stored.header.get("solid")
        return contact_time(striker, stuff, stuff.density * solid["volume"] * size**3 if solid else math.inf)

    def struck(self, material: str | Material | None, scale: float | None) -> tuple[Material, float]:
        """Return material and longest side (m) of this shape in another material or size.

        Raises ObjectFolderError if the file does not say what its modes are of.
        """
        own = self.own_material
        if material is not None and not isinstance(material, Material):
            material = materials.material(material, own.law)
        return material or own, self._surface.scale if scale is None else scale

    @property
    def own_material(self) -> Material:
        """Material for which the stored modes were solved.

        Raises ObjectFolderError if the file does not say.
        """
        header, key = self._stored.header, self._key
        if not self._described:
            raise ObjectFolderError(
                f"{key}: the file stores no material properties (imported files do not); it "
                "answers in its own material and size only"
            )
        with report_damage(key, "description of the sound"):
            return stored_material(header["material"], header["material_properties"])

    @property
    def _described(self) -> bool:
        """Whether the file says what its modes are of."""
        header = self._stored.header
        return "band_hz" in header["audio"] and "material_properties" in header

    def _band(self) -> tuple[float, float]:
        """Band of natural frequencies (Hz) in which every mode is stored; all of them if it is not known."""
        with report_damage(self._key, "description of the sound"):
            low, high = self._stored.header["audio"].get("band_hz", (0.0, math.inf))
            return float(low), float(high)

    @override
    def mode_shapes(self, points: np.ndarray, tolerance: float) -> np.ndarray:
        return self.shapes(self._surface.snap(points, tolerance))

    def shapes(self, points: np.ndarray) -> np.ndarray:
        """Return mode shapes (N, 3, M), kg^-1/2, at points (N, 3) of the surface, metres."""
        shapes = self.net.shapes(torch.from_numpy(self._surface.to_unit(points))).cpu().numpy()
        if not np.isfinite(shapes).all():
            raise damaged_net(self._key, "audio")
        return shapes

    @override
    def impact(
        self, strikes: Strikes, settings: SoundSettings, read_radiation: Callable[[], Radiation]
    ) -> np.ndarray:
        tuning, bank = self._bank(settings)
        if strikes.listeners is None:
            self._report_inaudible(bank, len(tuning.modes))
            sounds = np.empty((len(strikes.points), bank.samples), np.float32)
            for part, strengths in self._strengths(strikes, settings):
                moved = (
                    strengths
                    if strikes.pickups is None
                    else strengths * self._picked(strikes, settings, part)
                )
                sounds[part] = bank.mix(moved)
        else:
            sounds = self._pressures(strikes, strikes.listeners, settings, read_radiation)
        return finite_sounds(sounds, strikes.impulses)

    def _picked(self, strikes: Strikes, settings: SoundSettings, part: slice) -> torch.Tensor:
        """Return how far the surface moves at pickups, along their axes, as modes do; (rows, H), kg^-1/2."""
        tuning, bank = self._bank(settings)
        surface = self._surface.resized(settings.scale)
        assert strikes.pickups is not None
        places = torch.from_numpy(surface.to_unit(surface.snap(strikes.pickups[part], strikes.tolerance)))
        axes = surface.read().grid.normals(places) if strikes.axes is None else strikes.axes[part]
        shapes = self.net.shapes(places)[..., tuning.modes[bank.heard]]
        along = torch.as_tensor(axes, dtype=shapes.dtype, device=shapes.device)
        return (shapes * along[:, :, None]).sum(1) * tuning.shape_factor

    def _report_inaudible(self, bank: Bank, modes: int, outcome: str = "silent") -> None:
        heard, nyquist = len(bank.heard), bank.sample_rate / 2
        if modes == 0:
            log.warning("%s: %s: no mode rings between 20 Hz and 20 kHz", self._key, outcome)
        elif heard == 0:
            beyond = "none of its %d modes lies below half the sample rate, %g Hz; raise sample_rate"
            log.warning(f"%s: %s: {beyond}", self._key, outcome, modes, nyquist)
        elif heard < modes:
            text = "%s: %d of %d modes are left out, above half the sample rate"
            log.info(text, self._key, modes - heard, modes)

    def _pressures(
        self,
        strikes: Strikes,
        listeners: np.ndarray,
        settings: SoundSettings,
        read_radiation: Callable[[], Radiation],
    ) -> np.ndarray:
        tuning, bank = self._bank(settings)
        stuff, size = self.struck(settings.material, settings.scale)
        radiation = read_radiation()
        radiation.check_outside(listeners, size)
        self._report_inaudible(bank, len(tuning.modes), "only the recoil is heard")
        self._check_wavelengths(radiation, tuning, size)
        s = torch.complex(-tuning.damping, tuning.damped_frequency)[bank.heard].to(torch.complex128)
        lag = radiation.lag(listeners, size, SOUND_SPEED) * strikes.delay
        late = np.ceil(lag * bank.sample_rate).astype(np.int64)
        rest = torch.from_numpy(late / bank.sample_rate - lag)[:, None]
        radiation, wavenumbers = radiation.of(tuning.modes[bank.heard].numpy()), s.imag.numpy() / SOUND_SPEED
        contact_time = self._contact(settings)
        sounds = np.empty((len(strikes.points), bank.samples), np.float32)
        for part, strengths in self._strengths(strikes, settings):
            pressure = radiation.pressure(wavenumbers, listeners[part], size)
            phasors = strengths.cpu() * torch.from_numpy(tuning.shape_factor * pressure.conj()) * s**2
            sounds[part] = bank.mix((phasors * torch.exp(s * rest[part])).to(torch.complex64))
            if contact_time:
                _press(sounds[part], bank.sample_rate, s, phasors, rest[part], contact_time)
        for sound, samples in zip(sounds, late):
            if samples:
                sound[samples:] = sound[:-samples].copy() if samples < len(sound) else 0
                sound[:samples] = 0
        sounds += recoil_pressure(
            radiation.recoil(stuff.density, size),
            strikes.impulses,
            listeners,
            bank.sample_rate,
            bank.samples,
            contact_time,
            strikes.delay,
        )
        return sounds

    def striking_time(
        self, striker: Striker | None, material: str | Material | None, scale: float | None
    ) -> float:
        """Return how long a strike lasts, seconds: an ideal impulse, 0, if it is not known.

        Raises ObjectFolderError if it is not known and a striker is given.
        """
        lasting = self.contact_time(striker or load_striker("steel"), material, scale)
        if lasting is None and striker is not None:
            raise ObjectFolderError(
                f"{self._key}: the file does not say what its modes are of, so how long a striker "
                "touches is not known; leave striker out, which gives an ideal impulse, or give contact_time "
                "instead"
            )
        return lasting or 0.0

    def _check_wavelengths(self, radiation: Radiation, tuning: Tuning, size: float) -> None:
        key, own = self._key, self.damped_frequency
        if radiation.modes != len(own):
            raise ObjectFolderError(
                f"{key}: the file holds the radiation of {radiation.modes} modes of {len(own)}; rebuild it"
            )
        ratio = tuning.damped_frequency / own[tuning.modes] * (size / self._surface.scale)
        low, high = tuning.frequency_bounds  # of another Poisson ratio
        if len(ratio) and max(float(ratio.max()) * high - 1, 1 - float(ratio.min()) * low) > _ALIKE:
            raise ObjectFolderError(
                f"{key}: a listener hears the object in its own material only, since the stored radiation is "
                f"of its frequencies; this material has {float(ratio.min()) * low:.2f} to "
                f"{float(ratio.max()) * high:.2f} times these. Leave listener out, or build the object in "
                "this material"
            )

    def _strengths(self, strikes: Strikes, settings: SoundSettings) -> Iterator[tuple[slice, torch.Tensor]]:
        """Yield parts of the strikes, and their gains of the bank's modes; (rows, H) float32."""
        tuning, bank = self._bank(settings)
        for note in tuning.notes:
            self.warn_once(note)
        surface = self._surface.resized(settings.scale)
        places = torch.from_numpy(surface.to_unit(surface.snap(strikes.points, strikes.tolerance)))
        for start in range(0, len(places), _BATCH):
            part = slice(start, start + _BATCH)
            shapes = self.net.shapes(places[part])[..., tuning.modes[bank.heard]]
            force = torch.from_numpy(strikes.impulses[part] * tuning.shape_factor).float().to(shapes.device)
            yield part, gains(shapes, force)

    def _bank(self, settings: SoundSettings) -> tuple[Tuning, Bank]:
        return self._banks.of(settings, lambda: self._new_bank(settings))

    def _new_bank(self, settings: SoundSettings) -> tuple[Tuning, Bank]:
        tuning = self.tuning(settings.material, settings.scale)
        played = settings.sample_rate, settings.duration, settings.response, self._contact(settings)
        return tuning, Bank(tuning, *played, self._stored.device, settings.heard)

    def _contact(self, settings: SoundSettings) -> float:
        if settings.contact_time is not None:
            return settings.contact_time
        return self.striking_time(settings.striker, settings.material, settings.scale)


def _press(
    sounds: np.ndarray,
    rate: float,
    s: torch.Tensor,
    phasors: torch.Tensor,
    rest: torch.Tensor,
    contact_time: float,
) -> None:
    """Add to sounds (N, samples) at listeners, in place, how the force itself is heard.

    ``s`` (H,) are the poles of the modes, ``phasors`` (N, H) what their responses are multiplied by, and
    ``rest`` (N, 1) the time since the start of contact at the first sample, seconds.
    """
    time = torch.arange(min(sounds.shape[1], math.ceil(contact_time * rate)), dtype=torch.float64) / rate
    by_force, by_change = (
        (phasors * turn / s.imag).imag.sum(1, keepdim=True) for turn in force_factors(s, contact_time)
    )
    time, first = time[time < contact_time], 0
    for piece in time.split(_PIECE):
        since, part = piece + rest, sounds[:, first : first + len(piece)]
        if rest.any():  # the bank's responses are those of whole samples
            for sound, row, turned in zip(part, since, phasors):
                sound[:] = response_at(s[:, None], row, contact_time, weight=turned[:, None]).sum(0).numpy()
        force, change = half_sine(since, contact_time)
        part += (by_force * force + by_change * change).numpy()
        first += len(piece)


class SpectrogramSense(SoundSense):
    """Sounds inverted from spectrograms of unit impulses: two seconds of displacement at 16 kHz.

    The impulses are ideal, so no contact time is known.
    """

    @override
    def impact(
        self, strikes: Strikes, settings: SoundSettings, read_radiation: Callable[[], Radiation]
    ) -> np.ndarray:
        if strikes.listeners is not None or strikes.pickups is not None:
            raise no_modes(self._key)
        if settings.material is not None or settings.scale is not None or settings.contact_time:
            raise ObjectFolderError(
                f"{self._key}: its audio net stores spectrograms; material, scale and contact_time need "
                "modes: build the object with train_audio.net: gains"
            )
        if settings.striker is not None:
            raise ObjectFolderError(
                f"{self._key}: its audio net stores spectrograms of ideal impulses; leave striker out"
            )
        rate, duration = settings.sample_rate, settings.duration
        samples = round(rate * duration) if 0 < duration <= DURATION else 0
        if rate != SAMPLE_RATE or settings.response != "displacement" or samples <= 0:
            raise ObjectFolderError(
                f"a spectrogram net answers displacement at {SAMPLE_RATE} Hz, up to {DURATION:g} s; asked "
                f"for {settings.response} at {rate:g} Hz, {duration:g} s. To get that, build the object with "
                "train_audio.net: gains"
            )
        snapped = self._surface.snap(strikes.points, strikes.tolerance)
        places = torch.from_numpy(self._surface.to_unit(snapped))
        sounds = np.empty((len(places), samples), np.float32)
        for sound, point, force in zip(sounds, places, torch.from_numpy(strikes.impulses).float()):
            spectra = self.net.spectrograms(point[None])[0].cpu()
            if not spectra.isfinite().all():
                raise damaged_net(self._key, "audio")
            spectrum = (spectra * force[:, None, None]).sum(0)
            sound[:] = invert_spectrogram(spectrum[None])[0, :samples].numpy()
        return finite_sounds(sounds, strikes.impulses)


def finite_sounds(sounds: np.ndarray, impulses: np.ndarray) -> np.ndarray:
    """Return sounds, or raise ObjectFolderError if impulses are too large for single precision."""
    if not np.isfinite(sounds).all():
        raise ObjectFolderError(
            f"impulses of up to {np.abs(impulses).max():g} N s give sounds beyond single precision; "
            "the sound is linear in them: scale them down"
        )
    return sounds


#: By what a net answers at (N, 3) points of the unit frame. Modes: by ``shapes``, (N, 3, M) kg^-1/2, of
#: ``damped_frequency`` and ``damping``, (M,). Spectrograms: by ``spectrograms`` of unit impulses, (N, 3, 257,
#: 201) complex, of modes with some ``damped_frequency``.
SENSES: dict[str, type[SoundSense]] = {"modes": ModalSense, "spectrograms": SpectrogramSense}
