"""The three questions: how does it look, how does it sound, what does a touch feel.

Batches in, batches out. Every row is answered by the same operations whatever else is in the batch.
"""

import logging
from collections.abc import Iterable, Iterator
from dataclasses import fields

import numpy as np
import torch

from objectfolder.audio.bank import Bank
from objectfolder.audio.spectrogram import DURATION, SAMPLE_RATE, sounds_of
from objectfolder.audio.synthesis import gains
from objectfolder.audio.tuning import Tuning
from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.audio_gains import GainsNet
from objectfolder.nets.audio_spectrogram import SpectrogramNet
from objectfolder.nets.released.gains import ReleasedGains
from objectfolder.nets.released.spectrogram import ReleasedSpectrogram
from objectfolder.nets.released.touch import ReleasedDepth, ReleasedImage
from objectfolder.nets.touch_geometric import GeometricTouch
from objectfolder.nets.touch_image import ImageTouch
from objectfolder.objectfile.arguments import Rows, Scalars, numbers, paired, rows, scalars
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.simulate import Touches
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.vision.color import on_white
from objectfolder.vision.picture import Drawer, Views

TOLERANCE = 0.02  #: points further than this from the surface (fraction of the size) are refused
UNMOVED = 0.25  #: voxels; contact points nearer to the stored surface stay where they are
_BATCH = 1024  # strikes whose mode shapes are in the memory at once

log = logging.getLogger(__name__)


def view(draw: Drawer, camera: Rows, light: Rows, intrinsics: Intrinsics) -> np.ndarray:
    """Render the object on white.

    Parameters
    ----------
    draw : Drawer
        Of the object's vision net.
    camera : (N, 3) array or (N, 4, 4) array
        Positions of cameras that look at the centre with z up, or camera-to-world matrices (OpenGL axes);
        unit frame. One row may be given without its first axis.
    light : (N, 3) or (3,) array
        Point light, unit frame. A white Lambertian surface that faces it at distance 1 has radiance 1.
    intrinsics : Intrinsics

    Returns
    -------
    (N, H, W, 3) float32, sRGB in [0, 1]

    Raises
    ------
    ObjectFolderError
        If shapes do not fit or values are not finite.
    """
    poses, lights = _poses_and_lights(camera, light)
    images = np.empty((len(poses), intrinsics.height, intrinsics.width, 3), np.float32)
    for image, pose, point in zip(images, poses, lights):
        image[:] = on_white(torch.from_numpy(draw(pose, point, intrinsics).rgba)).numpy()
    return images


def render(draw: Drawer, scale: float, camera: Rows, light: Rows, intrinsics: Intrinsics) -> Views:
    """Render colour, alpha, depth and normals; otherwise as `view`, whose images are ``rgb`` of these.

    Where an edge crosses a pixel, its colour is a mean of samples. Its depth and normal are of one point: the
    one at its centre, or the nearest sample where the centre misses the object.

    Parameters
    ----------
    scale : float
        Longest side, metres.
    """
    poses, lights = _poses_and_lights(camera, light)
    size = len(poses), intrinsics.height, intrinsics.width
    views = Views(*(np.empty((*size, *last), np.float32) for last in ((3,), (4,), (), (3,))))
    for i, (pose, point) in enumerate(zip(poses, lights)):
        picture = draw(pose, point, intrinsics)
        views.rgb[i] = on_white(torch.from_numpy(picture.rgba)).numpy()
        views.rgba[i], views.normals[i] = picture.rgba, picture.normals
        views.depth[i] = picture.depth * scale
    return views


def _poses_and_lights(camera: Rows, light: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Camera-to-world matrices (N, 4, 4) and lights (N, 3) of a query."""
    places = numbers("camera", camera)
    if places.ndim in (2, 3) and places.shape[-2:] == (4, 4):
        poses = places.reshape(-1, 4, 4)
    elif places.ndim in (1, 2) and places.shape[-1] == 3:
        poses = look_at(places)
    else:
        raise ObjectFolderError(f"camera has shape {places.shape}, expected (N, 3) or (N, 4, 4)")
    lights = rows("light", light, 3)
    poses, lights = paired("camera", poses, "light", lights)
    if not np.isfinite(poses).all():
        raise ObjectFolderError("camera holds values that are not finite")
    return poses, lights


def impact(
    surface: Isosurface | None,
    net: GainsNet | ReleasedGains,
    scale: float,
    points: Rows,
    forces: Rows,
    tuning: Tuning,
    bank: Bank,
    tolerance: float,
) -> np.ndarray:
    """Strike the object with impulses.

    Parameters
    ----------
    surface : Isosurface, optional
        To which points are snapped; without, they are taken as they are.
    points : (N, 3) array
        Object frame, metres.
    forces : (N, 3) array
        Impulse vectors, N s, object frame; the sound is linear in them.
    tuning : Tuning
        Modes of the struck object; ``scale`` is its longest side.
    bank : Bank
        Of that tuning.
    tolerance : float
        Refuse points further from the surface, fraction of the size.

    Returns
    -------
    (N, samples) float32, absolute amplitude

    Raises
    ------
    ObjectFolderError
        If shapes do not fit, values are not finite or too large, or a point is off the surface.
    """
    places, impulses = paired("points", rows("points", points, 3), "forces", rows("forces", forces, 3))
    places = snap(surface, places / scale, tolerance)
    heard, modes = len(bank.heard), len(tuning.modes)
    if heard == 0:
        log.warning(
            "silent: none of the object's %d modes lies below the Nyquist frequency of %g Hz",
            modes,
            bank.sample_rate / 2,
        )
    elif heard < modes:
        log.info("%d of %d modes lie above the Nyquist frequency", modes - heard, modes)
    sounds = np.empty((len(places), bank.samples), np.float32)
    for start in range(0, len(places), _BATCH):
        part = slice(start, start + _BATCH)
        shapes = net.shapes(torch.from_numpy(places[part]))[..., tuning.modes[bank.heard]]
        force = torch.from_numpy(impulses[part] * tuning.shape_factor).float().to(shapes.device)
        sounds[part] = bank.mix(gains(shapes, force))
    if not np.isfinite(sounds).all():
        raise ObjectFolderError(
            f"impulses of up to {np.abs(impulses).max():g} N s give sounds beyond single precision; "
            "the sound is linear in them: scale them down"
        )
    return sounds


def impact_spectrogram(
    surface: Isosurface | None,
    net: SpectrogramNet | ReleasedSpectrogram,
    scale: float,
    points: Rows,
    forces: Rows,
    sample_rate: float,
    duration: float,
    response: str,
    tolerance: float,
) -> np.ndarray:
    """Strike an object whose audio net stores spectrograms; otherwise as `impact`.

    Raises
    ------
    ObjectFolderError
        If something else is asked for than what the net has learnt: displacement at 16 kHz, two seconds.
    """
    samples = round(sample_rate * duration) if 0 < duration <= DURATION else 0
    if sample_rate != SAMPLE_RATE or response != "displacement" or samples <= 0:
        raise ObjectFolderError(
            f"a spectrogram net answers displacement at {SAMPLE_RATE} Hz, up to {DURATION:g} s; asked for "
            f"{response} at {sample_rate} Hz, {duration:g} s. A net of kind gains answers that "
            "(train_audio.net: gains)"
        )
    places, impulses = paired("points", rows("points", points, 3), "forces", rows("forces", forces, 3))
    snapped = torch.from_numpy(snap(surface, places / scale, tolerance))
    sounds = np.empty((len(places), samples), np.float32)
    for sound, point, force in zip(sounds, snapped, torch.from_numpy(impulses).float()):
        spectrum = (net.spectrograms(point[None])[0].cpu() * force[:, None, None]).sum(0)
        sound[:] = sounds_of(spectrum[None])[0, :samples].numpy()
    return sounds


def mode_shapes(
    surface: Isosurface | None,
    net: GainsNet | ReleasedGains,
    scale: float,
    points: Rows,
    tolerance: float,
) -> torch.Tensor:
    """Mass-normalised mode shapes: the modal gains of unit impulses along the three axes.

    Parameters
    ----------
    points : (N, 3) array
        Object frame, metres; snapped to the surface.
    tolerance : float
        Refuse points further from the surface, fraction of the size.

    Returns
    -------
    (N, 3, M) float32 tensor, kg^-1/2
    """
    snapped = snap(surface, rows("points", points, 3) / scale, tolerance)
    return net.shapes(torch.from_numpy(snapped))


def touch(
    net: GeometricTouch,
    points: Rows,
    depth: Scalars,
    angle: Scalars,
    tilt: Scalars,
    azimuth: Scalars,
    tolerance: float,
) -> Iterator[Touches]:
    """Press a tactile sensor on the object.

    Parameters
    ----------
    points : (N, 3) array
        Object frame, metres. Those within `UNMOVED` voxels of the stored surface are believed: it is not
        known better than that. Others are moved to it.
    depth : float or (N,) array
        How far the gel's apex is pressed past the surface, metres.
    angle : float or (N,) array
        Rotation of the sensor about the outward contact normal, radians.
    tilt, azimuth : float or (N,) array
        Lean of the sensor from the contact normal, and its direction in the tangent plane (from image up
        towards image right), radians.
    tolerance : float
        Refuse points further from the surface, fraction of the size.

    Returns
    -------
    iterator of Touches
        The contacts in order, a few at a time; one of none, if there are none.

    Raises
    ------
    ObjectFolderError
        At once: if shapes do not fit, values are not finite, a depth is negative or beyond the gel, or a
        point is off the surface.
    """
    contacts, depths, angles, tilts, azimuths = _contacts(points, depth, angle, tilt, azimuth)
    limit = net.profile.max_indentation
    wrong = np.flatnonzero((depths < 0) | (depths > limit))
    if len(wrong):
        raise ObjectFolderError(
            f"depth: row {wrong[0]} is {depths[wrong[0]]:g} m; the sensor {net.profile.name!r} takes "
            f"0 to {limit:g} m"
        )
    unmoved = UNMOVED * net.surface.grid.spacing
    places = snap(net.surface, contacts / net.scale, tolerance, unmoved) * net.scale
    normals = net.normals(places)
    if tilts.any():
        frames = sensor_frames(normals, angles)
        lean = np.cos(azimuths)[:, None] * frames[:, :, 2] - np.sin(azimuths)[:, None] * frames[:, :, 1]
        normals = np.cos(tilts)[:, None] * normals + np.sin(tilts)[:, None] * lean
    return net.touches(places, normals, angles, depths)


def joined(parts: Iterable[Touches]) -> Touches:
    """One `Touches` of those in several, which are of one sensor."""
    parts = list(parts)
    arrays = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(Touches)
        if field.name != "profile"
    }
    return Touches(**arrays, profile=parts[0].profile)


def touch_image(
    surface: Isosurface | None,
    net: ImageTouch | ReleasedImage,
    scale: float,
    points: Rows,
    depth: Scalars,
    angle: Scalars,
    tilt: Scalars,
    azimuth: Scalars,
    tolerance: float,
) -> np.ndarray:
    """Press the sensor on an object whose touch net stores images; otherwise as `touch`.

    Returns
    -------
    (N, H, W, 3) uint8, RGB

    Raises
    ------
    ObjectFolderError
        If another depth, angle or tilt is asked for than what the net has learnt.
    """
    contacts, depths, angles, tilts, _ = _contacts(points, depth, angle, tilt, azimuth)
    learnt = {"depth": (depths, net.press_depth), "angle": (angles, net.angle), "tilt": (tilts, 0.0)}
    for name, (values, known) in learnt.items():
        wrong = np.flatnonzero(np.abs(values - known) > 1e-6)
        if len(wrong):
            raise ObjectFolderError(
                f"{name}: row {wrong[0]} is {values[wrong[0]]:g}; a touch net of kind image is a function "
                f"of the point alone, and learnt depth {net.press_depth:g} m, angle {net.angle:g}, tilt 0; "
                "a net of kind geometric answers others (train_touch.net: geometric)"
            )
    return net.images(snap(surface, contacts / scale, tolerance))


def touch_depth(
    surface: Isosurface | None,
    net: ReleasedDepth,
    scale: float,
    points: Rows,
    depth: Scalars,
    angle: Scalars,
    tilt: Scalars,
    azimuth: Scalars,
    tolerance: float,
    profile: SensorProfile | None,
) -> Iterator[Touches]:
    """Press a sensor on an object whose touch net stores depth maps; otherwise as `touch`.

    Raises
    ------
    ObjectFolderError
        At once: if an angle is asked for, or a depth or tilt beyond what the net has learnt.
    """
    contacts, depths, angles, tilts, azimuths = _contacts(points, depth, angle, tilt, azimuth)
    turned = np.flatnonzero(angles)
    if len(turned):
        raise ObjectFolderError(
            f"angle: row {turned[0]} is {angles[turned[0]]:g}; a released touch net knows tilt, no rotation"
        )
    net.require(depths, tilts)
    return net.touches(snap(surface, contacts / scale, tolerance), depths, tilts, azimuths, profile)


def depth_maps(
    surface: Isosurface | None,
    net: ReleasedDepth,
    scale: float,
    points: Rows,
    depth: Scalars,
    tilt: Scalars,
    azimuth: Scalars,
    tolerance: float,
) -> np.ndarray:
    """What a released touch net answers itself, metres from its camera; (N, 120, 160) float32.

    Raises
    ------
    ObjectFolderError
        If a depth or tilt is beyond what the net has learnt.
    """
    contacts, depths, _, tilts, azimuths = _contacts(points, depth, 0.0, tilt, azimuth)
    return net.depth_maps(snap(surface, contacts / scale, tolerance), depths, tilts, azimuths)


def _contacts(
    points: Rows,
    depth: Scalars,
    angle: Scalars,
    tilt: Scalars,
    azimuth: Scalars,
) -> tuple[np.ndarray, ...]:
    """Checked points (N, 3), and depths, angles, tilts and azimuths (N,)."""
    places = rows("points", points, 3)
    named = (("depth", depth), ("angle", angle), ("tilt", tilt), ("azimuth", azimuth))
    return places, *(scalars(name, value, len(places)) for name, value in named)


def snap(
    surface: Isosurface | None, points: np.ndarray, tolerance: float, unmoved: float = 0.0
) -> np.ndarray:
    """Move points to the surface; both (N, 3), unit frame. Those nearer than ``unmoved`` stay.

    All stay where no surface is known.

    Raises
    ------
    ObjectFolderError
        If a point is further away than the tolerance.
    """
    if not tolerance >= 0:
        raise ObjectFolderError(f"tolerance is {tolerance!r}, expected a fraction of the size")
    if len(points) == 0 or surface is None:
        return points
    snapped, distance = surface.nearest(points)
    far = np.flatnonzero(distance > tolerance)
    if len(far):
        raise ObjectFolderError(
            f"{len(far)} of {len(points)} points are off the surface, the first is row {far[0]} at "
            f"{points[far[0]].round(4).tolist()} (unit frame), {distance[far[0]]:.3g} of the size away; "
            f"expected at most {tolerance:g}. Points are in metres, centred on the bounding box: "
            "ObjectFile.sample_surface gives valid ones"
        )
    return np.where((distance < unmoved)[:, None], points, snapped)
