"""An object on a turntable: pictures, and the sound of the strikes that happen in them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from scipy.signal import resample_poly

from objectfolder.base.checks import finite_number, require_memory, whole_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sound.spectrogram import DURATION, SAMPLE_RATE
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at
from objectfolder.vision.lighting import studio

DISTANCE, HEIGHT = 2.2, 1.1  # of the camera, unit frame: cubes fit, whichever way they stand
SIDE, SWING = 45, 40  # of the main light from the camera, degrees
IMPULSE = 0.1  #: of a strike, N s, along the surface normal
SHOWN = 0.9  #: seconds for which the tactile image of a contact is shown
FLASH = 0.3  #: seconds for which its place is
FACING = 0.6  #: least cosine between the way to the camera and the normal of a contact
RINGS = 3.0  #: seconds of a sound, at most
LOUDEST = 0.7  #: peak of the sound track
SMALLEST = 16  #: pixels along a side of a picture, in which a tactile image has a quarter of them

_BYTES_PER_SAMPLE = 12  # of a sound, its copy at `LOUDEST`, and the track of all objects
_BYTES_PER_PIXEL = 100  # that drawing a picture takes
_BYTES_PER_CONTACT = 2**16  # of its tactile image


@dataclass(frozen=True)
class Turntable:
    """One turn of an object, with a light that swings, strikes and touches.

    Raises ObjectFolderError if a number is not positive, finite or whole, or the picture is too small.
    """

    seconds: float = 8.0  #: of the turn
    size: int = 384  #: of a picture, pixels
    rate: int = 25  #: pictures per second
    contacts: int = 4  #: strikes and touches
    seed: int = 0  #: of their places
    sample_rate: int = 48000  #: of the sound, Hz

    def __post_init__(self) -> None:
        if finite_number("seconds of a turntable", self.seconds) <= 0:
            raise ObjectFolderError(f"seconds of a turntable is {self.seconds!r}, expected more than 0")
        for name, least in {"size": SMALLEST, "rate": 1, "contacts": 1, "seed": 0, "sample_rate": 1}.items():
            whole_number(f"{name} of a turntable", getattr(self, name), least)

    def __len__(self) -> int:
        return max(round(self.seconds * self.rate), 1)

    def camera(self, second: float) -> np.ndarray:
        """Return the camera's position, unit frame; (3,)."""
        around = self._turn(second) - 0.6
        return np.array([DISTANCE * np.cos(around), DISTANCE * np.sin(around), HEIGHT])

    def light(self, second: float) -> float:
        """Return the azimuth of the main light, degrees.

        It swings beside the camera, so that no side that is seen is unlit.
        """
        turn = self._turn(second)
        return float(np.degrees(turn - 0.6) + SIDE + SWING * np.sin(turn))

    def _turn(self, second: float) -> float:
        return 2 * np.pi * second / self.seconds


def require_room(turntable: Turntable, objects: int) -> None:
    """Raise ObjectFolderError if a film of so many objects does not fit into memory."""
    samples = math.ceil(turntable.seconds) * turntable.sample_rate * objects
    require_memory(f"{samples:,} samples of sound", _BYTES_PER_SAMPLE * samples, "ask for fewer seconds")
    size, count = turntable.size, turntable.contacts * objects
    picture = f"a picture of {size} x {size} pixels"
    require_memory(picture, _BYTES_PER_PIXEL * size**2, "ask for a smaller one")
    require_memory(f"{count:,} tactile images", _BYTES_PER_CONTACT * count, "ask for fewer contacts")


@dataclass(frozen=True)
class Contact:
    """A strike and a touch at one place."""

    second: float
    pixel: np.ndarray  #: (2,) column and row where it is seen, 0 to 1
    point: np.ndarray  #: (3,) object frame, metres
    normal: np.ndarray  #: (3,) outward


def contacts(file: ObjectFile, turntable: Turntable) -> list[Contact]:
    """Choose places that face the camera at equal intervals of time."""
    rng = np.random.default_rng(turntable.seed)
    seconds = (np.arange(turntable.contacts) + 0.4) * turntable.seconds / turntable.contacts
    intrinsics, found = Intrinsics.square(128), []
    for second in seconds:
        camera = turntable.camera(second)
        seen = file.render(camera, resolution=128, lights=studio(turntable.light(second)), supersample=False)
        toward = camera / np.linalg.norm(camera)
        facing = np.argwhere((seen.alpha[0] > 0) & (seen.normals[0] @ toward > FACING))
        if not len(facing):
            continue
        row, column = facing[rng.integers(len(facing))]
        pose = look_at(camera[None])[0]
        centre = np.array([[column + 0.5, row + 0.5]])
        start, along = camera_rays(pose, intrinsics, centre)
        depth = seen.depth[0, row, column] / (along[0] @ -pose[:3, 2])
        point = start[0].astype(np.float64) * file.scale + depth * along[0]
        on, _ = file.nearest(point[None])
        found.append(Contact(float(second), centre[0] / 128, on[0], seen.normals[0, row, column]))
    return found


def pictures(file: ObjectFile, turntable: Turntable, found: list[Contact]) -> Iterator[np.ndarray]:
    """Yield the pictures, (size, size, 3) uint8: the object, its contacts, and what a sensor feels there."""
    felt = [Image.fromarray(file.touch(contact.point[None])[0]) for contact in found]
    size = turntable.size
    for number in range(len(turntable)):
        second = number / turntable.rate
        lights = studio(turntable.light(second))
        view = file.view(turntable.camera(second), resolution=size, lights=lights)[0]
        picture = Image.fromarray((255 * view).round().astype(np.uint8))
        draw = ImageDraw.Draw(picture)
        draw.text((size // 40, size // 40), f"{file.key}, {file.material}", (90, 90, 90))
        for contact, image in zip(found, felt):
            since = second - contact.second
            if 0 <= since < FLASH:
                column, row = contact.pixel * size
                radius = size / 60 * (1 + 3 * since / FLASH)
                box = (column - radius, row - radius, column + radius, row + radius)
                draw.ellipse(box, outline=(220, 40, 40), width=max(size // 130, 1))
            if 0 <= since < SHOWN:
                height = size // 4
                small = image.resize((round(height * image.width / image.height), height))
                picture.paste(small, (size - small.width - size // 40, size - height - size // 40))
        yield np.asarray(picture)


def sound(file: ObjectFile, turntable: Turntable, found: list[Contact]) -> np.ndarray:
    """Return the sound of the strikes, (samples,) float32, its peak at `LOUDEST`; zeros if none is heard.

    At the camera, if the file knows how its modes radiate; otherwise their accelerations, or displacements,
    if it stores spectrograms.
    """
    track = np.zeros(round(len(turntable) / turntable.rate * turntable.sample_rate), np.float32)
    for contact in found:
        start = round(contact.second * turntable.sample_rate)
        if start >= len(track):  # of few pictures, which end before the turn does
            continue
        heard = _heard(file, turntable, contact, (len(track) - start) / turntable.sample_rate)
        track[start : start + len(heard)] += heard[: len(track) - start]
    peak = np.abs(track).max(initial=0)
    return track * (LOUDEST / peak) if peak > 0 else track


def _heard(file: ObjectFile, turntable: Turntable, contact: Contact, seconds: float) -> np.ndarray:
    """Return the sound of one strike for so many seconds at most, at the turntable's rate."""
    strike = contact.point[None], -IMPULSE * contact.normal[None]
    if not file.has_modes:
        lasting = min(max(seconds, 1 / SAMPLE_RATE), DURATION)
        stored = file.impact(*strike, SAMPLE_RATE, lasting)[0]
        return resample_poly(stored, turntable.sample_rate, SAMPLE_RATE)
    heard: dict[str, Any] = {"response": "acceleration"}
    if "radiation" in file.header:
        heard = {"listener": turntable.camera(contact.second)[None] * file.scale}
    return file.impact(*strike, turntable.sample_rate, min(RINGS, seconds), **heard)[0]
