import re

import numpy as np
import pytest
import soundfile
from brick import SCALE, SIDES, with_images
from refusals import refused
from scipy import stats
from typer.testing import CliRunner

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.objectfile.query_files import sample_presses, sample_strikes
from objectfolder.touch.profiles import load_profile

HALF = np.array(SIDES) * SCALE / 2
VOXEL = SCALE * 1.04 / 63


def run(*arguments):
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    if done.exception:
        raise done.exception
    return done.output


def depth_inside(points):
    """How far points lie within the brick, metres; negative outside."""
    return (HALF - np.abs(points)).min(1)


def face_of(points):
    """Which of the brick's six faces a point is on."""
    axis = np.abs(HALF - np.abs(points)).argmin(1)
    return 2 * axis + (np.take_along_axis(points, axis[:, None], 1)[:, 0] > 0)


def test_views_are_uniform_on_their_spheres_and_answered(brick_path, tmp_path):
    output = run("sample", "vision", tmp_path / "v.npy", "-n", 400, "--radius", 3, "--light-radius", 1.5)
    assert f"wrote {tmp_path / 'v.npy'} (400, 6)" in output
    rows = np.load(tmp_path / "v.npy", allow_pickle=False)
    assert rows.dtype == np.float64
    for places, radius in ((rows[:, :3], 3), (rows[:, 3:], 1.5)):
        np.testing.assert_allclose(np.linalg.norm(places, axis=1), radius, rtol=1e-12)
        # On a sphere every coordinate is uniform (Archimedes).
        for coordinate in places.T:
            assert stats.kstest(coordinate / radius, "uniform", (-1, 2)).pvalue > 1e-3
    assert abs(np.corrcoef(rows.T)[:3, 3:]).max() < 0.2
    np.save(tmp_path / "few.npy", rows[:2])
    run("query", "vision", brick_path, tmp_path / "few.npy", tmp_path / "out", "--resolution", 16)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["1.png", "2.png"]


def test_default_views_are_those_of_the_published_data(tmp_path):
    run("sample", "vision", tmp_path / "v.npy")
    rows = np.load(tmp_path / "v.npy", allow_pickle=False)
    assert rows.shape == (20, 6)
    np.testing.assert_allclose(np.linalg.norm(rows.reshape(-1, 3), axis=1), [2.5, 1] * 20, rtol=1e-12)


def test_cameras_alone_go_with_other_lights(brick_path, tmp_path):
    run("sample", "vision", tmp_path / "both.npy", "-n", 2)
    run("sample", "vision", tmp_path / "v.npy", "-n", 2, "--cameras-only")
    cameras, views = (np.load(tmp_path / name, allow_pickle=False) for name in ("v.npy", "both.npy"))
    np.testing.assert_array_equal(cameras, views[:, :3])
    run(
        *("query", "vision", brick_path, tmp_path / "v.npy", tmp_path / "out"),
        *("--lights", "studio", "--resolution", 16),
    )
    assert len(list((tmp_path / "out").iterdir())) == 2


def test_strikes_are_on_the_surface_uniform_by_area_and_push_straight_in(brick, brick_path, tmp_path):
    run("sample", "audio", brick_path, tmp_path / "s.npy", "-n", 3000, "--force", 0.25)
    points, impulses = np.hsplit(np.load(tmp_path / "s.npy", allow_pickle=False), 2)
    np.testing.assert_array_equal(points, brick.sample_surface(3000))
    assert np.abs(depth_inside(points)).max() < VOXEL / 2
    a, b, c = SIDES
    share = np.repeat([b * c, a * c, a * b], 2)
    counts = np.bincount(face_of(points), minlength=6)
    assert stats.chisquare(counts, 3000 * share / share.sum()).pvalue > 1e-3
    np.testing.assert_allclose(np.linalg.norm(impulses, axis=1), 0.25, rtol=1e-12)
    inward = np.zeros((3000, 3))
    axis, positive = np.divmod(face_of(points), 2)
    inward[np.arange(3000), axis] = 1 - 2 * positive
    flat = (np.abs(np.abs(points) - HALF) > 2 * VOXEL).sum(1) == 2  # away from edges
    assert flat.mean() > 0.5
    np.testing.assert_allclose(impulses[flat] / 0.25, inward[flat], atol=0.02)


def test_strikes_are_taps_unless_their_impulse_is_given(brick, brick_path, tmp_path):
    run("sample", "audio", brick_path, tmp_path / "s.npy", "-n", 1000)
    points, impulses = np.hsplit(np.load(tmp_path / "s.npy", allow_pickle=False), 2)
    expected = sample_strikes(brick, 1000)
    np.testing.assert_array_equal(points, expected[:, :3])
    size = np.linalg.norm(impulses, axis=1)
    np.testing.assert_allclose(impulses / size[:, None], expected[:, 3:], atol=1e-12)
    assert stats.kstest(size, "uniform", (0.01, 0.04)).pvalue > 1e-3


def test_random_strikes_go_anywhere_inward(brick):
    points, impulses = np.hsplit(sample_strikes(brick, 2000, directions="random"), 2)
    np.testing.assert_allclose(np.linalg.norm(impulses, axis=1), 1, rtol=1e-12)
    normal = np.hsplit(sample_strikes(brick, 2000), 2)[1]
    # Uniform over the hemisphere: so is the share along its axis.
    assert stats.kstest((impulses * normal).sum(1), "uniform").pvalue > 1e-3
    np.testing.assert_array_equal(points, brick.sample_surface(2000))


def test_strikes_are_answered_from_one_file_and_from_two(brick, brick_path, tmp_path):
    run("sample", "audio", brick_path, tmp_path / "s.npy", "-n", 3, "--seed", 4)
    split = ["-n", 3, "--seed", 4, "--forces", tmp_path / "f.npy"]
    output = run("sample", "audio", brick_path, tmp_path / "p.npy", *split)
    assert re.search(r"p\.npy \(3, 3\) and .*f\.npy \(3, 3\)", output)
    one, two = tmp_path / "one", tmp_path / "two"
    seconds = ["--duration", 0.05]
    run("query", "audio", brick_path, tmp_path / "s.npy", one, *seconds)
    run("query", "audio", brick_path, tmp_path / "p.npy", two, "--forces", tmp_path / "f.npy", *seconds)
    for name in ("1.wav", "2.wav", "3.wav"):
        np.testing.assert_array_equal(soundfile.read(one / name)[0], soundfile.read(two / name)[0])
    points, impulses = np.hsplit(np.load(tmp_path / "s.npy", allow_pickle=False), 2)
    assert np.abs(brick.impact(points, impulses, duration=0.05)).max(1).min() > 0


def test_touches_are_answered(brick, brick_path, tmp_path):
    names = [tmp_path / "t.npy", "--gelinfo", tmp_path / "g.npy"]
    run("sample", "touch", brick_path, *names, "-n", 3)
    run("query", "touch", brick_path, tmp_path / "t.npy", tmp_path / "out", *names[1:])
    table = np.genfromtxt(tmp_path / "out" / "contacts.csv", delimiter=",", names=True)
    assert table["area_m2"].min() > 0
    points = np.load(tmp_path / "t.npy", allow_pickle=False)
    np.testing.assert_array_equal(points, brick.sample_surface(3))
    np.testing.assert_array_equal(np.load(tmp_path / "g.npy", allow_pickle=False), sample_presses(brick, 3))
    # Without a tilt and at one depth, the points alone are a query.
    run("query", "touch", brick_path, tmp_path / "t.npy", tmp_path / "plain")
    assert (tmp_path / "plain" / "3.png").exists()


@pytest.mark.parametrize("sensor", [None, "gelsight_mini"])
def test_presses_are_uniform_in_what_the_sensor_takes(brick, sensor):
    profile = load_profile(sensor or brick.sensor)
    presses = sample_presses(brick, 1000, 3, profile if sensor else None)
    low, high = profile.press_depth
    if sensor is None:
        assert (low, high) == (0.0005, 0.002)  # as published
    for column, start, end in zip(presses.T, (0, 0, low), (np.pi / 12, 2 * np.pi, high)):
        assert start <= column.min() < column.max() <= end
        assert stats.kstest(column, "uniform", (start, end - start)).pvalue > 1e-3
    assert presses[:, 2].max() <= profile.max_indentation


def test_the_sensor_of_a_touch_sample_can_be_chosen(brick, brick_path, tmp_path):
    options = ["--gelinfo", tmp_path / "g.npy", "--sensor", "gelsight_mini", "-n", 50]
    run("sample", "touch", brick_path, tmp_path / "t.npy", *options)
    expected = sample_presses(brick, 50, sensor=load_profile("gelsight_mini"))
    np.testing.assert_array_equal(np.load(tmp_path / "g.npy", allow_pickle=False), expected)


@pytest.mark.parametrize("modality", ["vision", "audio", "touch"])
def test_the_same_seed_gives_the_same_bytes_and_another_does_not(brick_path, tmp_path, modality):
    file = [] if modality == "vision" else [brick_path]
    extra = {"vision": [], "audio": ["--directions", "random"], "touch": ["--gelinfo"]}[modality]
    bytes_of = []
    for i, seed in enumerate((7, 7, 8)):
        second = [tmp_path / f"gel{i}.npy"] if modality == "touch" else []
        run("sample", modality, *file, tmp_path / f"{i}.npy", "--seed", seed, *extra, *second)
        bytes_of.append([path.read_bytes() for path in (tmp_path / f"{i}.npy", *second)])
    assert bytes_of[0] == bytes_of[1]
    assert not any(a == b for a, b in zip(bytes_of[0], bytes_of[2]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["vision", "{out}.npz"], "out.npz: expected the name of a .npy file"),
        (
            ["vision", "{out}.npy", "--radius", "0"],
            "radius is 0.0, expected 1e-06 to 1000, in the unit frame",
        ),
        (["vision", "{out}.npy", "--radius", "1e9"], "radius is 1000000000.0, expected 1e-06 to 1000"),
        (
            ["audio", "{file}", "{out}.npy", "--force", "1e300"],
            "force is 1e+300, expected 1e-30 to 1e+30, N s",
        ),
        (["vision", "{out}.npy", "--light-radius", "nan"], "light_radius is nan"),
        (["audio", "{file}", "{file}"], "expected the name of a .npy file"),
        (["audio", "{file}", "{out}.npy", "--force", "inf"], "force is inf"),
        (["audio", "{file}", "{out}.npy", "--directions", "up"], "'up' is not one of normal, random"),
        (["audio", "{file}", "{out}.npy", "--forces", "{out}.npy"], "given twice"),
        (["audio", "{file}", "{out}.npy", "--forces", "{folder}/../{folder.name}/out.npy"], "given twice"),
        (["audio", "{out}.safetensors", "{out}.npy"], "out.safetensors does not exist"),
        (["touch", "{file}", "{out}.npy", "--sensor", "digit"], "--sensor has an effect only with --gelinfo"),
        (
            ["touch", "{file}", "{out}.npy", "--gelinfo", "{out}2.npy", "--sensor", "gelsite"],
            "unknown sensor profile 'gelsite'",
        ),
    ],
)
def test_nonsense_is_refused_and_nothing_is_written(brick_path, tmp_path, arguments, message):
    before = brick_path.read_bytes()
    arguments = [a.format(file=brick_path, out=tmp_path / "out", folder=tmp_path) for a in arguments]
    error = refused(re.escape(message), run, "sample", *arguments)
    assert "\n" not in error
    assert not list(tmp_path.iterdir())
    assert brick_path.read_bytes() == before


@pytest.mark.parametrize("option", [["-n", "0"], ["--seed", "-1"], ["-n", "x"]])
def test_counts_and_seeds_are_natural_numbers(tmp_path, option):
    done = CliRunner().invoke(app, ["sample", "vision", str(tmp_path / "v.npy"), *option])
    assert done.exit_code == 2
    assert not list(tmp_path.iterdir())


def test_an_object_that_knows_one_press_says_which(brick):
    image = with_images(brick, 0.0012, 0.0)
    for sensor in (None, load_profile("digit")):
        with pytest.raises(ObjectFolderError, match=r"brick: .* query with that depth \(--depth 0\.0012\)"):
            sample_presses(image, 3, sensor=sensor)
