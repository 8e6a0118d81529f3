"""An object falls on a tactile sensor; it is heard and felt."""

import re
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import pytest
import scan_to_simulation
import soundfile
from PIL import Image

STEPS = 70  # of 2 ms: the brick has met the sensor


@pytest.fixture(scope="module")
def fall(brick_path, tmp_path_factory):
    """The folder of a fall, and what was printed."""
    folder, printed = tmp_path_factory.mktemp("fall") / "drop", StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
        patch.setattr(scan_to_simulation, "SECONDS", 0.002 * (STEPS - 0.5))
        scan_to_simulation.main(brick_path, folder)
    return folder, printed.getvalue()


def test_the_fall_is_heard_from_the_first_contact_on(fall):
    sound, rate = soundfile.read(fall[0] / "drop.wav")
    assert (rate, len(sound)) == (48000, 96 * STEPS)
    assert abs(sound).max() == pytest.approx(0.9, abs=1e-3)
    start = np.flatnonzero(sound)[0] / rate
    assert 0.05 < start < 0.12  # s, in which it falls some centimetres


def test_the_level_and_the_press_are_told(fall, brick):
    pascals, decibels, newtons = re.fullmatch(
        r"loudest ([\d.]+) Pa \((\d+) dB\); press ([\d.]+) N\n", fall[1]
    ).groups()
    assert float(decibels) == pytest.approx(20 * np.log10(float(pascals) / 20e-6), abs=0.6)
    weight = 9.81 * 0.18e-3 * brick.header["material_properties"]["density"]
    assert 2 * weight < float(newtons) < 50 * weight


def test_the_picture_is_of_the_width_of_a_page(fall):
    with Image.open(fall[0] / "drop.webp") as picture:
        assert picture.size == (1200, 900)
    assert 10_000 < (fall[0] / "drop.webp").stat().st_size < 150_000
