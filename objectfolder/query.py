"""The three questions: how does it look, how does it sound, what does a touch feel.

Batches in, batches out. Every row is answered by the same operations whatever else is in the batch.
"""

import logging
from collections.abc import Iterable, Iterator
from dataclasses import fields

import numpy as np
import torch

from objectfolder.audio.spectrogram import DURATION, SAMPLE_RATE, sounds_of
from objectfolder.audio.synthesis import audible, gains, sinusoid_bank
from objectfolder.audio.tuning import Tuning, stored_modes
from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.audio_gains import GainsNet
from objectfolder.nets.audio_spectrogram import SpectrogramNet
from objectfolder.nets.touch_geometric import GeometricTouch
from objectfolder.nets.touch_image import ImageTouch
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.simulate import Touches
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.vision.color import on_white
from objectfolder.vision.picture import Drawer, Views

TOLERANCE = 0.02  #: points further than this from the surface (fraction of the size) are refused
UNMOVED = 0.25  #: voxels; contact points nearer to the stored surface stay where they are
_BLOCK = 16  # sounds mixed at once, always: a row's bits must not depend on its batch

log = logging.getLogger(__name__)


def view(draw: Drawer, camera: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
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


def render(
    draw: Drawer, scale: float, camera: np.ndarray, light: np.ndarray, intrinsics: Intrinsics
) -> Views:
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


def _poses_and_lights(camera: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera-to-world matrices (N, 4, 4) and lights (N, 3) of a query."""
    camera = np.asarray(camera, np.float64)
    if camera.ndim in (2, 3) and camera.shape[-2:] == (4, 4):
        poses = camera.reshape(-1, 4, 4)
    elif camera.ndim in (1, 2) and camera.shape[-1] == 3:
        poses = look_at(camera)
    else:
        raise ObjectFolderError(f"camera has shape {camera.shape}, expected (N, 3) or (N, 4, 4)")
    lights = _rows("light", light, 3)
    poses, lights = _paired("camera", poses, "light", lights)
    if not np.isfinite(poses).all():
        raise ObjectFolderError("camera holds values that are not finite")
    return poses, lights


def impact(
    surface: Isosurface,
    net: GainsNet,
    scale: float,
    points: np.ndarray,
    forces: np.ndarray,
    sample_rate: float,
    duration: float,
    response: str,
    tolerance: float,
    contact_time: float = 0.0,
    tuning: Tuning | None = None,
) -> np.ndarray:
    """Strike the object with impulses.

    Parameters
    ----------
    points : (N, 3) array
        Object frame, metres; snapped to the surface.
    forces : (N, 3) array
        Impulse vectors, N s, object frame; the sound is linear in them.
    sample_rate : float
        Hz. Modes above half of it are left out.
    duration : float
        Seconds.
    response : {"displacement", "velocity", "acceleration"}
        Of the modes, summed: m kg^1/2 and its time derivatives.
    tolerance : float
        Refuse points further from the surface, fraction of the size.
    contact_time : float
        Duration of the strike, seconds: half a sine of force whose integral is the impulse. 0 is an instant.
    tuning : Tuning, optional
        Modes of an object of another material or of size ``scale``; default: the stored ones.

    Returns
    -------
    (N, samples) float32, absolute amplitude

    Raises
    ------
    ObjectFolderError
        If shapes do not fit, values are not finite or too large, or a point is off the surface.
    """
    if tuning is None:
        tuning = stored_modes(net.damped_frequency, net.damping)
    points, forces = _paired("points", _rows("points", points, 3), "forces", _rows("forces", forces, 3))
    shapes = mode_shapes(surface, net, scale, points, tolerance)[..., tuning.modes] * tuning.shape_factor
    frequency, damping = tuning.damped_frequency, tuning.damping
    bank = sinusoid_bank(frequency, damping, sample_rate, duration, response, contact_time)
    heard = int(audible(frequency, sample_rate).sum())
    if heard == 0:
        log.warning(
            "silent: none of the object's %d modes lies below the Nyquist frequency of %g Hz",
            len(damping),
            sample_rate / 2,
        )
    elif heard < len(damping):
        log.info("%d of %d modes lie above the Nyquist frequency", len(damping) - heard, len(damping))
    g = gains(shapes, torch.from_numpy(forces).float())
    sounds = np.empty((len(points), bank.shape[1]), np.float32)
    for start in range(0, len(points), _BLOCK):
        block = torch.zeros(_BLOCK, g.shape[1])
        rows = g[start : start + _BLOCK]
        block[: len(rows)] = rows
        sounds[start : start + _BLOCK] = (block @ bank)[: len(rows)].numpy()
    if not np.isfinite(sounds).all():
        raise ObjectFolderError(
            f"impulses of up to {np.abs(forces).max():g} N s give sounds that single precision cannot hold; "
            "the sound is linear in them: scale them down"
        )
    return sounds


def impact_spectrogram(
    surface: Isosurface,
    net: SpectrogramNet,
    scale: float,
    points: np.ndarray,
    forces: np.ndarray,
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
    points, forces = _paired("points", _rows("points", points, 3), "forces", _rows("forces", forces, 3))
    snapped = torch.from_numpy(snap(surface, points / scale, tolerance))
    sounds = np.empty((len(points), samples), np.float32)
    for sound, point, force in zip(sounds, snapped, torch.from_numpy(forces).float()):
        spectrum = (net.spectrograms(point[None])[0] * force[:, None, None]).sum(0)
        sound[:] = sounds_of(spectrum[None])[0, :samples].numpy()
    return sounds


def mode_shapes(
    surface: Isosurface, net: GainsNet, scale: float, points: np.ndarray, tolerance: float
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
    snapped = snap(surface, _rows("points", points, 3) / scale, tolerance)
    return net.shapes(torch.from_numpy(snapped))


def touch(
    net: GeometricTouch,
    points: np.ndarray,
    depth: np.ndarray | float,
    angle: np.ndarray | float,
    tilt: np.ndarray | float,
    azimuth: np.ndarray | float,
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
    points, depths, angles, tilts, azimuths = _contacts(points, depth, angle, tilt, azimuth)
    limit = net.profile.max_indentation
    wrong = np.flatnonzero((depths < 0) | (depths > limit))
    if len(wrong):
        raise ObjectFolderError(
            f"depth: row {wrong[0]} is {depths[wrong[0]]:g} m; the sensor {net.profile.name!r} takes "
            f"0 to {limit:g} m"
        )
    unmoved = UNMOVED * net.surface.grid.spacing
    places = snap(net.surface, points / net.scale, tolerance, unmoved) * net.scale
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
    surface: Isosurface,
    net: ImageTouch,
    scale: float,
    points: np.ndarray,
    depth: np.ndarray | float,
    angle: np.ndarray | float,
    tilt: np.ndarray | float,
    azimuth: np.ndarray | float,
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
    points, depths, angles, tilts, _ = _contacts(points, depth, angle, tilt, azimuth)
    learnt = {"depth": (depths, net.press_depth), "angle": (angles, net.angle), "tilt": (tilts, 0.0)}
    for name, (values, known) in learnt.items():
        wrong = np.flatnonzero(np.abs(values - known) > 1e-6)
        if len(wrong):
            raise ObjectFolderError(
                f"{name}: row {wrong[0]} is {values[wrong[0]]:g}; a touch net of kind image is a function "
                f"of the point alone, and learnt depth {net.press_depth:g} m, angle {net.angle:g}, tilt 0; "
                "a net of kind geometric answers others (train_touch.net: geometric)"
            )
    return net.images(snap(surface, points / scale, tolerance))


def _contacts(
    points: np.ndarray,
    depth: np.ndarray | float,
    angle: np.ndarray | float,
    tilt: np.ndarray | float,
    azimuth: np.ndarray | float,
) -> tuple[np.ndarray, ...]:
    """Checked points (N, 3), and depths, angles, tilts and azimuths (N,)."""
    points = _rows("points", points, 3)
    named = (("depth", depth), ("angle", angle), ("tilt", tilt), ("azimuth", azimuth))
    return points, *(_scalars(name, value, len(points)) for name, value in named)


def snap(surface: Isosurface, points: np.ndarray, tolerance: float, unmoved: float = 0.0) -> np.ndarray:
    """Move points to the surface; both (N, 3), unit frame. Those nearer than ``unmoved`` stay.

    Raises
    ------
    ObjectFolderError
        If a point is further away than the tolerance.
    """
    if not tolerance >= 0:
        raise ObjectFolderError(f"tolerance is {tolerance!r}, expected a fraction of the size")
    if len(points) == 0:
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


def _rows(name: str, values: np.ndarray, width: int) -> np.ndarray:
    """Check an (N, width) array of finite numbers; one row may come without its first axis."""
    array = np.asarray(values, np.float64)
    if array.ndim == 1 and len(array) == width:
        array = array[None]
    if array.ndim != 2 or array.shape[1] != width:
        raise ObjectFolderError(f"{name} has shape {np.shape(values)}, expected (N, {width})")
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array).all(1))[0])
        raise ObjectFolderError(f"{name}: row {row} is {array[row].tolist()}, expected finite numbers")
    return array


def _paired(a_name: str, a: np.ndarray, b_name: str, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give two arrays as many rows; one row serves all of the other's."""
    if len(a) != len(b) and 1 not in (len(a), len(b)):
        raise ObjectFolderError(f"{a_name} has {len(a)} rows, {b_name} {len(b)}; expected as many, or one")
    count = len(b) if len(a) == 1 else len(a)
    return tuple(np.repeat(x, count, 0) if len(x) == 1 else x for x in (a, b))  # type: ignore[return-value]


def _scalars(name: str, values: np.ndarray | float, count: int) -> np.ndarray:
    array = np.asarray(values, np.float64)
    if array.ndim > 1 or array.size not in (1, count):
        raise ObjectFolderError(f"{name} has shape {array.shape}, expected one number or {count} of them")
    wrong = np.flatnonzero(~np.isfinite(array))
    if len(wrong):
        raise ObjectFolderError(f"{name}: row {wrong[0]} is {array.flat[wrong[0]]}, expected finite numbers")
    return np.broadcast_to(array.reshape(-1), (count,)) if array.size == 1 else array
