"""Tactile images of contacts, the same for ground truth and query."""

from dataclasses import dataclass

import numpy as np
import torch

from objectfolder.mesh.raycast import RayCaster
from objectfolder.touch.camera import gel_normals, pixel_area
from objectfolder.touch.contact import heightmaps
from objectfolder.touch.gel import deform
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile


@dataclass(frozen=True)
class Contacts:
    """What the sensor and the object do to each other, in N contacts; images as `heightmaps` has them.

    Areas are projected along the optical axis, and so is the force: it is the one along that axis.
    """

    height: np.ndarray  #: (N, H, W) float32, m, of the object past the undeformed gel; negative is a gap
    displacement: np.ndarray  #: (N, H, W) float32, m, of the gel towards the camera; negative bulges
    pressure: np.ndarray  #: (N, H, W) float32, Pa; NaN for a rigid gel
    mask: np.ndarray  #: (N, H, W) bool, where gel and object touch
    area: np.ndarray  #: (N,) float64, m², of the mask
    max_penetration: np.ndarray  #: (N,) float64, m, largest height; 0 without a contact
    mean_penetration: np.ndarray  #: (N,) float64, m, mean height over the mask; 0 without a contact
    force: np.ndarray  #: (N,) float64, N; NaN for a rigid gel
    obstructed: np.ndarray  #: (N,) float64, fraction of the pixels that the object blocks; see `heightmaps`


@dataclass(frozen=True)
class Touches(Contacts):
    """What a sensor feels in N contacts: its images beside what makes them."""

    images: np.ndarray  #: (N, H, W, 3) uint8, RGB
    profile: SensorProfile  #: of the sensor

    @property
    def normals(self) -> np.ndarray:
        """Unit normals of the gel's surface towards the camera, camera frame; (N, H, W, 3) float32."""
        return gel_normals(self.displacement, self.profile)


def press(
    caster: RayCaster,
    points: np.ndarray,
    normals: np.ndarray,
    angles: np.ndarray,
    depths: np.ndarray,
    profile: SensorProfile,
    scale: float = 1.0,
) -> Contacts:
    """Press the sensor on an object. Parameters are those of `heightmaps`."""
    height, obstructed, _ = heightmaps(caster, points, normals, angles, depths, profile, scale)
    return contacts_of(height, obstructed, profile)


def contacts_of(height: np.ndarray, obstructed: np.ndarray, profile: SensorProfile) -> Contacts:
    """Press what the heightmaps (N, H, W) of `heightmaps` show into the sensor's gel."""
    return measured_contacts(height, *deform(height, profile), obstructed, profile)


def measured_contacts(
    height: np.ndarray, displacement: np.ndarray, pressure: np.ndarray, obstructed: np.ndarray,
    profile: SensorProfile,
) -> Contacts:  # fmt: skip
    """Return contacts of heights (N, H, W) that `deform` has pressed, with their areas, depths and forces."""
    mask = height > 0 if profile.gel == "rigid" else pressure > 0
    area, volume, force = (_integrals(of, profile) for of in (mask, height * mask, pressure))
    deepest = height.max(axis=(1, 2), initial=0).astype(np.float64)
    mean = volume / np.where(area > 0, area, 1)
    return Contacts(height, displacement, pressure, mask, area, deepest, mean, force, obstructed)


def _integrals(images: np.ndarray, profile: SensorProfile) -> np.ndarray:
    """Sums of images (N, H, W) over the area, (N,) float64; one at a time, as the caches like it."""
    area = pixel_area(profile)
    return np.array([np.multiply(image, area).sum() for image in images], np.float64)


def touch_images(
    caster: RayCaster,
    points: np.ndarray,
    normals: np.ndarray,
    angles: np.ndarray,
    depths: np.ndarray,
    profile: SensorProfile,
    optics: Optics,
    scale: float = 1.0,
) -> tuple[np.ndarray, Contacts]:
    """Press the sensor on an object and read its images (N, H, W, 3) uint8, without noise.

    Parameters are those of `heightmaps`; ``optics`` renders the same profile. Each row depends on its own
    contact only, to the bit.
    """
    contacts = press(caster, points, normals, angles, depths, profile, scale)
    return optics.render(torch.from_numpy(contacts.displacement)).numpy(), contacts
