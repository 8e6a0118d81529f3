import re
import shutil
import time

import numpy as np
import pytest
import soundfile
from brick import SCALE, build_brick
from PIL import Image
from refusals import refused
from typer.testing import CliRunner

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.objectfile.file import ObjectFile
from objectfolder.vision import environment
from objectfolder.vision.lighting import PointLight


def run(*arguments):
    """Run `objectfolder`, and return its output."""
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    if done.exception:
        raise done.exception
    return done.output


def require_picture(path, image):
    with Image.open(path) as written:
        np.testing.assert_allclose(np.asarray(written) / 255, image, atol=0.5 / 255 + 1e-6)


@pytest.fixture
def strike(brick, brick_path, tmp_path):
    """Run `objectfolder query audio` on three points; returns its output and the first sound."""
    points = brick.sample_surface(3)
    np.save(tmp_path / "forces.npy", np.eye(3))

    def query(*options, size=1.0):
        np.save(tmp_path / "points.npy", points * size)
        places = brick_path, tmp_path / "points.npy", tmp_path / "out"
        output = run("query", "audio", *places, "--forces", tmp_path / "forces.npy", *options)
        return output, [soundfile.read(tmp_path / "out" / f"{i}.wav", dtype="float32") for i in (1, 2, 3)]

    return query


@pytest.mark.parametrize("supersample", [True, False])
def test_views_and_their_buffers(brick, brick_path, tmp_path, supersample):
    rows = np.array([[2.0, 1, 1, 0.5, 0.5, 1], [0, -2.0, 1, 1, 0, 0]])
    np.save(tmp_path / "queries.npy", rows)
    options = ["--resolution", "24", "--buffers", *([] if supersample else ["--no-supersample"])]
    output = run("query", "vision", brick_path, tmp_path / "queries.npy", tmp_path / "out", *options)
    assert "2 views in" in output
    expected = brick.render(rows[:, :3], rows[:, 3:], 24, supersample=supersample)
    for i in (0, 1):
        require_picture(tmp_path / "out" / f"{i + 1}.png", expected.rgb[i])
        with np.load(tmp_path / "out" / f"{i + 1}.npz", allow_pickle=False) as arrays:
            for name in ("rgba", "depth", "normals"):
                np.testing.assert_array_equal(arrays[name], getattr(expected, name)[i])


def test_paths_are_printed_as_they_are(brick, brick_path, tmp_path):
    np.save(tmp_path / "points.npy", np.c_[brick.sample_surface(1), [[0, 0, 1]]])
    out = tmp_path / "a[b" / "] [bold]"
    assert f"1 sound in {out}/" in run("query", "audio", brick_path, tmp_path / "points.npy", out)


def test_a_sound_is_the_same_bytes_at_any_time(brick, brick_path, tmp_path):
    np.save(tmp_path / "points.npy", np.c_[brick.sample_surface(1), [[0, 0, 1]]])
    for name in ("one", "two"):
        run("query", "audio", brick_path, tmp_path / "points.npy", tmp_path / name)
        time.sleep(1.1)
    one, two = ((tmp_path / name / "1.wav").read_bytes() for name in ("one", "two"))
    assert one == two
    assert soundfile.info(tmp_path / "one" / "1.wav").subtype == "FLOAT"


def test_views_under_several_lights(brick, brick_path, tmp_path):
    cameras = np.array([[2.0, 1, 1], [0, -2.0, 1]])
    lights = np.array([[0.5, 0.5, 1, 1, 0.2, 0], [1, 0, 0, 0, 0, 1]])
    np.save(tmp_path / "cameras.npy", cameras)
    np.save(tmp_path / "lights.npy", lights)
    arguments = ["query", "vision", brick_path, tmp_path / "cameras.npy", tmp_path / "out"]
    lamps = [PointLight(row[:3], row[3:]) for row in lights]
    for option, expected in ((str(tmp_path / "lights.npy"), lamps), ("studio", "studio")):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        run(*arguments, "--resolution", "24", "--lights", option)
        for i, image in enumerate(brick.view(cameras, resolution=24, lights=expected), 1):
            require_picture(tmp_path / "out" / f"{i}.png", image)
    shutil.rmtree(tmp_path / "out")
    refused(r"expected \(N, 6\), or give --lights", run, *arguments)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ([0.0, 0, 0, 0.5, 0.5, 1], "camera: row 2 is [0.0, 0.0, 0.0], expected a place that is finite"),
        ([2.0, 1, 2e3, 0.5, 0.5, 1], "camera: row 2 is [2.0, 1.0, 2000.0], expected finite coordinates"),
        ([2.0, 1, 1, 0.5, np.nan, 1], "light: row 2 is [0.5, nan, 1.0], expected finite numbers"),
    ],
)
def test_a_bad_view_is_named_and_nothing_is_written(brick_path, tmp_path, row, message):
    np.save(tmp_path / "queries.npy", [[2.0, 1, 1, 0.5, 0.5, 1]] * 2 + [row])
    with pytest.raises(ObjectFolderError, match=re.escape(message)):
        run("query", "vision", brick_path, tmp_path / "queries.npy", tmp_path / "out", "--resolution", "8")
    assert not (tmp_path / "out").exists()


def test_surroundings_are_read_once_for_all_views(brick, brick_path, tmp_path, monkeypatch):
    cameras, sky, read = np.array([[2.0, 1, 1], [0, -2.0, 1], [1, 1, 2.0]]), np.zeros((4, 8, 3)), []
    sky[1, 2:4] = 1
    monkeypatch.setattr(environment, "read_environment", lambda path: read.append(str(path)) or sky)
    np.save(tmp_path / "cameras.npy", cameras)
    arguments = ["query", "vision", brick_path, tmp_path / "cameras.npy", tmp_path / "out"]
    run(*arguments, "--resolution", "8", "--environment", "sky.exr")
    assert read == ["sky.exr"]
    for i, image in enumerate(brick.view(cameras, resolution=8, environment=sky), 1):
        require_picture(tmp_path / "out" / f"{i}.png", image)


def test_sounds_are_the_objects_at_absolute_amplitude(brick, strike):
    output, sounds = strike("--sample-rate", 22050, "--duration", 0.25, "--response", "velocity")
    expected = brick.impact(brick.sample_surface(3), np.eye(3), 22050, 0.25, "velocity")
    for (sound, rate), row in zip(sounds, expected):
        assert rate == 22050
        np.testing.assert_array_equal(sound, row)
    assert "3 sounds in" in output
    above = int((brick.frequencies >= 11025).sum())
    assert ("left out" in output) == (above > 0)


def test_modes_above_nyquist_are_counted(brick, strike):
    rate = int(2 * brick.frequencies[3]) + 2
    output, _ = strike("--sample-rate", rate, "--duration", 0.1)
    assert f"12 modes, 8 left out above half the sample rate, {rate / 2:g} Hz" in output


def test_material_scale_and_contact_time(brick, strike, caplog):
    _, sounds = strike("--material", "iron", "--scale", 2 * SCALE, "--contact-time", 0.0005, size=2)
    expected = brick.impact(
        brick.sample_surface(3) * 2, np.eye(3), material="iron", scale=2 * SCALE, contact_time=0.0005
    )
    np.testing.assert_array_equal([sound for sound, _ in sounds], expected)
    assert np.abs(expected).max() > 0
    assert "approximate" in caplog.text


def test_a_listener_hears_pascals(brick, strike):
    _, sounds = strike("--listener", 0.3, 0.1, 0.5, "--duration", 0.1)
    expected = brick.impact(brick.sample_surface(3), np.eye(3), duration=0.1, listener=[0.3, 0.1, 0.5])
    np.testing.assert_array_equal([sound for sound, _ in sounds], expected)


@pytest.mark.parametrize(
    ("options", "unit"),
    [
        ([], "m kg^1/2"),
        (["--response", "velocity"], "m kg^1/2/s"),
        (["--response", "acceleration"], "m kg^1/2/s^2"),
        (["--listener", 0.3, 0.1, 0.5], "Pa"),
    ],
)
@pytest.mark.parametrize("normalize", [False, True])
def test_the_peak_has_its_unit_and_is_that_before_normalizing(brick, strike, options, unit, normalize):
    given = {"response": options[1]} if "--response" in options else {"listener": [options[1:]]}
    expected = brick.impact(brick.sample_surface(3), np.eye(3), duration=0.1, **(given if options else {}))
    output, sounds = strike("--duration", 0.1, *options, *["--normalize"] * normalize)
    said = f"out/, peak {np.abs(expected).max():.3g} {unit}{' before normalizing' * normalize}; 12 modes"
    assert said in output
    assert ("give --normalize to listen" in output) == (not normalize)
    written = max(np.abs(sound).max() for sound, _ in sounds)
    assert written == pytest.approx(0.9 if normalize else np.abs(expected).max(), rel=1e-6)


@pytest.mark.parametrize(
    ("peak", "warning"),
    [(0.001, "is too faint to be heard"), (0.5, None), (19, "is above full scale: players clip it")],
)
def test_sounds_that_players_clip_or_nobody_hears_are_named(brick, brick_path, tmp_path, peak, warning):
    points, ear = brick.sample_surface(1), [0.3, 0.1, 0.5]
    loudest = np.abs(brick.impact(points, [[0, 0, 1]], duration=0.1, listener=ear)).max()
    np.save(tmp_path / "strike.npy", np.c_[points, [[0, 0, peak / loudest]]])
    places = brick_path, tmp_path / "strike.npy", tmp_path / "out"
    output = run("query", "audio", *places, "--duration", 0.1, "--listener", *ear)
    assert re.findall("warning: a peak of (.*); give --normalize to listen", output) == (
        [f"{peak} {warning}"] if warning else []
    )


def test_a_silent_object_says_so(brick, strike):
    output, sounds = strike("--sample-rate", int(brick.frequencies[0]), "--duration", 0.1, "--normalize")
    assert "peak 0: silent; 12 modes, 12 left out" in output
    assert "warning" not in output
    assert not any(sound.any() for sound, _ in sounds)


def test_info_says_what_is_heard_without_modes(tmp_path):
    tiny = build_brick(scale=0.002)

    def info(header):
        ObjectFile(header, tiny.tensors).save(tmp_path / "tiny.safetensors")
        return CliRunner().invoke(app, ["info", str(tmp_path / "tiny.safetensors")]).output

    assert "no modes: silent, but for its recoil at a listener" in info(tiny.header)
    del (header := dict(tiny.header))["radiation"]
    assert "no modes: silent" in (output := info(header))
    assert "recoil" not in output


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (0, np.nan, r"points: row 1 is \[nan"),
        (0, 0.5, "off the surface.*ObjectFile.nearest moves them to the surface"),
        (4, np.nan, r"forces: row 1 is \[0.0, nan"),
        (5, np.inf, "forces: row 1 is"),
    ],
)
def test_bad_strikes_are_refused_and_nothing_is_written(brick, brick_path, tmp_path, column, value, message):
    rows = np.concatenate([brick.sample_surface(3), np.zeros((3, 3))], 1)
    rows[1, column] = value
    np.save(tmp_path / "strikes.npy", rows)
    refused(message, run, "query", "audio", brick_path, tmp_path / "strikes.npy", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.fixture
def feel(brick, brick_path, tmp_path):
    """Run `objectfolder query touch` on three points; returns its output and the folder."""
    np.save(tmp_path / "points.npy", brick.sample_surface(3))

    def query(*options):
        places = brick_path, tmp_path / "points.npy", tmp_path / "out"
        return run("query", "touch", *places, *options), tmp_path / "out"

    return query


def test_touches_are_images_and_a_table_of_forces(brick, feel):
    output, out = feel("--depth", 0.0012)
    expected = brick.press(brick.sample_surface(3), 0.0012)
    assert sorted(p.name for p in out.iterdir()) == ["1.png", "2.png", "3.png", "contacts.csv"]
    for i, image in enumerate(expected.images, 1):
        with Image.open(out / f"{i}.png") as stored:
            np.testing.assert_array_equal(stored, image)
    table = np.genfromtxt(out / "contacts.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["force_N"], expected.force, rtol=1e-6)
    np.testing.assert_allclose(table["area_m2"], expected.area, rtol=1e-6)
    np.testing.assert_allclose(table["max_penetration_m"], expected.max_penetration, rtol=1e-6)
    np.testing.assert_allclose(table["obstructed"], expected.obstructed, atol=1e-9)
    assert f"force {expected.force.min():.3g} to {expected.force.max():.3g} N" in output


def test_shapes_of_touches_by_another_sensor(brick, feel):
    _, out = feel("--sensor", "gelsight_r15", "--outputs", "mask,height,normals,pressure")
    expected = brick.press(brick.sample_surface(3), sensor="gelsight_r15")
    assert not (out / "1.png").exists()
    for i in range(3):
        with Image.open(out / f"{i + 1}_mask.png") as mask:
            np.testing.assert_array_equal(np.asarray(mask) == 255, expected.mask[i])
        with np.load(out / f"{i + 1}.npz", allow_pickle=False) as arrays:
            assert set(arrays.files) == {"height", "normals", "pressure"}
            for name in arrays.files:
                np.testing.assert_array_equal(arrays[name], getattr(expected, name)[i])


def test_touches_are_sheared(brick, feel):
    names = "image,sideways,traction,marker_flow"
    output, out = feel(
        "--shear", 2e-4, -1e-4, "--twist", 0.05, "--friction", 0.4, "--markers", "--outputs", names
    )
    points = brick.sample_surface(3)
    expected = brick.press(points, shear=[2e-4, -1e-4], twist=0.05, friction=0.4, markers=True)
    table = np.genfromtxt(out / "contacts.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["shear_right_N"], expected.shear_force[:, 0], rtol=1e-6)
    np.testing.assert_allclose(table["shear_up_N"], expected.shear_force[:, 1], rtol=1e-6)
    np.testing.assert_allclose(table["torque_Nm"], expected.torque, rtol=1e-6)
    assert np.abs(expected.shear_force).min() > 0
    assert f"force {expected.force.min():.3g} to" in output
    for i in range(3):
        with Image.open(out / f"{i + 1}.png") as stored:
            np.testing.assert_array_equal(stored, expected.images[i])
        with np.load(out / f"{i + 1}.npz", allow_pickle=False) as arrays:
            assert set(arrays.files) == {"sideways", "traction", "marker_flow", "markers"}
            np.testing.assert_array_equal(arrays["markers"], expected.markers)
            for name in ("sideways", "traction", "marker_flow"):
                np.testing.assert_array_equal(arrays[name], getattr(expected, name)[i])


@pytest.fixture
def blocks_of_two(monkeypatch):
    monkeypatch.setattr("objectfolder.cli.objectfile._BATCH", 2)


@pytest.mark.usefixtures("blocks_of_two")
@pytest.mark.parametrize("rows", [1, 3])
def test_sheared_touches_in_blocks_take_one_row_or_one_each(brick, feel, tmp_path, rows):
    gelinfo = np.array([[0.1, 0.3, 0.001], [0.0, 0.0, 0.0012], [0.2, 1.0, 0.0008]])[:rows]
    np.save(tmp_path / "gelinfo.npy", gelinfo)
    _, out = feel("--gelinfo", tmp_path / "gelinfo.npy", "--twist", 0.05)
    tilt, azimuth, depth = gelinfo.T
    expected = brick.press(brick.sample_surface(3), depth, tilt=tilt, azimuth=azimuth, twist=0.05)
    table = np.genfromtxt(out / "contacts.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["torque_Nm"], expected.torque, rtol=1e-6)


@pytest.mark.usefixtures("blocks_of_two")
@pytest.mark.parametrize(
    ("point", "gelinfo", "message"),
    [
        (None, np.zeros((8, 3)), r"depth has shape \(8,\), expected one number or 3 of them"),
        (None, np.zeros((2, 3)), r"depth has shape \(2,\), expected one number or 3 of them"),
        (None, [[0, 0, 0.001], [0, 0, 0.001], [0, 0, 0.01]], "depth: row 2 is 0.01 m"),
        ([1.0, 1.0, 1.0], np.zeros((3, 3)), "the first is row 2 at"),
    ],
)
def test_sheared_touches_are_checked_before_any_is_written(brick, feel, tmp_path, point, gelinfo, message):
    points = brick.sample_surface(3)
    if point is not None:
        points[2] = point
    np.save(tmp_path / "points.npy", points)
    np.save(tmp_path / "gelinfo.npy", np.array(gelinfo))
    refused(message, feel, "--gelinfo", tmp_path / "gelinfo.npy", "--markers")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--outputs", "image,depth"], "'depth' is not one of image, mask, height"),
        (["--outputs", ""], "'' is not one of"),
        (["--outputs", "marker_flow"], "--outputs marker_flow needs --shear, --twist or --markers"),
        (["--sensor", "gelsite"], "unknown sensor profile 'gelsite'"),
        (["--depth", "0.01"], "depth: row 0 is 0.01 m"),
    ],
)
def test_touches_of_nonsense_are_refused_and_nothing_is_written(feel, tmp_path, options, message):
    refused(message, feel, *options)
    assert not (tmp_path / "out").exists()


@pytest.fixture(params=["vision", "audio", "touch"])
def ask(request, brick, brick_path, tmp_path):
    """Answer queries of each kind into a folder; ``count`` of them."""

    def run(out, count=1):
        points = brick.sample_surface(count)
        rows = {
            "vision": np.tile([2.0, 1, 1, 0.5, 0.5, 1], (count, 1)),
            "audio": np.hstack([points, np.ones((count, 3))]),
            "touch": points,
        }
        np.save(tmp_path / "rows.npy", rows[request.param])
        small = {"vision": ["--resolution", "8"], "audio": ["--duration", "0.1"], "touch": []}
        words = ["query", request.param, brick_path, tmp_path / "rows.npy", out, *small[request.param]]
        app([str(word) for word in words], standalone_mode=False)

    return run


def test_answers_never_mix_with_those_of_an_earlier_query(ask, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / ".keep").touch()
    ask(out, 2)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert len(before) > 2
    refused(r"out is not empty: it holds 1\.\w+, 2\..*; choose another name", ask, out, 1)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_file_in_place_of_the_folder_is_named_before_anything_is_computed(ask, tmp_path, monkeypatch):
    monkeypatch.setattr("objectfolder.objectfile.file.ObjectFile.load", lambda path: pytest.fail("loaded"))
    (tmp_path / "afile").touch()
    refused("afile is a file, expected a folder; choose another name", ask, tmp_path / "afile")


def test_one_answer_is_not_several(ask, tmp_path, capsys):
    ask(tmp_path / "out", 1)
    said = capsys.readouterr().out
    assert re.match(r"1 (view|sound|contact) in ", said)
