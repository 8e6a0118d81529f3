"""The voice of an object: its modes, what excites them, and how they are heard, for sounds that go on."""

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.mesh.normals import area_vectors
from objectfolder.objectfile.parts import TAPS, StoredParts
from objectfolder.sound.click import AIR_DENSITY, SOUND_SPEED, Recoil
from objectfolder.sound.contact import effective_modulus
from objectfolder.sound.query import no_modes
from objectfolder.sound.senses import ModalSense
from objectfolder.sound.synthesis import gains, is_audible
from objectfolder.stored.arguments import Rows, broadcast_rows, finite_rows
from objectfolder.stored.header import RADIATION

_ALIKE = 0.01  # relative change of wavelengths, over the size, that is not worth a warning
log = logging.getLogger(__name__)


class Voice:
    """Modes of an object of some material and size, and the recoil of the object as three more.

    Parameters and errors are those of `objectfolder.objectfile.file.ObjectFile.voice`.

    Attributes
    ----------
    poles : (M + 3,) complex array
        -c + i w, 1/s.
    modes : int
        M, the number of modes; the other poles are the recoil's.
    accelerated : int
        M if modes are heard by their acceleration, 0 if by their velocity.
    material : Material
    scale : float
        m
    mass : float
        kg, of the solid filled with the material, whatever the real object weighs
    """

    def __init__(
        self,
        parts: StoredParts,
        sample_rate: float,
        material: str | Material | None = None,
        scale: float | None = None,
    ):
        self._arguments = parts, sample_rate, material, scale
        sense, self.key = parts.audio, parts.key
        if not isinstance(sense, ModalSense):
            raise no_modes(self.key)
        sense.warn_if_uncertain()
        self._sense, self._surface = sense, parts.surface
        self.material, self.scale = sense.struck(material, scale)
        self._resized = self.scale / self._surface.scale
        tuning = sense.tuning(material, scale)
        heard = is_audible(tuning.damped_frequency, sample_rate)
        self._rows, self._factor = tuning.modes[heard].numpy(), tuning.shape_factor
        modal = torch.complex(-tuning.damping.double(), tuning.damped_frequency.double())[heard].numpy()
        if len(tuning.modes) and not len(modal):
            raise ObjectFolderError(
                f"{self.key}: its lowest mode is at {float(tuning.frequencies.min()):.0f} Hz, above half the "
                f"sample rate of {sample_rate:g} Hz: it would only click; raise the sample rate"
            )
        self.modes = len(modal)
        self._own = sense.damped_frequency.double().numpy()[self._rows] / SOUND_SPEED
        self._radiation = parts.radiation.of(self._rows) if RADIATION in parts.header else None
        self.accelerated = 0 if self._radiation is None else self.modes
        if self._radiation is None:
            surface = self._surface.read()
            corners = surface.vertices[surface.faces] * self.scale
            volume = np.linalg.det(corners).sum() / 6  # of tetrahedra from the triangles to the origin
            self.recoil = Recoil.of(corners.reshape(-1, 3), self.material.density * volume)
            self.radius = float(np.linalg.norm(corners, axis=2).max())
        else:
            self.recoil = self._radiation.recoil(self.material.density, self.scale)
            self.radius = self._radiation.field.radius * self._resized
            ratio = modal.imag / SOUND_SPEED * self._resized / self._own
            if len(ratio) and abs(ratio - 1).max() > _ALIKE:
                own = "it radiates as was solved for its own material"
                times = float(np.median(ratio))
                log.info(
                    "%s: of %s %s, at %.2f times the frequency", self.key, self.material.name, own, times
                )
        self.mass = self.recoil.mass
        self._recoil_rate = SOUND_SPEED / self.recoil.radii
        self.poles = np.concatenate([modal, self._recoil_rate * (-1 + 1j)])
        taps, all_shapes = parts.taps
        shapes = self._factor * all_shapes[..., self._rows].astype(np.float64)
        recoil = np.broadcast_to(self.recoil.axes.T, (TAPS, 3, 3))
        self._tapped, places = np.concatenate([shapes, recoil], 2), taps * self._resized
        #: half the squared distance of each from (x, y, z, 1), but for what all have in common; (4, TAPS)
        self._tap_distances = np.concatenate([-places.T, np.square(places).sum(1)[None] / 2])
        self._area = 0.0
        if self._surface.stored:  # build what finds the nearest points, else the first strike would wait
            self._surface.nearest(1.1 * taps[:100])
            self._surface.read().caster.first_hit(np.zeros((1, 3)), np.eye(3)[:1])

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._arguments

    def gains(self, points: Rows, impulses: Rows) -> np.ndarray:
        """Return gains of impulses (N, 3), N s, at the surface points nearest to points (N, 3); (N, M + 3).

        Object frame, metres of this object.
        """
        places, pushes = finite_rows("points", points, 3), finite_rows("impulses", impulses, 3)
        places, pushes = broadcast_rows("points", places, "impulses", pushes)
        nearest = self._surface.nearest(places / self._resized)[0]
        force = torch.from_numpy(np.asarray(pushes, np.float64) * self._factor).float()
        modal = gains(torch.from_numpy(self._sense.shapes(nearest)[..., self._rows]), force).double().numpy()
        return np.concatenate([modal, pushes @ self.recoil.axes.T], 1)

    def rough_gains(self, point: np.ndarray, impulse: np.ndarray) -> np.ndarray:
        """Return gains (M + 3,) of an impulse (3,), with the shapes of the nearest of `TAPS` points."""
        found: np.ndarray = impulse @ self._tapped[(np.append(point, 1) @ self._tap_distances).argmin()]
        return found

    def weights(self, place: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the complex weights (M + 3,) with which phasors are heard at a place (3,), in pascals.

        Object frame, metres. Places in the ball about the origin that holds the object count as on it.
        """
        places = finite_rows("place", place, 3)
        if len(places) != 1:
            raise ObjectFolderError(f"place has {len(places)} rows, expected one")
        distance = float(np.linalg.norm(places))
        if distance < self.radius:
            places = np.array([[0, 0, self.radius]]) if distance == 0 else places * (self.radius / distance)
        modal, away = self.poles[: self.modes], places[0] - self.recoil.centre
        if self._radiation is None:
            reach = self._plane_waves() / max(distance, self.radius)
            heard = reach * modal / modal.imag
        else:
            pressure = self._radiation.pressure(self._own / self._resized, places, self.scale)
            heard = self._factor * pressure[0].conj() * modal**2 / modal.imag
        r = np.linalg.norm(away)
        s, rate = self.poles[self.modes :], self._recoil_rate
        along = self.recoil.axes @ (away / r)
        strength = AIR_DENSITY * self.recoil.radii**3 * rate**2 / self.mass * along / r**2
        return np.concatenate([heard, strength * (1 + r / SOUND_SPEED * s) / s.imag])

    def modulus(self, other: Material) -> float:
        """Return the modulus of contacts with a material, Pa."""
        return effective_modulus(*((m.youngs_modulus, m.poisson_ratio) for m in (self.material, other)))

    def _plane_waves(self) -> np.ndarray:
        """Return pressure at distance 1 m per modal velocity, as if the surface sent out plane waves; (M,).

        An upper estimate, for files that do not store how their modes radiate.
        """
        if not self._area:
            surface = self._surface.read()
            doubled = area_vectors(surface.vertices * self.scale, surface.faces)
            self._area = float(np.linalg.norm(doubled, axis=1).sum() / 2)
            moved = self._tapped[..., : self.modes]
            self._moving = np.sqrt(np.square(moved).mean(0).sum(0) / 3)
        return AIR_DENSITY * SOUND_SPEED * np.sqrt(self._area / (4 * np.pi)) * self._moving
