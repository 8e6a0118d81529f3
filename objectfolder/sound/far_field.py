"""What of an object's sound reaches a listener: far fields of its modes, and its recoil."""

import copy

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sound.click import Recoil
from objectfolder.sound.radiation.farfield import unpack_far_field
from objectfolder.stored.reading import StoredNet, report_damage

_FARTHEST = 1e5  # metres at which a listener may be


class Radiation:
    """Stored radiation of an object of its own size; ObjectFolderError if the part is damaged."""

    def __init__(self, stored: StoredNet):
        self.key, self._scale = stored.key, stored.surface.scale
        header = stored.header
        with report_damage(self.key, "radiation"):
            described = header["radiation"]
            self.field = unpack_far_field(stored.tensors, described["radius"] * self._scale)
            body = described["recoil"]
            self._centre, self._axes, self._radii = (
                np.array(body[name], np.float64) for name in ("centre", "axes", "radii")
            )
            self._volume = float(header["solid"]["volume"])

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.field.orders)

    def recoil(self, density: float, scale: float) -> Recoil:
        """Return the recoil of a body of this shape, of some density (kg/m^3) and longest side (metres)."""
        mass = density * self._volume * scale**3
        return Recoil(mass, self._centre * scale, self._axes, self._radii * scale)

    def check_outside(self, places: np.ndarray, scale: float) -> None:
        """Refuse listeners inside the ball about the origin that holds the object, or out of earshot.

        Raises ObjectFolderError if one is.
        """
        radius, distance = self.field.radius * scale / self._scale, np.linalg.norm(places, axis=1)
        inside = np.flatnonzero((distance < radius) | (distance > _FARTHEST))
        if len(inside):
            raise ObjectFolderError(
                f"{self.key}: listener: row {inside[0]} is {distance[inside[0]]:g} m from the origin, "
                f"expected one outside the ball of {radius:g} m that holds the object, within {_FARTHEST:g} m"
            )

    def lag(self, places: np.ndarray, scale: float, sound_speed: float) -> np.ndarray:
        """Return how long sound travels from the ball to places (N, 3), seconds; (N,)."""
        return (np.linalg.norm(places, axis=1) - self.field.radius * scale / self._scale) / sound_speed

    def of(self, modes: np.ndarray) -> "Radiation":
        """Return that of some of the modes."""
        out = copy.copy(self)
        out.field = self.field.of(modes)
        return out

    def pressure(self, wavenumbers: np.ndarray, places: np.ndarray, scale: float) -> np.ndarray:
        """Return pressures per unit of modal acceleration (N, M), of a body of some longest side.

        The wavenumbers (M,) must be the own ones over the ratio of sizes. Mode shapes count as unchanged; see
        `FarField.pressure`.
        """
        size = scale / self._scale
        return size * self.field.pressure(wavenumbers * size, places / size)
