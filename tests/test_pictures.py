"""Pictures that a user gives."""

import io
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from refusals import refused

from objectfolder.base.pictures import PICTURE_FORMATS, decoded
from objectfolder.benchmarks.tasks.photograph import read_picture
from objectfolder.touch.photographs import read_photograph
from objectfolder.touch.profiles import load_profile

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 40 30\n%%EndComments\nshowpage\n"


def encoded(kind, **options):
    stream = io.BytesIO()
    Image.new("RGB", (40, 30), (200, 100, 50)).save(stream, kind, **options)
    return stream.getvalue()


@pytest.mark.parametrize("kind", PICTURE_FORMATS)
def test_known_formats_are_decoded_whatever_their_name(tmp_path, kind):
    path = tmp_path / "picture.eps"
    path.write_bytes(encoded(kind))
    np.testing.assert_allclose(np.asarray(decoded(path, "it")), np.full((30, 40, 3), [200, 100, 50]), atol=3)
    assert decoded(io.BytesIO(path.read_bytes()), "it", "RGBA").mode == "RGBA"


@pytest.mark.parametrize("content", [EPS, encoded("GIF"), encoded("ICO"), encoded("PDF"), encoded("PPM")])
def test_other_formats_reach_no_decoder(tmp_path, monkeypatch, content):
    def run(*arguments, **options):
        raise AssertionError("a program was started")

    for name in ("Popen", "run", "call", "check_call", "check_output"):
        monkeypatch.setattr(subprocess, name, run)
    path = tmp_path / "t.png"
    path.write_bytes(content)
    for read, *given in ((decoded, "t.png"), (read_picture,), (read_photograph, load_profile("digit"))):
        refused(r"t\.png.* cannot be read as an image .*expected PNG, JPEG", read, path, *given)


@pytest.mark.parametrize(("width", "height"), [(8192, 8193), (65536, 1025), (16384, 16384)])
def test_too_many_pixels_are_refused_before_they_are_decoded(tmp_path, width, height):
    path = tmp_path / "t.png"
    Image.new("1", (width, height)).save(path)
    # As bits, 32 MB; as decoded pixels, a gigabyte: what this process may not have.
    code = (
        "import resource, sys; from pathlib import Path; from objectfolder.base.pictures import decoded\n"
        "used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + (24 << 20),) * 2)\n"
        "try: decoded(Path(sys.argv[1]), 'it')\n"
        "except ValueError as error: print(error)\n"
    )
    ran = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
    assert "pixels, expected at most 8192 x 8192; resize it" in ran.stdout


def test_a_picture_is_turned_as_its_camera_was_held(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    path = tmp_path / "t.jpg"
    path.write_bytes(encoded("JPEG", exif=exif))
    assert decoded(path, "it", upright=True).size == (30, 40)
    assert decoded(path, "it").size == (40, 30)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("PNG", np.uint16([[0, 257, 25700, 65535]])),
        ("TIFF", np.uint16([[0, 257, 25700, 65535]])),
        ("TIFF", np.int32([[-9, 257, 25700, 70000]])),
        ("TIFF", np.float32([[-1, 1 / 255, 100 / 255, 1.5]])),
        ("TIFF", np.float32([[np.nan, 1 / 255, 100 / 255, np.inf]])),
    ],
)
@pytest.mark.parametrize("upright", [False, True])
def test_greys_of_other_widths_keep_their_brightness(tmp_path, kind, values, upright):
    path = tmp_path / "t.bin"
    Image.fromarray(values).save(path, kind)
    found = np.asarray(decoded(path, "it", upright=upright))
    np.testing.assert_array_equal(found, np.repeat([[[0], [1], [100], [255]]], 3, 2))
