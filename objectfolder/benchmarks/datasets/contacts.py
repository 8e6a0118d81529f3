"""Contacts with one object: touches, strikes and close views at the same random points."""

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.samples import Samples, has_uncertain_sound, object_digest
from objectfolder.benchmarks.datasets.splits import TEN, Split
from objectfolder.objectfile.close_views import camera_distances, close_views
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.query_files import sample_depths, sample_strikes
from objectfolder.sound.spectrogram import DURATION, SAMPLE_RATE

TOGETHER = 8  #: contacts of one sequence
CHUNK = 64  #: contacts asked at once
CLOSEST = 0.001  #: of the camera to a contact, metres


def sample_contacts(file: ObjectFile, count: int, seed: int, side: int) -> Samples:
    """Touch, strike and look at an object at the same random points of its surface.

    The samples are of one object: ``touch`` (count, H, W, 3) uint8, at random press depths with the sensor
    upright, or as a net of kind ``image`` answers; ``audio`` (count, samples) float32, of strikes along the
    inward normal, but of objects whose sound is marked uncertain; ``vision`` (count, side, side, 3) uint8,
    the `close_views`, from where the surface leaves little room as near as `CLOSEST`, but of objects without
    a vision net; ``point`` (count, 3), unit frame.
    """
    strikes = sample_strikes(file, count, seed)
    points, impulses = strikes[:, :3], strikes[:, 3:]
    depths = sample_depths(file, count, seed)
    parts = np.array_split(np.arange(count), -(-count // CHUNK))
    arrays = {
        "touch": np.concatenate([file.touch(points[rows], depths[rows]) for rows in parts]),
        "point": points / file.scale,
    }
    if not has_uncertain_sound(file):
        played = SAMPLE_RATE, DURATION, "displacement"
        sounds = [file.impact(points[rows], impulses[rows], *played, contact_time=0.0) for rows in parts]
        arrays["audio"] = np.concatenate(sounds)
    if "vision" in file.header:
        distances = np.maximum(camera_distances(file, points), CLOSEST)
        arrays["vision"] = close_views(file, points, distances, (side, side))
    record = {"count": count, "seed": seed, "object": object_digest(file)}
    return Samples({file.key: record}, {name: [array] for name, array in arrays.items()})


def contact_split(count: int) -> Split:
    """Split contacts: of every ten, 8 for training, 1 for validation, 1 for the test.

    Raises ObjectFolderError if there are fewer test contacts than a sequence holds.
    """
    if count % TEN or count < TEN * TOGETHER:
        raise ObjectFolderError(
            f"localize.contacts is {count}: expected a multiple of {TEN}, {TEN * TOGETHER} or more, since "
            f"sequences hold {TOGETHER} test contacts"
        )
    place = np.arange(count) % TEN
    return Split("contacts", *(np.flatnonzero(part) for part in (place < 8, place == 8, place == 9)))
