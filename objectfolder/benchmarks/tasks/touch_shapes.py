"""Tasks whose encoders see touches as shapes of the gel, in their own frame."""

from dataclasses import replace
from typing import TypeVar, cast

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.models.settings import TouchFrameConfig
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.objectfile.file import ObjectFile
from objectfolder.touch.inverse import PhotometricInverse
from objectfolder.touch.profiles import SensorProfile

_Params = TypeVar("_Params", bound=TouchFrameConfig)


def in_touch_frame(job: Job[_Params]) -> Job[_Params]:
    """Return a job on observations with touches in the frame that its settings ask for.

    Raises ObjectFolderError as `single_sensor`.
    """
    if job.params.touch_frame == "sensor":
        return job
    profile, background = single_sensor(cast(Observations, job.observations))
    inverse = PhotometricInverse.fitted(profile, background, job.sizes.touch)
    job.report(
        f"shapes of touches: slopes of {profile.name}'s gel are {100 * inverse.error:.0f} % wrong under balls"
    )
    return replace(job, inverse=inverse)


def single_sensor(observations: Observations) -> tuple[SensorProfile, np.ndarray]:
    """Return the sensor of all touches, and its image without an object, (H, W, 3) uint8.

    Raises ObjectFolderError if objects were touched by different sensors.
    """
    sensors = {key: record["sensor"] for key, record in observations.records.items()}
    first, *others = sensors
    for key in others:
        if sensors[key] != sensors[first]:
            raise ObjectFolderError(
                f"{key}: touched by sensor {sensors[key]!r}, {first} by {sensors[first]!r}; touches in their "
                "own frame need a single one: build all objects with it, or set touch_frame: sensor"
            )
    file = ObjectFile.load(observations.object_file(first))
    return file.sensor_profile, file.sensor_background
