"""Tactile images of contacts, the same for ground truth and query."""

from dataclasses import dataclass, fields

import numpy as np
import torch

from objectfolder.mesh.raycast import RayCaster
from objectfolder.touch.camera import gel_normals, pixel_area
from objectfolder.touch.contact import heightmaps
from objectfolder.touch.gel import deform
from objectfolder.touch.markers import Markers, draw_markers, marker_flow
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.tangential import shear_contacts


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


@dataclass(frozen=True)
class ShearedTouches(Touches):
    """What a sensor feels when the pressed object then moves sideways and turns.

    Images show the press without the shear, but for markers. Vectors are along image right and image up,
    flow along columns and rows.
    """

    sideways: np.ndarray  #: (N, H, W, 2) float32, m, displacement of the gel's surface
    traction: np.ndarray  #: (N, H, W, 2) float32, Pa, of the object on the gel
    shear_force: np.ndarray  #: (N, 2) float64, N, of the object on the gel
    torque: np.ndarray  #: (N,) float64, N m, about the optical axis, anticlockwise in the image
    slipping: np.ndarray  #: (N,) float64, part of the contact's area that slips
    friction: np.ndarray  #: (N,) float64, coefficients
    markers: np.ndarray  #: (M, 2) float64, columns and rows of the markers at rest, pixels
    marker_flow: np.ndarray  #: (N, M, 2) float32, their motion, pixels


def sheared(
    touches: Touches, shear: np.ndarray, twist: np.ndarray, friction: np.ndarray, markers: Markers | None
) -> ShearedTouches:
    """Move pressed objects sideways and turn them; see `tangential.shear_contacts`.

    Parameters
    ----------
    touches : Touches
    shear : (N, 2) array
        Motion of the object against the sensor, along image right and image up, metres.
    twist : (N,) array
        Turn about the optical axis, anticlockwise in the image, radians.
    friction : (N,) array
        Coefficients.
    markers : Markers, optional
        To draw into the images. Their flow is that of the default ones otherwise.
    """
    profile = touches.profile
    found = shear_contacts(touches.pressure, shear, twist, friction, profile)
    dots = markers or Markers()
    places = dots.places(profile)
    flow = marker_flow(places, found.displacement, touches.displacement, profile)
    values = {field.name: getattr(touches, field.name) for field in fields(Touches)}
    if markers:
        values["images"] = draw_markers(touches.images, places, flow, dots, profile)
    return ShearedTouches(
        **values,
        sideways=found.displacement,
        traction=found.traction,
        shear_force=found.force,
        torque=found.torque,
        slipping=found.slipping,
        friction=friction,
        markers=places,
        marker_flow=flow,
    )


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
    return contacts_of(*heightmaps(caster, points, normals, angles, depths, profile, scale), profile)


def contacts_of(height: np.ndarray, obstructed: np.ndarray, profile: SensorProfile) -> Contacts:
    """Press what the heightmaps (N, H, W) of `heightmaps` show into the sensor's gel."""
    displacement, pressure = deform(height, profile)
    mask = height > 0 if profile.gel == "rigid" else pressure > 0
    total, volume, force = (_integrals(of, profile) for of in (mask, height * mask, pressure))
    return Contacts(
        height=height,
        displacement=displacement,
        pressure=pressure,
        mask=mask,
        area=total,
        max_penetration=height.max(axis=(1, 2), initial=0).astype(np.float64),
        mean_penetration=volume / np.where(total > 0, total, 1),
        force=force,
        obstructed=obstructed,
    )


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
    """Press the sensor on an object and read its images, without noise.

    Parameters are those of `heightmaps`; ``optics`` renders the same profile. Each row depends on its own
    contact only, to the bit.

    Returns
    -------
    images : (N, H, W, 3) uint8, RGB
    contacts : Contacts
    """
    contacts = press(caster, points, normals, angles, depths, profile, scale)
    return optics.render(torch.from_numpy(contacts.displacement)).numpy(), contacts
