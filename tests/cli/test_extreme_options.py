"""Options beyond what a machine or a file can hold end in one line that says so."""

import subprocess
import sys

import numpy as np
import pytest
from disks import small_disk
from typer.testing import CliRunner

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app

MAIN = "from objectfolder.cli import main; main()"


@pytest.fixture
def asked(brick_path, tmp_path):
    """Run a command; FILE, VIEWS, STRIKES and OUT stand for paths. Returns the error."""
    np.save(tmp_path / "views.npy", [[2.0, 1, 1, 0.5, 0.5, 1]])
    np.save(tmp_path / "strikes.npy", [[0.0, 0, 0.015, 0, 0, 1]])
    paths = {
        **{"FILE": brick_path, "VIEWS": tmp_path / "views.npy", "STRIKES": tmp_path / "strikes.npy"},
        "OUT": tmp_path / "out",
    }

    def run(*words):
        done = CliRunner().invoke(app, [str(paths.get(word, word)) for word in words])
        assert not (tmp_path / "out").exists()
        if isinstance(done.exception, SystemExit):
            assert done.exit_code == 2
            return done.output
        assert isinstance(done.exception, ObjectFolderError)
        assert len(str(done.exception)) < 1000
        return str(done.exception)

    return run


def test_more_pixels_than_memory(asked):
    message = asked("query", "vision", "FILE", "VIEWS", "OUT", "--resolution", "1000000")
    assert "1 images of 1000000 x 1000000 pixels: needs 64,000,000,000,000 bytes, this machine has" in message
    assert "ask for a lower resolution" in message


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("--duration", "1e9", "a WAV file holds at most 1,073,741,724 samples"),
        ("--duration", "nan", "duration is nan, expected a finite number"),
        ("--duration", "inf", "duration is inf, expected a finite number"),
        ("--duration", "1e308", "both must be positive"),
        ("--duration", "0", "both must be positive"),
        ("--sample-rate", "2147483648", "--sample-rate"),
        ("--sample-rate", "0", "--sample-rate"),
        ("--sample-rate", "-16000", "--sample-rate"),
        ("--sample-rate", "nan", "--sample-rate"),
        (
            "--scale",
            "1e-300",
            "scale is 1e-300, expected the object's longest side in metres, 1e-12 to",
        ),
        ("--scale", "-1", "scale is -1.0"),
        ("--scale", "1e300", "scale is 1e+300, expected the object's longest side"),
        ("--contact-time", "inf", "contact time is inf"),
        ("--contact-time", "-1", "contact time is -1.0 s"),
        ("--material", "x" * 5000, "unknown material 'xxx"),
    ],
)
def test_sounds_beyond_files_or_numbers(asked, option, value, expected):
    assert expected in asked("query", "audio", "FILE", "STRIKES", "OUT", option, value)


def test_more_sound_than_memory(brick):
    with pytest.raises(ObjectFolderError, match=r"1 sounds of 16,000,000,000,000 samples .*: needs 128,000"):
        brick.impact([[0, 0, 0.015]], [[0, 0, 1.0]], duration=1e9)


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("--duration", "1e9", "48,000,000,000,000 samples of sound: needs 576,000,000,000,000 bytes"),
        ("--duration", "1e308", "samples of sound: needs"),
        ("--duration", "inf", "seconds of a turntable is inf, expected a finite number"),
        ("--duration", "nan", "seconds of a turntable is nan, expected a finite number"),
        ("--duration", "-1", "seconds of a turntable is -1.0, expected more than 0"),
        ("--resolution", "1000000", "a picture of 1000000 x 1000000 pixels: needs"),
        ("--resolution", "2", "--resolution"),
        ("--size", "2", "--resolution"),
        ("--fps", "0", "--fps"),
        ("--fps", "9223372036854775807", "--fps"),
        ("--contacts", "0", "--contacts"),
        ("--contacts", "1000000000000", "1,000,000,000,000 tactile images: needs"),
        ("--seed", "-1", "--seed"),
        ("--seed", "9223372036854775808", "seed of a turntable is 9223372036854775808, expected a whole"),
    ],
)
def test_films_beyond_numbers_or_memory(asked, monkeypatch, option, value, expected):
    monkeypatch.setattr("shutil.which", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr("subprocess.Popen", lambda *words, **options: pytest.fail("the film was begun"))
    assert expected in asked("video", "FILE", "--out", "out.mp4", option, value)


@pytest.mark.parametrize("command", [("info",), ("sample", "audio")])
def test_a_name_that_is_too_long(asked, command):
    assert "cannot be read: File name too long" in asked(
        *command, "x" * 5000, *["a.npy"] * (len(command) - 1)
    )


def test_more_rows_than_memory(asked, tmp_path):
    message = asked("sample", "vision", str(tmp_path / "v.npy"), "-n", str(10**15))
    assert "1000000000000000 views: needs" in message


@pytest.mark.parametrize(
    "words", [("sensor", "list"), pytest.param(("info", "FILE"), marks=pytest.mark.slow)]
)
def test_a_full_device_as_output(brick_path, words):
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(
            [sys.executable, "-c", MAIN, *(str(brick_path) if word == "FILE" else word for word in words)],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.stderr == "error: the output: No space left on device; make space, or write elsewhere\n"
    assert done.returncode == 1


@pytest.mark.slow
def test_a_full_disk_is_named(brick_path, tmp_path):
    np.save(tmp_path / "strikes.npy", [[0.0, 0, 0.015, 0, 0, 1]])
    words = ["query", "audio", brick_path, tmp_path / "strikes.npy", tmp_path / "out"]
    with small_disk(tmp_path / "out", "100k"):
        done = subprocess.run(
            [sys.executable, "-c", MAIN, *map(str, words)], capture_output=True, text=True, check=False
        )
        assert list((tmp_path / "out").iterdir()) == []
    assert f"error: {tmp_path}/out/1.wav: No space left on device" in done.stderr
    assert done.returncode == 1


def test_a_place_that_cannot_be_written_is_named(brick_path, tmp_path):
    (tmp_path / "file").write_text("")
    words = ["export", "nerfstudio", brick_path, tmp_path / "file" / "out"]
    done = subprocess.run(
        [sys.executable, "-c", MAIN, *map(str, words)], capture_output=True, text=True, check=False
    )
    place = f"{tmp_path}/file/out: {tmp_path}/file is not a folder that you may write in"
    assert done.stderr.startswith(f"error: cannot write {place}; make it one, or choose another name")
    assert done.returncode == 1
