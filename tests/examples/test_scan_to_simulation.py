"""An object falls on a tactile sensor; it is heard and felt."""

import re

import numpy as np
import pytest
import scan_to_simulation
import soundfile
from PIL import Image


@pytest.fixture(scope="module")
def fallen(brick_path, tmp_path_factory):
    """The folder of a fall that ends soon after the brick has met the sensor."""
    folder = tmp_path_factory.mktemp("fall") / "drop"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_to_simulation, "SECONDS", 0.14)
        scan_to_simulation.main(brick_path, folder)
    return folder


def test_the_fall_is_heard_from_the_first_contact_on(fallen):
    sound, rate = soundfile.read(fallen / "drop.wav")
    assert (rate, len(sound)) == (48000, 0.14 * 48000)
    assert abs(sound).max() == pytest.approx(0.9, abs=1e-3)
    start = np.flatnonzero(sound)[0] / rate
    assert 0.05 < start < 0.12  # s, in which it falls some centimetres


def test_the_picture_is_of_the_width_of_a_page(fallen):
    path = fallen / "drop.webp"
    with Image.open(path) as picture:
        assert picture.size == (1200, 900)
        assert np.asarray(picture.convert("RGB")).std() > 20
    assert 10_000 < path.stat().st_size < 150_000
