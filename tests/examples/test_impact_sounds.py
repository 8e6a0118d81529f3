"""Sounds of strikes, and recordings whose fit has a known answer."""

import re
from contextlib import redirect_stdout
from io import StringIO

import impact_sounds
import numpy as np
import pytest
import soundfile
from PIL import Image

from objectfolder.base.materials import material
from objectfolder.sound.fitting import fit_sound
from objectfolder.sound.recordings import read_recording

SOUNDS = ["right", "back", "top", "half", "steel", "wood"]
TAPS = [f"tap{number}" for number in range(1, 7)]


@pytest.fixture(scope="module")
def struck(brick_path, tmp_path_factory):
    """The folder of the sounds, and what was printed."""
    folder, printed = tmp_path_factory.mktemp("struck") / "sounds", StringIO()
    with redirect_stdout(printed):
        impact_sounds.main(brick_path, folder)
    return folder, printed.getvalue()


def test_sounds_are_written_at_48_khz_and_do_not_clip(struck):
    folder, _ = struck
    assert {path.stem for path in folder.glob("*.wav")} == {*SOUNDS, *TAPS}
    sounds = {name: soundfile.read(folder / f"{name}.wav") for name in SOUNDS}
    for sound, rate in sounds.values():
        assert (rate, len(sound)) == (48000, 72000)
        assert abs(sound).max() == pytest.approx(0.9, abs=1e-4)
    assert not np.allclose(sounds["right"][0], sounds["top"][0], atol=0.05)


def test_levels_are_those_at_the_listener(struck, brick):
    levels = re.findall(r"^(\w+): peak ([\d.]+) Pa, (\d+) dB$", struck[1], re.MULTILINE)
    assert [name for name, _, _ in levels] == SOUNDS[:4]
    top = brick.nearest([[0, 0, brick.scale / 2]])[0]
    heard = brick.impact(top, -0.02 * top / np.linalg.norm(top), 48000, listener=[[0.6, -0.6, 0.5]])
    assert float(levels[2][1]) == pytest.approx(abs(heard).max(), abs=0.006)
    assert float(levels[2][2]) == pytest.approx(20 * np.log10(abs(heard).max() / 20e-6), abs=0.6)


def test_the_recordings_hold_the_material_that_the_page_names(brick, struck):
    taps = [read_recording(struck[0] / f"{name}.wav")[0] for name in TAPS]
    plastic = material(brick.material)
    fit = fit_sound(brick.frequencies, plastic, taps, 48000, "loss_factor")
    assert fit.match.stiffness == pytest.approx(impact_sounds.STIFFER, rel=2e-3)
    losses = [loss for _, loss in fit.material["loss_factor"]]
    np.testing.assert_allclose(losses, impact_sounds.LOSS, rtol=0.05)


def test_the_picture_is_of_the_width_of_a_page(struck):
    with Image.open(struck[0] / "sounds.webp") as picture:
        assert picture.size == (1200, 1100)
    assert 20_000 < (struck[0] / "sounds.webp").stat().st_size < 150_000
