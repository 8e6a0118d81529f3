import numpy as np
import pytest
import torch
from refusals import refused
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y
from splats import plain, rasterise, scores

from objectfolder.cli import app
from objectfolder.objectfile import splats as module
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.splats import Splats, harmonics, splats, spread_points, write_splats
from objectfolder.vision.cameras import Intrinsics, look_at


@pytest.fixture(scope="module", autouse=True)
def few_views():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "VIEWS", 16)
        patch.setattr(module, "PIXELS", 256)
        yield


@pytest.fixture(scope="module")
def die():
    return ObjectFile.sample("die")


@pytest.fixture(scope="module")
def cloud(die, few_views):
    return splats(die, 20000)


def read(path):
    """Names and values (N, P) of a .ply of floats."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").split("\n")
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    table = np.frombuffer(body, "<f4").reshape(-1, len(names))
    assert f"element vertex {len(table)}" in lines
    return names, table


def test_a_ply_has_the_properties_of_gaussian_splatting(brick, tmp_path):
    path = write_splats(brick, tmp_path, 500, 1)
    names, table = read(path)
    expected = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    expected += [f"f_rest_{k}" for k in range(9)] + ["opacity", "scale_0", "scale_1", "scale_2"]
    assert names == [*expected, "rot_0", "rot_1", "rot_2", "rot_3"]
    assert path == tmp_path / "brick" / "brick.ply"
    assert np.isfinite(table).all()
    found = dict(zip(names, table.T))
    center = np.stack([found[name] for name in "xyz"], 1)
    assert (abs(center) <= brick.bounds[1] + 1e-6).all()
    w, x, y, z = (found[f"rot_{k}"] for k in range(4))
    turned = Rotation.from_quat(np.stack([x, y, z, w], 1)).apply([0, 0, 1])
    np.testing.assert_allclose(turned, np.stack([found[f"n{name}"] for name in "xyz"], 1), atol=1e-5)
    assert (found["scale_2"] < found["scale_0"] - 2).all()
    refused("exists already", write_splats, brick, tmp_path, 500, 1)


def test_harmonics_are_orthonormal_and_complete():
    """Each is a combination of SciPy's of its degree, and the first of each pair has the sign of splats."""
    ways = np.random.default_rng(0).normal(size=(200, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    polar, around = np.arccos(ways[:, 2]), np.arctan2(ways[:, 1], ways[:, 0])
    found = harmonics(ways, 3)
    for degree in range(4):
        rows = np.stack([sph_harm_y(degree, m, polar, around) for m in range(-degree, degree + 1)], 1)
        mix, *_ = np.linalg.lstsq(rows, found[:, degree**2 : (degree + 1) ** 2].astype(complex))
        np.testing.assert_allclose(rows @ mix, found[:, degree**2 : (degree + 1) ** 2], atol=1e-12)
        np.testing.assert_allclose(mix.conj().T @ mix, np.eye(2 * degree + 1), atol=1e-12)
    x = harmonics(np.eye(3)[:1], 1)[0]
    np.testing.assert_allclose(x, [0.28209479, 0, 0, -0.48860251], atol=1e-8)


def test_points_are_spread_evenly(die):
    points = spread_points(die, 5000)
    assert len(points) == pytest.approx(5000, rel=0.1)
    away = torch.from_numpy(points.astype(np.float32))
    assert abs(die.surface.grid.distance(away)).max() < 0.01
    spread, drawn = (nearest(rows) for rows in (points, die.sample_surface(len(points)) / die.scale))
    assert spread.std() / spread.mean() < 0.75 * drawn.std() / drawn.mean()


def nearest(points):
    return cKDTree(points).query(points, 2)[0][:, 1]


def test_splats_look_as_the_object(die, cloud):
    """At 20,000 splats, a fifth of the default."""
    found = scores(die, {"fitted": cloud, "plain": plain(die, cloud)}, cameras=2)
    assert found["fitted"].min() > 25
    assert found["fitted"].min() > found["plain"].max() + 3


def test_the_rasteriser_blends_by_depth():
    """A red splat before a green one of half its opacity, on white."""
    turn = np.array([[1.0, 0, 0, 0]] * 2)
    colors = np.array([[[1, 0, 0]], [[0, 1, 0]]]) / 0.28209479177387814 - 0.5 / 0.28209479177387814
    points = np.array([[0, 0, 0.5], [0, 0, 0.0]])
    two = Splats(points, points, np.full((2, 3), 0.3), turn, np.array([0.8, 0.4]), colors)
    image = rasterise(two, look_at(np.array([[0, 1e-6, 2.5]]))[0], Intrinsics(33, 33, 40.0))
    np.testing.assert_allclose(image[16, 16], [0.8 + 0.2 * 0.6, 0.2 * (0.4 + 0.6), 0.2 * 0.6], atol=2e-3)


def test_bad_arguments_are_refused(brick):
    refused("degree is 4, expected 0 to 3", splats, brick, 500, 4)
    refused("count", splats, brick, 3)
    refused("there is no light", splats, brick, 500, 0, None)


def test_the_command_writes_a_file_for_each_object(brick_path, tmp_path, capsys):
    words = ["export", "splats", str(brick_path), str(tmp_path), "--count", "300", "--degree", "0"]
    app(words, standalone_mode=False)
    names, table = read(tmp_path / "brick" / "brick.ply")
    assert len(names) == 17
    assert len(table) == pytest.approx(300, rel=0.3)
    assert capsys.readouterr().out.strip() == str(tmp_path / "brick" / "brick.ply")
    other = [*words[:3], str(tmp_path / "new"), "--lights", "none.npy"]
    refused("--lights none.npy does not exist; expected studio", app, other, standalone_mode=False)
