import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.touch import lightfit
from objectfolder.touch.ball import BallModel
from objectfolder.touch.calibration import fit_sensor_lights
from objectfolder.touch.imprint import find_overflow
from objectfolder.touch.optics import Optics
from objectfolder.touch.photographs import read_pack
from objectfolder.touch.profiles import RESIDUAL_TERMS, Light, load_profile
from objectfolder.touch.taxim import BINS, _coarse, color_table, export_taxim

RADIUS = 0.003  # m
POSES = np.array([[30, 30, 5e-4], [28, 52, 6e-4], [52, 28, 4.5e-4], [50, 52, 5e-4]])
CIRCLE = 13.0  # pixels


@pytest.fixture(scope="module")
def profile():
    """A small sensor with a rigid gel, as it is known before the fit."""
    seen = float(2 * np.degrees(np.arctan(40 * 0.12e-3 / 0.025)))
    gel = {"gel": "rigid", "image_smoothing": 0.0, "elastomer_thickness": 4e-3}
    return replace(load_profile("gelsight_r15"), **gel, height=80, width=80, vertical_fov_deg=seen)


@pytest.fixture(scope="module")
def real(profile):
    """The sensor as it is."""
    lights = (
        Light((0.014, 0.016, 0.003), (1.0, 0.2, 0.1), 0.0012),
        Light((0.016, -0.012, 0.012), (0.1, 1.0, 0.3), 0.0008),
        Light((0.013, -0.006, -0.018), (0.2, 0.1, 1.0), 0.0015),
    )
    return replace(profile, lights=lights, ambient=0.08, gamma=1.4, roughness=0.7)


@pytest.fixture(scope="module")
def pictures(real):
    model = BallModel(real, RADIUS)
    displacements = torch.cat([model.displacement(pose) for pose in POSES])
    return Optics(real).render(displacements).numpy(), Optics(real).background.numpy()


def circles(error=0.0):
    off = np.random.default_rng(0).uniform(-error, error, (len(POSES), 2))
    return [(row + r, column + c, CIRCLE) for (row, column, _), (r, c) in zip(POSES, off)]


def photographs(shown):
    discs = [lightfit.circle_mask(circle, (80, 80)) for circle in circles()]
    return [
        lightfit.Photograph(of.astype(np.float32), disc, pose) for of, disc, pose in zip(shown, discs, POSES)
    ]


def test_derivatives_agree_with_differences(profile, real, pictures):
    surface = lightfit._Surface(
        BallModel(profile, RADIUS), pictures[1].astype(np.float32), photographs(pictures[0][:1])
    )
    moved = 0.01 * np.random.default_rng(0).uniform(0, 1, 21)
    x = lightfit._parameters(real) + moved * (np.arange(21) % 6 > 2)
    jacobian = lightfit._light_jacobian(surface, real, x)
    for j, exact in enumerate(jacobian.T):
        step = np.zeros(len(x))
        step[j] = 1e-4 if j % 6 < 3 and j < 18 else 2e-3
        ahead, behind = (surface.error(lightfit._with_lights(real, x + s * step)).ravel() for s in (1, -1))
        difference = (ahead - behind) / (2 * step[j])
        assert np.linalg.norm(difference - exact) < 0.08 * np.linalg.norm(difference) + 1e-9, j


@pytest.mark.slow
@pytest.mark.parametrize("residual", [False, True])
def test_lights_that_made_the_pictures_are_found(profile, pictures, residual):
    options = {"count": 3, "residual": residual}
    fit = fit_sensor_lights(pictures[0], RADIUS, profile, pictures[1], circles(1.0), **options)
    assert fit.psnr_after > 40
    assert fit.psnr_after > fit.psnr_before + 12
    assert bool(fit.profile.residual) == residual
    assert Optics(fit.profile).untouched.max() < 0.96
    for imprint, (row, column, _) in zip(fit.imprints, POSES):
        assert np.hypot(imprint.row - row, imprint.column - column) < 0.3


def test_residual_explains_what_the_lights_cannot(profile, real, pictures):
    coefficients = np.random.default_rng(0).normal(0, 20, (3, RESIDUAL_TERMS))
    odd = replace(real, residual=tuple(map(tuple, coefficients)))
    model = BallModel(profile, RADIUS)
    untouched = pictures[1].astype(np.float32)
    shown = Optics(odd).render(torch.cat([model.displacement(pose) for pose in POSES])).numpy()
    taken = photographs(shown)
    fitted = lightfit.fit_residual(model, real, untouched, taken)
    before, after = (lightfit.squared_error(of, RADIUS, untouched, taken) for of in (real, fitted))
    assert after < 1.0
    assert before > 20


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"circles": [(30, 30, CIRCLE)]}, "1 circles for 4 pictures"),
        ({"radius": 0.0}, "radius is 0 m"),
        ({"count": 0}, "0 lights to fit"),
    ],
)
def test_lights_need_circles_of_every_picture_and_a_ball(profile, pictures, wrong, message):
    given = {"profile": profile, "untouched": pictures[1], "radius": RADIUS, "circles": circles()} | wrong
    refused(message, fit_sensor_lights, pictures[0], **given)


def test_holes_in_white_have_overflowed():
    """Red goes on from 255 to 0; dark spots that are open to the border, or in grey, are none."""
    picture = np.full((40, 40, 3), 120, np.uint8)
    picture[5:30, 5:30, 0] = 255
    picture[10:14, 12:20, 0] = 60
    picture[20:22, 25:40, 0] = 60  # open
    picture[34:36, 10:14, 1] = 20  # in grey
    expected = np.zeros((40, 40), bool)
    expected[10:14, 12:20] = True
    assert np.array_equal(find_overflow(picture), expected)


def test_pixels_that_overflowed_do_not_count(profile, pictures):
    """Of a fit whose photographs are spoilt in a part of their discs."""
    spoilt = pictures[0].astype(int)
    spoilt[:, 26:34, 28:34, 0] = 255
    spoilt[:, 28:32, 30:32, 0] = 3
    fit = fit_sensor_lights(spoilt[:1], RADIUS, profile, pictures[1], circles()[:1], count=1)
    worse = np.where(spoilt == 3, 200, spoilt)  # whatever their value, if it is a hole
    again = fit_sensor_lights(worse[:1], RADIUS, profile, pictures[1], circles()[:1], count=1)
    assert fit.profile == again.profile


def pack(path, pictures, **changes):
    arrays = {"f0": pictures[1], "imgs": pictures[0], "touch_center": POSES[:, 1::-1]}
    arrays |= {"touch_radius": np.full(len(POSES), 13), "names": ["frame.jpg"] * 4, "img_size": (80, 80, 3)}
    np.savez(path, **(arrays | changes))
    return path


def test_pack_gives_pictures_and_circles(tmp_path, profile, pictures):
    found = read_pack(pack(tmp_path / "dataPack.npz", pictures), profile)
    assert np.array_equal(found.pictures, pictures[0])
    assert np.array_equal(found.untouched, pictures[1])
    np.testing.assert_allclose(found.circles, circles())
    half = replace(profile, height=40, width=40)
    smaller = read_pack(tmp_path / "dataPack.npz", half)
    assert smaller.pictures.shape == (4, 40, 40, 3)
    assert smaller.circles[0] == pytest.approx((14.75, 14.75, 6.5))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"imgs": np.zeros((4, 8, 8, 3), np.uint8)}, "do not fit"),
        ({"touch_center": np.zeros((3, 2))}, "do not fit"),
        ({"touch_radius": np.array(13)}, "do not fit"),
        ({"f0": np.zeros((80, 80), np.uint8), "imgs": np.zeros((4, 80, 80), np.uint8)}, "do not fit"),
        *(
            ({"imgs": scale}, "imgs has values of type float64 from .*; expected grey levels")
            for scale in (1 / 255, 2.0, -1.0)
        ),
    ],
)
def test_pack_with_other_arrays_is_refused(tmp_path, profile, pictures, changes, reason):
    if isinstance(changes.get("imgs"), float):  # another scale of grey levels
        changes = {"imgs": pictures[0] * changes["imgs"]}
    refused(reason, read_pack, pack(tmp_path / "a.npz", pictures, **changes), profile)


def test_damaged_packs_and_other_files_are_named(tmp_path, profile, pictures):
    refused("does not exist", read_pack, tmp_path / "a.npz", profile)
    whole = pack(tmp_path / "whole.npz", pictures).read_bytes()
    damaged = {"cut": whole[: len(whole) // 2], "empty": b"", "text": b"no archive"}
    for name, content in damaged.items():
        (tmp_path / f"{name}.npz").write_bytes(content)
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    np.savez(tmp_path / "alone.npz", f0=np.zeros(3))
    pickled = np.array([None], dtype=object)
    pack(tmp_path / "pickled.npz", pictures, imgs=pickled)
    for name in (*damaged, "array", "alone", "pickled"):
        with pytest.raises(ObjectFolderError, match=rf"{name}\.npz is not a calibration pack of Taxim: .*f0"):
            read_pack(tmp_path / f"{name}.npz", profile)
    pack(tmp_path / "more.npz", pictures, names=pickled)  # what is not needed is not read
    assert len(read_pack(tmp_path / "more.npz", profile).pictures) == len(POSES)


def lookup(table, displacement, pitch):
    """Colours of a height map as Taxim's renderer reads its tables; (3, H, W)."""
    down, right = np.gradient(displacement, pitch)
    step = np.pi / 2 / (BINS - 1)
    at = (
        (np.arctan(np.hypot(down, right)) / step).astype(int),
        ((np.arctan2(down, right) + np.pi) / (4 * step)).astype(int),
    )
    y, x = np.indices(displacement.shape).astype(float)
    terms = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=-1)
    return np.stack([(terms * of[at]).sum(axis=-1) for of in table])


@pytest.mark.parametrize(("isaac", "sign"), [(False, 1), (True, -1)])
def test_exported_table_shows_what_the_optics_show(tmp_path, real, isaac, sign):
    """A smooth, shallow bump, rendered with the exported files alone; Isaac Lab turns the heights' sign."""
    smooth = replace(real, residual=((5.0,) * RESIDUAL_TERMS,) * 3, slope_smoothing=0.0)
    y, x = np.indices((80, 80))
    bump = 4e-4 * np.exp(-((x - 36) ** 2 + (y - 44) ** 2) / (2 * 7**2))
    moved = torch.from_numpy(bump[None].astype(np.float32))
    expected = Optics(smooth).change(moved)[0].numpy()
    export_taxim(smooth, tmp_path, isaac)
    with np.load(tmp_path / "polycalib.npz", allow_pickle=False) as archive:
        assert archive["bins"] == BINS
        table = np.stack([archive[f"grad_{color}"] for color in "rgb"])
    found = lookup(table, sign * bump, smooth.pixel_pitch)
    error = np.sqrt(np.mean((found - expected)[:, 20:-20, 20:-20] ** 2))
    assert error < 0.06 * np.sqrt(np.mean(expected[:, 20:-20, 20:-20] ** 2))
    background = np.load(tmp_path / "real_bg.npy", allow_pickle=False)
    assert np.array_equal(background, Optics(smooth).background.numpy())
    jpeg = np.asarray(Image.open(tmp_path / "bg.jpg"), float)
    assert np.abs(jpeg - background).max() < 8


def test_exported_files_are_what_taxim_and_isaac_lab_read(tmp_path):
    """Of a real sensor, whose background is a photograph.

    Read in Taxim's ``Basics/CalibData.py`` and ``OpticalSimulation/simOptical.py``, and in Isaac Lab's
    ``isaaclab_contrib/sensors/tacsl_sensor/visuotactile_render.py``.
    """
    sensor = load_profile("gelsight_real")
    export_taxim(sensor, tmp_path)
    with np.load(tmp_path / "polycalib.npz", allow_pickle=False) as archive:
        assert {"bins", "grad_r", "grad_g", "grad_b"} == set(archive.files)
        assert archive["bins"].shape == ()
        assert np.issubdtype(archive["bins"].dtype, np.integer)
        tables = [archive[f"grad_{color}"] for color in "rgb"]
    steepest, most = (int(angle / (angle / (BINS - 1))) for angle in (np.pi / 2, 2 * np.pi))
    for table in tables:
        assert (table.dtype, table.ndim, table[steepest, most].shape) == (np.float64, 3, (6,))
        assert np.isfinite(table).all()
        middle = np.array([80.0**2, 60.0**2, 80.0 * 60.0, 80.0, 60.0, 1.0])  # grey levels there
        assert 20 < np.abs(table[:60] @ middle).max() < 512
    rest = np.load(tmp_path / "real_bg.npy", allow_pickle=False)
    assert (rest.shape, rest.dtype) == ((sensor.height, sensor.width, 3), np.float64)
    assert 50 < rest.mean() < 255
    with Image.open(tmp_path / "bg.jpg") as picture:
        assert (picture.size, picture.mode, picture.format) == ((sensor.width, sensor.height), "RGB", "JPEG")


def test_flat_gel_keeps_its_colour_in_the_table(real):
    assert not color_table(real, 8)[:, 0].any()


@pytest.mark.parametrize("size", [(160, 120), (240, 320), (154, 110)])
def test_the_table_is_of_the_view_of_the_sensor(digit, size):
    sensor = replace(digit, height=size[0], width=size[1])
    coarse = _coarse(sensor)
    assert min(coarse.height, coarse.width) < 30
    assert coarse.width / coarse.height == pytest.approx(size[1] / size[0], rel=0.003)
    if 160 in size or 320 in size:
        assert coarse.half_extent == sensor.half_extent


def sensor(*arguments):
    app(["sensor", *map(str, arguments)], standalone_mode=False)


@pytest.mark.parametrize("options", [[], ["--taxim", "a", "--isaac-lab", "b"]])
def test_exports_are_for_one_simulator(options):
    refused("one folder", sensor, "export", "digit", *options)


@pytest.mark.parametrize("option", ["--taxim", "--isaac-lab"])
def test_exports_replace_nothing(tmp_path, option):
    held = tmp_path / "bg.jpg"
    held.write_text("precious")
    for place, reason in ((held, "bg.jpg is a file, expected a folder"), (tmp_path, "it holds bg.jpg;")):
        refused(reason, sensor, "export", "digit", option, place)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("bg.jpg", "precious")]


def test_commands_fit_a_pack_and_export_it(tmp_path, pictures, profile, capsys):
    start, out = tmp_path / "start.yaml", tmp_path / "mine.yaml"
    start.write_text(json.dumps(profile.to_dict()))
    first = {"imgs": pictures[0][:1], "touch_center": POSES[:1, 1::-1], "touch_radius": [13]}
    path = pack(tmp_path / "dataPack.npz", pictures, **first)
    sensor("fit", path, "--radius", RADIUS, "--sensor", start, "--lights", 1, "--residual", "--out", out)
    fitted = load_profile(out)
    assert len(fitted.lights) == 1
    assert fitted.residual
    sensor("export", out, "--taxim", tmp_path / "taxim")
    assert "image_height=80" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "taxim").iterdir()} == {"bg.jpg", "polycalib.npz", "real_bg.npy"}


@pytest.mark.parametrize(
    ("options", "reason"), [(["--residual"], "give --lights"), (["--lights", "3"], "give --untouched")]
)
def test_options_that_lack_another_are_refused(tmp_path, pictures, options, reason):
    picture = tmp_path / "a.png"
    Image.fromarray(np.zeros((160, 120, 3), np.uint8)).save(picture)
    refused(reason, sensor, "fit", picture, "--radius", 0.004, "--out", tmp_path / "b.yaml", *options)
