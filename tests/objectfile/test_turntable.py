"""An object on a turntable."""

import json
import math
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from brick import with_images
from refusals import refused
from scipy.signal import correlate

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.objectfile.turntable import FACING, LOUDEST, SMALLEST, Turntable, contacts, pictures, sound

SHORT = Turntable(seconds=0.4, size=64, rate=10, contacts=2)


@pytest.fixture(scope="module")
def found(brick):
    return contacts(brick, SHORT)


def test_contacts_lie_on_the_surface_and_face_the_camera(brick, found):
    assert len(found) == SHORT.contacts
    for contact in found:
        point = contact.point / brick.scale
        assert brick.nearest(contact.point[None])[1][0] < 1e-6
        toward = SHORT.camera(contact.second) - point
        # The way to the camera differs by up to 14 degrees from that at the middle of the brick.
        assert contact.normal @ toward / np.linalg.norm(toward) > math.cos(math.acos(FACING) + 0.25)
    assert contacts(brick, SHORT)[0].point.tolist() == found[0].point.tolist()


def test_pictures_show_the_object_and_what_is_felt(brick, found):
    frames = list(pictures(brick, SHORT, found))
    assert len(frames) == len(SHORT) == 4
    assert {(shot.shape, str(shot.dtype)) for shot in frames} == {((64, 64, 3), "uint8")}
    corner = np.array([shot[48:63, 55:62].mean() for shot in frames])
    assert corner[0] == 255  # before the first contact
    assert corner[-1] < 250
    tiny = replace(SHORT, size=SMALLEST)
    assert {shot.shape for shot in pictures(brick, tiny, found)} == {(SMALLEST, SMALLEST, 3)}
    file = with_images(brick, 0.0015, 0.3)  # a net of one press is asked for that
    assert len(list(pictures(file, SHORT, found))) == 4


def test_strikes_are_heard_when_they_are_seen(brick, found):
    heard = sound(brick, SHORT, found)
    assert len(heard) == round(0.4 * SHORT.sample_rate)
    assert np.abs(heard).max() == pytest.approx(LOUDEST)
    first = round(found[0].second * SHORT.sample_rate)
    assert not heard[:first].any()
    assert heard[first : first + 2000].any()
    assert not sound(brick, SHORT, []).any()
    few = Turntable(seconds=1.4, size=32, rate=1, contacts=4)  # one picture: the track ends after a second
    assert len(sound(brick, few, contacts(brick, few))) == few.sample_rate


def test_spectrograms_are_heard_at_the_rate_of_the_track(spectrograms, found):
    heard = sound(spectrograms, SHORT, found)
    assert len(heard) == round(0.4 * SHORT.sample_rate)
    assert np.abs(heard).max() == pytest.approx(LOUDEST)
    first, second = (round(contact.second * SHORT.sample_rate) for contact in found)
    assert not heard[:first].any()
    strike = found[0].point[None], -found[0].normal[None]
    stored = spectrograms.impact(*strike, duration=0.2)[0]
    likeness = np.corrcoef(heard[first : min(first + 9000, second) : 3], stored[:3000])[0, 1]
    assert likeness > 0.9


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        *(("seconds", 0, "more than 0"), ("seconds", math.inf, "a finite number")),
        *(
            ("size", SMALLEST - 1, "a whole number of at least 16"),
            ("seed", -1, "a whole number of at least 0"),
        ),
        *((name, 0, "a whole number of at least 1") for name in ("rate", "contacts", "sample_rate")),
        ("rate", 2.5, "a whole number of at least 1"),
    ],
)
def test_a_turntable_refuses_odd_numbers(name, value, expected):
    refused(f"{name} of a turntable is {value}, expected {expected}", Turntable, **{name: value})


def film(*arguments):
    app(["video", *map(str, arguments)], standalone_mode=False)


def test_video_says_what_it_needs(brick_path, tmp_path, monkeypatch):
    refused(r"a name that ends in \.mp4", film, brick_path, "--out", tmp_path / "a.gif")
    with pytest.raises(ObjectFolderError, match="resolution is 63, expected an even number"):
        film(brick_path, "--out", tmp_path / "a.mp4", "--size", 63)
    monkeypatch.setattr("shutil.which", lambda program: None)
    refused("apt-get install ffmpeg", film, brick_path, "--out", tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(shutil.which("ffprobe") is None, reason="needs the program ffmpeg")
def test_a_video_has_all_pictures_and_the_sound(brick, brick_path, tmp_path, found):
    out = tmp_path / "a.mp4"
    film(brick_path, "--out", out, "--seconds", 0.4, "--size", 64, "--rate", 10, "--contacts", 2)
    probe = ["ffprobe", "-v", "error", "-show_streams", "-of", "json", str(out)]
    streams = json.loads(subprocess.check_output(probe))["streams"]
    picture, track = sorted(streams, key=lambda stream: stream["codec_type"], reverse=True)
    assert (picture["codec_name"], picture["width"], picture["nb_frames"]) == ("h264", 64, "4")
    assert track["codec_name"] == "aac"
    decode = ["ffmpeg", "-v", "error", "-i", str(out), "-f", "f32le", "-ac", "1", "-"]
    heard, made = np.frombuffer(subprocess.check_output(decode), np.float32), sound(brick, SHORT, found)
    likeness = correlate(heard, made).max() / np.linalg.norm(heard) / np.linalg.norm(made)
    assert likeness > 0.9
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs the program ffmpeg")
def test_an_encoder_that_fails_leaves_nothing(brick_path, tmp_path, monkeypatch):
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\necho no such encoder >&2\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr("shutil.which", lambda name: str(program))
    with pytest.raises(ObjectFolderError, match="ffmpeg failed: no such encoder"):
        film(brick_path, "--out", tmp_path / "a.mp4", "--seconds", 0.4, "--size", 64, "--rate", 10)
    assert [path.name for path in tmp_path.iterdir()] == ["bin"]
