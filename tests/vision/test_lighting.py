"""Lights of a view: radiance is linear in them."""

import re
from functools import partial

import numpy as np
import pytest
import torch
from refusals import refused
from solids import box, isosurface, sphere, stored

from objectfolder.base.arrays import write_png
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.vision.environment import MAX_PIXEL, environment_lamps, pixel_directions, read_environment
from objectfolder.vision.lighting import (
    MAX_COLOR,
    PARALLEL_DISTANCE,
    DistantLight,
    PointLight,
    choose_lamps,
    studio,
    toward,
)
from objectfolder.vision.query import light_picture
from objectfolder.vision.radiosity import Radiosity
from objectfolder.vision.trace import trace
from objectfolder.vision.view import draw

CAMERA = [1.5, -1.2, 0.9]
LAMPS = [
    PointLight((0.5, -0.6, 0.75), (0.5, 0.2, 1.0)),
    DistantLight((-1, 2, 1), (0.3, 0.3, 0.1)),
    PointLight((-2, 1, 1), (4, 0, 2)),
]


def lambert(samples, light, pixel):
    """Shader of a white Lambertian surface."""
    way = toward(light, samples.points)
    squared = way.square().sum(1)
    cosine = (way * samples.normals).sum(1) / squared.sqrt()
    return (samples.lit * cosine.clamp(min=0) / squared)[:, None].expand(-1, 3)


@pytest.fixture(scope="module")
def ball():
    return isosurface(sphere(0.45, 5), 64)


def test_the_view_under_several_lights_is_the_sum_of_those_under_each(brick):
    single = [brick.render(CAMERA, resolution=48, lights=[lamp]) for lamp in LAMPS]
    several = brick.render(CAMERA, resolution=48, lights=LAMPS)
    expected = sum(view.rgba[..., :3].astype(np.float64) for view in single)
    assert several.rgba[..., :3].max() > 0.1
    np.testing.assert_allclose(several.rgba[..., :3], expected, rtol=1e-6, atol=1e-7)
    for name in ("alpha", "depth", "normals"):
        np.testing.assert_array_equal(getattr(several, name), getattr(single[0], name))
    np.testing.assert_array_equal(brick.view(CAMERA, resolution=48, lights=LAMPS), several.rgb)


def test_a_colour_multiplies(brick):
    white = brick.render(CAMERA, [0.5, 0.5, 0.9], 32).rgba
    tinted = brick.render(CAMERA, resolution=32, lights=[PointLight((0.5, 0.5, 0.9), (2, 1, 0))]).rgba
    np.testing.assert_allclose(tinted, white * [2, 1, 0, 1], rtol=1e-6)


def test_a_white_light_of_colour_one_is_the_light_of_a_query(brick):
    rows = np.array([[0.5, 0.5, 0.9], [-1, 0.2, 0.3]])
    expected = brick.view(CAMERA, rows, 32)
    for light, image in zip(rows, expected):
        np.testing.assert_array_equal(brick.view(CAMERA, resolution=32, lights=[PointLight(light)])[0], image)


def test_all_lights_that_are_given_shine(brick):
    sky = np.zeros((8, 16, 3))
    sky[2, :2] = 3
    parts = [
        brick.render(CAMERA, resolution=24, **given).rgba[..., :3]
        for given in ({"light": [0.5, 0.5, 0.9]}, {"lights": "studio"}, {"environment": sky})
    ]
    whole = brick.render(CAMERA, [0.5, 0.5, 0.9], 24, lights="studio", environment=sky).rgba[..., :3]
    np.testing.assert_allclose(whole, sum(parts), rtol=1e-5, atol=1e-6)


def test_far_point_lights_count_as_distant_ones():
    near = PointLight([0, 0, PARALLEL_DISTANCE], [9.0, 0, 0])
    chosen = choose_lamps([near, PointLight([0, 0, 100.0], [1e4, 0, 2e4])])
    assert chosen == [near, DistantLight([0, 0, 1.0], [1.0, 0, 2.0])]


@pytest.mark.parametrize("shape", [sphere(0.45, 4), box((0.9, 0.5, 0.3))])
def test_a_distant_light_is_the_limit_of_a_far_point_light(shape):
    surface = isosurface(shape, 64)
    way = np.array([0.48, -0.64, 0.6])
    pose, intrinsics = look_at(np.array(CAMERA))[0], Intrinsics.square(48)
    exact = draw(surface, lambert, pose, DistantLight(way).place, intrinsics).rgba
    errors = []
    for distance in (50.0, 100.0):
        far = draw(surface, lambert, pose, way * distance, intrinsics).rgba[..., :3] * distance**2
        errors.append(np.abs(far - exact[..., :3]).mean())
    assert errors[1] < 0.01
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.25)  # of first order in the inverse distance


def test_interreflection_of_a_distant_light_is_the_limit_of_a_far_one():
    def bowl(x, y, z):  # light falls in and bounces
        r = np.sqrt(x**2 + y**2 + z**2)
        return np.maximum(np.maximum(r - 0.49, 0.38 - r), z - 0.1)

    surface = stored(bowl)
    radiosity = Radiosity(surface, lambda points, normals: torch.full((len(points), 3), 0.5))
    way = torch.tensor([0.36, 0.48, 0.8])
    distant = torch.cat([way, torch.zeros(1)])
    rays = np.float32(np.random.default_rng(0).normal(size=(500, 3)))
    samples = trace(surface, np.float32([0, 0, -0.1]), rays, distant.numpy())
    exact = radiosity.gather(samples, distant)
    assert exact.mean() > 0.03
    far = radiosity.gather(samples, 300 * way) * 300**2
    assert (far - exact).abs().mean() < 0.01 * exact.mean()


@pytest.mark.parametrize(("count", "worst"), [(32, 0.06), (128, 0.03)])
def test_uniform_surroundings_light_a_white_ball_evenly(ball, count, worst):
    """The integral of a radiance L over a hemisphere, times the cosine over pi, is L."""
    color = np.array([0.5, 1.0, 0.25])
    rgba = lit_by(ball, environment_lamps(np.tile(color, (64, 128, 1)), count)).rgba
    shown = rgba[rgba[..., 3] == 1][:, :3] / color
    assert shown.mean() == pytest.approx(1, abs=0.01)
    assert np.abs(shown - 1).max() < worst


def test_a_sky_lights_a_white_ball_as_its_integral(ball):
    """Half a sphere of radiance 1 above gives (1 + cos(tilt)) / 2."""
    sky = np.zeros((64, 128, 3))
    sky[:32] = 1
    picture = lit_by(ball, environment_lamps(sky, 128))
    inside = picture.rgba[..., 3] == 1
    expected = (1 + picture.normals[inside][:, 2]) / 2
    assert np.abs(picture.rgba[inside][:, 0] - expected).max() < 0.05


def lit_by(surface, lamps):
    drawer = partial(draw, surface, lambert)
    return light_picture(drawer, look_at(np.array([2.0, 0.7, 0.4]))[0], lamps, Intrinsics.square(20))


def test_lamps_keep_the_light_of_the_picture():
    picture = np.random.default_rng(0).random((24, 50, 3)) ** 8
    lamps = environment_lamps(picture)
    assert len(lamps) == 64
    weight = np.sin((np.arange(24) + 0.5) * np.pi / 24) * np.sinc(1 / 48)  # of a row: exact
    irradiance = (picture * weight[:, None, None]).sum((0, 1)) * (np.pi / 24) * (2 * np.pi / 50) / np.pi
    np.testing.assert_allclose(sum(np.array(lamp.color) for lamp in lamps), irradiance, rtol=1e-9)
    energies = [sum(lamp.color) for lamp in environment_lamps(np.ones((64, 128, 3)))]
    assert np.std(energies) < 0.1 * np.mean(energies)


def test_pixels_lie_where_the_convention_says():
    ways = {
        (16, 32): (1, 0, 0),
        (16, 16): (0, 1, 0),
        (16, 48): (0, -1, 0),
        (0, 5): (0, 0, 1),
        (16, 0): (-1, 0, 0),
    }
    for pixel, way in ways.items():
        found = pixel_directions(32, 64)[pixel]
        assert found @ way > 0.99
        picture = np.zeros((32, 64, 3))
        picture[pixel] = 1
        (lamp,) = environment_lamps(picture)
        np.testing.assert_allclose(lamp.direction, found)


def test_the_studio_is_that_of_the_page():
    key, fill, back = studio(azimuth=0, elevation=90)
    np.testing.assert_allclose(key.position, (0, 0, 2.4), atol=1e-12)
    np.testing.assert_allclose(key.color, 0.82 * 2.4**2 * np.array([1, 0.985, 0.96]))
    assert fill.position[1] < 0 < back.position[1]


def test_an_environment_is_read_from_disk(tmp_path):
    mitsuba = pytest.importorskip("mitsuba")
    import drjit

    picture = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32) * 5
    mitsuba.set_variant("scalar_rgb")
    for name, digits in (("sky.exr", 11), ("sky.pfm", 23), ("sky.hdr", 8)):
        drjit.set_thread_count(2)  # one that waits for another writes no EXR
        mitsuba.Bitmap(picture).write(str(tmp_path / name))
        drjit.set_thread_count(1)  # as renderers leave it
        most = picture.max(-1, keepdims=True)  # sets the step of the format with shared exponents
        assert (np.abs(read_environment(tmp_path / name) - picture) / most).max() < 2.0 ** (1 - digits), name
    write_png(tmp_path / "sky.png", np.full((4, 8, 3), 188, np.uint8))
    np.testing.assert_allclose(read_environment(tmp_path / "sky.png"), 0.5029, atol=1e-4)


RAMP = np.arange(1.0, 1 + 8 * 16).reshape(8, 16)
SKY = np.stack([RAMP, RAMP[::-1, ::-1], RAMP[::-1]], -1)  # whole numbers that a shared exponent keeps


def rgbe(picture, size, header=b""):
    """Write (lines, length, 3) as a Radiance file without run lengths."""
    exponents = np.frexp(picture.max(-1))[1]
    mantissas = np.ldexp(picture, 8 - exponents[..., None])
    pixels = np.concatenate([mantissas, exponents[..., None] + 128], -1).astype(np.uint8).tobytes()
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n" + header + b"\n" + size + b"\n" + pixels


@pytest.mark.parametrize(
    ("size", "turn"),
    [
        (b"-Y 8 +X 16", lambda upright: upright),
        (b"+Y 8 +X 16", lambda upright: upright[::-1]),
        (b"-Y 8 -X 16", lambda upright: upright[:, ::-1]),
        (b"+Y 8 -X 16", lambda upright: upright[::-1, ::-1]),
        (b"+X 16 -Y 8", lambda upright: upright.swapaxes(0, 1)),
        (b"-X 16 +Y 8", lambda upright: upright[::-1, ::-1].swapaxes(0, 1)),
    ],
)
def test_radiance_files_of_all_orientations_are_upright(tmp_path, size, turn):
    mitsuba = pytest.importorskip("mitsuba")
    stored = np.ascontiguousarray(turn(SKY))
    (tmp_path / "flat.hdr").write_bytes(rgbe(stored, size))
    np.testing.assert_array_equal(read_environment(tmp_path / "flat.hdr"), SKY)
    stream = mitsuba.MemoryStream()
    mitsuba.Bitmap(stored.astype(np.float32)).write(stream, mitsuba.Bitmap.FileFormat.RGBE)
    runs = stream.raw_buffer()
    lines, length = stored.shape[:2]
    plain = b"-Y %d +X %d" % (lines, length)
    assert plain in runs
    (tmp_path / "runs.hdr").write_bytes(runs.replace(plain, size))
    np.testing.assert_allclose(read_environment(tmp_path / "runs.hdr"), SKY, rtol=0.01)


def test_exposure_and_colour_correction_of_radiance_files_are_undone(tmp_path):
    pytest.importorskip("mitsuba")
    header = b"EXPOSURE=4\nEXPOSURE=  0.5\nCOLORCORR= 1 2 4\n"
    (tmp_path / "sky.hdr").write_bytes(rgbe(np.full((8, 16, 3), 8.0), b"-Y 8 +X 16", header))
    np.testing.assert_array_equal(read_environment(tmp_path / "sky.hdr"), np.full((8, 16, 3), [4, 2, 1]))


def test_old_run_lengths_of_radiance_files_are_read(tmp_path):
    pytest.importorskip("mitsuba")
    half, one = bytes([128, 128, 128, 128]), bytes([128, 0, 0, 129])
    pixels = half + bytes([1, 1, 1, 44, 1, 1, 1, 1]) + one + bytes([1, 1, 1, 18])  # 1 + 44 + 256, 1 + 18
    head = b"#?RGBE\n\n-Y 16 +X 20\n"
    (tmp_path / "old.hdr").write_bytes(head + pixels)
    picture = read_environment(tmp_path / "old.hdr").reshape(-1, 3)
    np.testing.assert_array_equal(picture[:301], 0.5)
    np.testing.assert_array_equal(picture[301:], np.full((19, 3), [1, 0, 0]))


def test_a_pfm_is_scaled(tmp_path):
    pytest.importorskip("mitsuba")
    values = np.arange(6, dtype="<f4").reshape(1, 2, 3)
    (tmp_path / "sky.pfm").write_bytes(b"PF\n2 1\n-2.5\n" + values.tobytes())
    np.testing.assert_array_equal(read_environment(tmp_path / "sky.pfm"), values * 2.5)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"#?RADIANCE\n\n-Y 8 +X 16\n" + b"\x80" * 400, "its pixels are not the 128 of its header"),
        (b"#?RADIANCE\n\n-Y 8 +Y 16\n", "it has no line of its size"),
        (b"#?RADIANCE\nGAMMA=2.2\n\n-Y 8 +X 16\n", "its gamma is 2.2, expected linear radiance"),
        (b"#?RADIANCE\nEXPOSURE=0\n\n-Y 8 +X 16\n", "EXPOSURE or COLORCORR is not a positive number"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 8 +X 16\n", "its colours are XYZ, expected RGB"),
        (b"#?RADIANCE\n\n-Y 99999 +X 99999\n", "has 99999 x 99999 pixels"),
        (b"<html>", "it begins like none of Radiance, OpenEXR and PFM files"),
    ],
)
def test_a_picture_of_radiance_is_refused_in_words(tmp_path, data, message):
    pytest.importorskip("mitsuba")
    (tmp_path / "sky.hdr").write_bytes(data)
    refused(re.escape(message), read_environment, tmp_path / "sky.hdr")


@pytest.mark.parametrize(
    ("channels", "colors"),
    [
        (["R", "G", "B", "Z", "normal.X"], [0, 1, 2]),
        (["Z", "diffuse.R", "diffuse.G", "diffuse.B"], [1, 2, 3]),
        (["diffuse.R", "diffuse.G", "diffuse.B", "R", "G", "B"], [3, 4, 5]),
        (["Y"], [0, 0, 0]),
        (["a.R", "a.G", "a.B", "b.R", "b.G", "b.B"], "layers of colours R, G and B: a, b; expected one"),
        (["Z", "U"], "layers of colours R, G and B: none"),
    ],
)
def test_the_colours_of_an_exr_are_found_among_its_channels(tmp_path, channels, colors):
    mitsuba = pytest.importorskip("mitsuba")
    import drjit

    drjit.set_thread_count(2)  # one that waits for another writes no EXR
    values = np.arange(2.0 * 3 * len(channels), dtype=np.float32).reshape(2, 3, len(channels))
    kind = mitsuba.Bitmap.PixelFormat.MultiChannel
    mitsuba.Bitmap(values, kind, channels).write(str(tmp_path / "sky.exr"))
    if isinstance(colors, str):
        refused(colors, read_environment, tmp_path / "sky.exr")
    else:
        np.testing.assert_array_equal(read_environment(tmp_path / "sky.exr"), values[..., colors])


def test_an_exr_fills_its_display_window(tmp_path):
    """Move the windows of a file: the data window is 4 x 3 pixels."""
    mitsuba = pytest.importorskip("mitsuba")
    import drjit

    drjit.set_thread_count(2)  # one that waits for another writes no EXR
    values = np.arange(1, 37, dtype=np.float32).reshape(3, 4, 3)
    mitsuba.Bitmap(values).write(str(tmp_path / "sky.exr"))
    stored = (tmp_path / "sky.exr").read_bytes()

    def read_with(display):
        start = stored.index(b"displayWindow\0box2i\0") + 24
        moved = stored[:start] + np.array(display, "<i4").tobytes() + stored[start + 16 :]
        (tmp_path / "moved.exr").write_bytes(moved)
        return read_environment(tmp_path / "moved.exr")

    np.testing.assert_array_equal(read_with([0, 0, 3, 2]), values)
    np.testing.assert_array_equal(read_with([-1, -2, 4, 3]), np.pad(values, ((2, 1), (1, 1), (0, 0))))
    np.testing.assert_array_equal(read_with([1, 1, 5, 2]), np.pad(values[1:, 1:], ((0, 0), (0, 2), (0, 0))))
    assert not read_with([10, 10, 12, 11]).any()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lights": []}, "there is no light; give light, lights or environment"),
        ({"lights": [[0, 0, 1]]}, "expected PointLight or DistantLight"),
        ({"environment": -np.ones((4, 8, 3))}, "negative or not finite"),
        ({"environment": np.full((4, 8, 3), 1e308)}, "holds the radiance 1e+308, expected at most 1e+11"),
        ({"environment": np.ones((4, 8))}, r"environment has shape (4, 8), expected (H, W, 3)"),
        ({"environment": "no.exr"}, "no.exr cannot be read"),
    ],
)
def test_lights_are_checked(brick, given, message):
    refused(re.escape(message), brick.view, CAMERA, resolution=8, **given)


@pytest.mark.parametrize(
    ("kind", "given", "message"),
    [
        (PointLight, [(0, 0, np.nan)], "expected three finite numbers"),
        (PointLight, [(0, 0, 1e4)], "expected coordinates of at most 1000"),
        (PointLight, [(0, 0, 1), (1, 1, -1)], "expected no negative number"),
        (PointLight, [(0, 0, 1), (1e39, 1, 1)], "light is (1e+39, 1.0, 1.0), expected at most 1e+12"),
        (DistantLight, [(0, 0, 1), (1, 2e20, 1)], "light is (1.0, 2e+20, 1.0), expected at most 1e+12"),
        (DistantLight, [(0, 0, 0)], "of length 0; expected a finite length above 0"),
    ],
)
def test_a_light_is_checked(kind, given, message):
    refused(re.escape(message), kind, *given)


def test_the_brightest_lights_give_a_finite_picture(brick):
    """Even on the surface, and from surroundings that become a single light."""
    color, sky = (MAX_COLOR,) * 3, np.full((1, 1, 3), MAX_PIXEL)
    lights = [PointLight(point / brick.scale, color) for point in brick.sample_surface(4)]
    seen = brick.render(CAMERA, resolution=12, lights=[*lights, DistantLight(CAMERA, color)], environment=sky)
    assert np.isfinite(seen.rgba).all()
    assert np.isfinite(seen.rgb).all()
    assert seen.rgba.max() > 1e9
