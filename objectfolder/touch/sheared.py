"""Touches of objects that move sideways and turn after the press."""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from objectfolder.touch.dragged import dragged_contacts
from objectfolder.touch.markers import Markers, draw_markers, marker_flow
from objectfolder.touch.simulate import Touches
from objectfolder.touch.tangential import shear_contacts


@dataclass(frozen=True)
class ShearedTouches(Touches):
    """What a sensor feels when the pressed object then moves sideways and turns.

    ``images``, ``height``, ``displacement``, ``normals``, ``pressure`` and ``mask`` are what the camera sees
    after the motion. ``sideways`` and ``traction`` belong to the points of the gel that are at their pixels
    before it, and all numbers to the press. Vectors are along image right and image up, flow along columns
    and rows.
    """

    sideways: np.ndarray  #: (N, H, W, 2) float32, m, displacement of the gel's surface
    traction: np.ndarray  #: (N, H, W, 2) float32, Pa, of the object on the gel
    shear_force: np.ndarray  #: (N, 2) float64, N, of the object on the gel
    torque: np.ndarray  #: (N,) float64, N m, about the optical axis, anticlockwise in the image
    slipping: np.ndarray  #: (N,) float64, part of the contact's area that slips
    friction: np.ndarray  #: (N,) float64, coefficients
    markers: np.ndarray  #: (M, 2) float64, columns and rows of the markers at rest, pixels
    marker_flow: np.ndarray  #: (N, M, 2) float32, their motion, pixels


def shear_touches(
    touches: Touches,
    shear: np.ndarray,
    twist: np.ndarray,
    friction: np.ndarray,
    markers: Markers | None,
    render: Callable[[np.ndarray], np.ndarray],
) -> ShearedTouches:
    """Move pressed objects sideways and turn them; see `shear_contacts` and `dragged_contacts`.

    ``shear`` (N, 2) is the motion of the object against the sensor, right and up in the image, metres;
    ``twist`` (N,) its turn about the optical axis, anticlockwise in the image, radians; ``friction`` (N,)
    coefficients. Markers are drawn if given; their flow is that of the default ones otherwise. ``render``
    makes images (K, H, W, 3) of displacements (K, H, W) of the gel.
    """
    profile = touches.profile
    found = shear_contacts(touches.pressure, shear, twist, friction, profile)
    dots = markers or Markers()
    places = dots.places(profile)
    flow = marker_flow(places, found.displacement, touches.displacement, profile)
    values = {field.name: getattr(touches, field.name) for field in fields(Touches)}
    moving = np.flatnonzero(touches.mask.any(axis=(1, 2)) & (shear.any(axis=1) | (twist != 0)))
    if len(moving):
        pressed = touches.height[moving], touches.pressure[moving], found.dragged[moving]
        motion = shear[moving], twist[moving]
        height, displacement, pressure = dragged_contacts(*pressed, *motion, profile)
        after = {"height": height, "displacement": displacement, "pressure": pressure, "mask": pressure > 0}
        for name, images in (after | {"images": render(displacement)}).items():
            values[name] = values[name].copy()
            values[name][moving] = images
    if markers:
        values["images"] = draw_markers(values["images"], places, flow, dots, profile)
    by_friction = found.displacement, found.traction, found.force, found.torque, found.slipping
    names = ("sideways", "traction", "shear_force", "torque", "slipping")
    values |= dict(zip(names, by_friction))
    return ShearedTouches(**values, friction=friction, markers=places, marker_flow=flow)
