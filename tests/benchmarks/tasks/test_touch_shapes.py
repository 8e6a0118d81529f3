from dataclasses import replace

import numpy as np
import pytest
from encoding import encoding
from made_up import MadeUp

from objectfolder import ObjectFile
from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.recognize import RecognizeConfig
from objectfolder.benchmarks.tasks.touch_shapes import in_touch_frame, single_sensor
from objectfolder.objectfile.samples import sample_path


class Touched(MadeUp):
    """A touch of two objects each, by sensors of some names."""

    def __init__(self, *sensors):
        super().__init__(("bell", "cup"), {"touch": np.zeros((2, 160, 120, 3), np.uint8)}, sensor=sensors)

    def object_file(self, key):
        return sample_path(key)


def test_the_frame_of_touches_is_that_of_the_settings(tmp_path):
    said, bell = [], ObjectFile.sample("bell")
    images = Job(
        Touched("digit", "digit"), None, RecognizeConfig(), encoding(), 0, tmp_path, report=said.append
    )
    assert in_touch_frame(images) is images
    own = in_touch_frame(replace(images, params=RecognizeConfig(touch_frame="own")))
    assert own.inverse.background.shape == (3, 8, 8)
    mean = bell.sensor_background.reshape(8, 20, 8, 15, 3).mean((1, 3))
    np.testing.assert_allclose(own.inverse.background.movedim(0, -1), mean, rtol=1e-5)
    assert said == [
        f"shapes of touches: slopes of digit's gel are {100 * own.inverse.error:.0f} % wrong under balls"
    ]


def test_touches_of_different_sensors_have_no_common_frame():
    with pytest.raises(ObjectFolderError, match="cup: touched by sensor 'tacto_digit', bell by 'digit'"):
        single_sensor(Touched("digit", "tacto_digit"))
