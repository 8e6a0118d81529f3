from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import read_json
from objectfolder.cli import app
from objectfolder.touch.ball import _CACHED_DISPLACEMENTS, BallModel
from objectfolder.touch.calibration import fit_sensor, fit_sensor_lights
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.imprint import find_imprint
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import load_profile

RADIUS = 0.004  # m
FACTORS = (1.4, 0.7, 1.15)
PLACES = ((50, 40, 1.1e-3), (50, 80, 0.9e-3), (110, 40, 1.0e-3), (110, 80, 0.8e-3))
NOISE = 2.0  # grey levels


@pytest.fixture(scope="module")
def rigid():
    return load_profile("tacto_digit")


@pytest.fixture(scope="module")
def real(rigid):
    """The sensor as it is: other lights and another background than the profile says."""
    lights = tuple(replace(li, intensity=li.intensity * f) for li, f in zip(rigid.lights, FACTORS))
    return replace(rigid, lights=lights, background_color=(0.42, 0.3, 0.33), background_glow=0.1)


def press(profile, row, column, depth, radius=RADIUS):
    """Displacement of a rigid gel under a ball whose nearest point is ``depth`` past the gel on one ray."""
    rays, gel = ray_directions(profile), gel_depth(profile)
    at = rays[row, column] * gel[row, column]
    slope = np.hypot(at[1], at[2]) / np.sqrt(0.01 - at[1] ** 2 - at[2] ** 2)
    lean = 0.1 * profile.gel_curvature * slope / max(np.hypot(at[1], at[2]), 1e-12)
    normal = np.array([1, lean * at[1], lean * at[2]])
    centre = at + normal / np.linalg.norm(normal) * (radius - depth)
    along, square = rays @ centre, (rays**2).sum(axis=2)
    root = np.sqrt(np.maximum(along**2 - square * (centre @ centre - radius**2), 0))
    ball = np.where(root > 0, (along - root) / square, np.inf)
    return np.maximum(gel - ball, 0)[None].astype(np.float32)


@pytest.fixture(scope="module")
def pictures(real):
    optics, rng = Optics(real), np.random.default_rng(0)
    clean = [optics.render(torch.from_numpy(press(real, *place)))[0].numpy() for place in PLACES]
    return noisy(np.stack(clean), rng)


@pytest.fixture(scope="module")
def untouched(real):
    return noisy(Optics(real).background.numpy(), np.random.default_rng(1))


def noisy(images, rng):
    return np.clip(images + rng.normal(0, NOISE, images.shape), 0, 255).round().astype(np.uint8)


@pytest.mark.parametrize("with_untouched", [pytest.param(True, marks=pytest.mark.slow), False])
def test_lights_and_background_are_found(rigid, real, pictures, untouched, with_untouched):
    fit = fit_sensor(pictures, RADIUS, rigid, untouched if with_untouched else None)
    factors = {light.color: light.factor for light in fit.lights}
    for light, factor in zip(rigid.lights, FACTORS):
        assert factors[light.color] == pytest.approx(factor, rel=0.02)
    for light, truth in zip(fit.profile.lights, real.lights):
        assert light.intensity == pytest.approx(truth.intensity, rel=0.05)
    error = fit.background.astype(float) - Optics(real).background.numpy()
    assert np.sqrt(np.mean(error**2)) < 1.1 * NOISE
    for imprint, (row, column, depth) in zip(fit.imprints, PLACES):
        assert abs(imprint.row - row) < 0.5
        assert abs(imprint.column - column) < 0.5
        assert imprint.depth == pytest.approx(depth, rel=0.05)
    # What is left is the pictures' noise, and the untouched picture's.
    assert fit.psnr_after == pytest.approx(
        20 * np.log10(255 / NOISE / (2**0.5 if with_untouched else 0.75**0.5)), abs=0.3
    )
    assert fit.psnr_after > fit.psnr_before


@pytest.mark.slow
def test_standard_errors_of_factors_are_those_of_repeated_fits(rigid, real):
    """The image of a rigid gel jumps at the rim, where one-sided differences mislead the fit."""
    radius, depth, optics, errors = 0.0025, 5e-4, Optics(real), []
    moved = torch.from_numpy(np.concatenate([press(real, *place[:2], depth, radius) for place in PLACES]))
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        rest, shown = (noisy(images.numpy(), rng) for images in (optics.background, optics.render(moved)))
        fit = fit_sensor(shown, radius, rigid, rest)
        factors = {light.color: factor for light, factor in zip(rigid.lights, FACTORS)}
        errors += [(light.factor - factors[light.color]) / light.error for light in fit.lights]
        assert max(light.error / light.factor for light in fit.lights) < 0.035
        for imprint, (row, column, _) in zip(fit.imprints, PLACES):
            assert np.hypot(imprint.row - row, imprint.column - column) < 0.25
            assert imprint.depth == pytest.approx(depth, rel=0.04)
    assert np.sqrt(np.mean(np.square(errors))) < 1.5


def test_imprints_are_found_by_their_change(pictures, untouched):
    for picture, (row, column, depth) in zip(pictures, PLACES):
        found = find_imprint(picture.astype(np.float32) - untouched)
        assert np.hypot(found[0] - row, found[1] - column) < 2
        assert 0.6 < found[2] / (np.sqrt(2 * depth / (1 / RADIUS + 30)) / 0.000159) < 1.5


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        (np.s_[70:78, 20:100], r"not the imprint of a ball \(80 x 8 pixels"),
        (np.s_[0:20, 40:60], "cut off by the picture's border"),
    ],
)
def test_imprint_of_no_ball_is_refused(place, reason):
    change = np.zeros((160, 120, 3), np.float32)
    change[place] = 40
    refused(reason, find_imprint, change)


SAME = [(50.0, 40.0, 12.0)] * 3


@pytest.mark.parametrize(
    ("chosen", "options", "reason"),
    [
        ([0], {}, r"^1 picture cannot determine the background: "),
        ([0, 0, 0], {"circles": SAME}, "at the same position"),
        ([0, 1, 2, 3], {"circles": SAME[:1]}, "1 circles for 4 pictures"),
        ([0, 1], {"radius": 0.0, "untouched": True}, "radius is"),
        ([0, 1], {"radius": -1.0, "untouched": True}, "radius is"),
        ([0, 1], {"radius": np.nan, "untouched": True}, "radius is"),
        ([0, 1], {"radius": 4.0, "untouched": True}, r"radius is 4 m, .* did you mean 0\.004, in metres"),
        ([-1, 0], {"names": ["blank.png", "b.png"], "untouched": True}, r"blank\.png: no imprint"),
    ],
)
def test_pictures_that_cannot_be_fitted_are_refused(rigid, pictures, untouched, chosen, options, reason):
    shown = np.concatenate([pictures, untouched[None]])[chosen]  # the last one has no imprint
    options = {"radius": RADIUS, "untouched": False} | options
    rest = untouched if options.pop("untouched") else None
    refused(reason, fit_sensor, shown, options.pop("radius"), rigid, rest, **options)


def test_a_model_keeps_the_gel_under_the_last_poses_alone(rigid):
    model = BallModel(rigid, RADIUS)
    poses = np.linspace([20, 20, 5e-4], [60, 60, 5e-4], _CACHED_DISPLACEMENTS + 1)
    first = model.displacement(poses[0])
    assert model.displacement(poses[0]) is first
    for pose in poses[1:]:
        last = model.displacement(pose)
    assert model.displacement(poses[-1]) is last
    assert model.displacement(poses[0]) is not first


OUTSIDE = (-1, 40, 12), (50, 120, 12), (160, 40, 12), (np.nan, 40, 12), (50, np.inf, 12)


@pytest.mark.parametrize("circle", [*OUTSIDE, (50, 40, 0), (50, 40, -3), (50, 40, np.nan)])
def test_circles_beside_their_picture_are_refused(rigid, pictures, untouched, circle):
    given, names = [(50.0, 40.0, 12.0), circle], ["a.png", "b.png"]
    for fit in (fit_sensor, fit_sensor_lights):
        with pytest.raises(ObjectFolderError, match=r"b\.png: the circle is .* picture of 160 x 120 pixels"):
            fit(pictures[:2], RADIUS, rigid, untouched, given, names)


def test_lights_need_pixels_in_each_circle(rigid, pictures, untouched):
    given, names = [(50.0, 40.0, 12.0), (50.5, 80.5, 0.2)], ["a.png", "b.png"]
    with pytest.raises(ObjectFolderError, match=r"b\.png: the circle covers 0 pixels .* at least 50"):
        fit_sensor_lights(pictures[:2], RADIUS, rigid, untouched, given, names)


def fit(*arguments):
    app(["sensor", "fit", *map(str, arguments)], standalone_mode=False)


def test_command_writes_a_profile_that_loads(tmp_path, real, pictures, untouched):
    paths = []
    for name, picture in zip(("rest", "a", "b"), (untouched, *pictures[:2])):
        paths.append(tmp_path / f"{name}.png")
        Image.fromarray(picture).save(paths[-1])
    out = tmp_path / "mine.yaml"
    circles = ["--circle", "50,40,12", "--circle", "50,80,11"]
    fit(
        *paths[1:],
        "--untouched",
        paths[0],
        "--radius",
        RADIUS,
        "--sensor",
        "tacto_digit",
        "--out",
        out,
        *circles,
    )
    mine = load_profile(out)
    assert mine.name == "mine"
    assert "fitted to 2 images" in mine.source
    for light, truth in zip(mine.lights, real.lights):
        assert light.intensity == pytest.approx(truth.intensity, rel=0.06)
    assert np.array_equal(Optics(mine).background.numpy(), untouched)
    report = read_json(tmp_path / "mine_report.json")
    assert report["psnr_after"] > report["psnr_before"]
    assert len(report["lights"]) == 3


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--circle", "50,40"], "--circle '50,40' is not ROW,COLUMN,RADIUS"),
        (["--out", "mine.png"], "--out is mine.png"),
        (["--sensor", "gelsite"], "'gelsite'"),
        ([], r"absent\.png.* does not exist"),
    ],
)
def test_command_names_what_is_wrong(options, reason, tmp_path, untouched):
    Image.fromarray(untouched).save(tmp_path / "a.png")
    picture = tmp_path / ("a.png" if options else "absent.png")
    refused(reason, fit, picture, "--radius", 0.004, "--out", tmp_path / "b.yaml", *options)
