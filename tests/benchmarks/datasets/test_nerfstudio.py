"""Views for Nerfstudio: what transforms.json says of each picture is true."""

import json

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from objectfolder.benchmarks.datasets.nerfstudio import straight, write_nerfstudio
from objectfolder.cli import app
from objectfolder.errors import ObjectFolderError


@pytest.fixture(scope="module")
def path(brick, tmp_path_factory):
    return write_nerfstudio(brick, tmp_path_factory.mktemp("views"), views=3, resolution=48)


def test_each_frame_is_the_answer_from_its_camera_under_its_light(brick, path):
    described = json.loads(path.read_text())
    assert (described["w"], described["h"]) == (48, 48)
    assert described["scale_m"] == brick.scale
    assert len(described["frames"]) == len(list((path.parent / "images").iterdir())) == 3
    for frame in described["frames"]:
        answer = brick.render(np.array(frame["transform_matrix"]), frame["light_position"], resolution=48)
        with Image.open(path.parent / frame["file_path"]) as image:
            np.testing.assert_array_equal(np.asarray(image), straight(answer.rgba[0]))


def test_the_pose_projects_the_object_where_it_is_drawn(brick, path):
    """By the pinhole of the format: the surface covers the same rectangle as the picture."""
    described = json.loads(path.read_text())
    points = brick.surface.vertices
    for frame in described["frames"]:
        world_to_camera = np.linalg.inv(frame["transform_matrix"])
        x, y, z = (points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]).T
        column = described["fl_x"] * x / -z + described["cx"]
        row = described["fl_y"] * -y / -z + described["cy"]
        with Image.open(path.parent / frame["file_path"]) as image:
            drawn = np.argwhere(np.asarray(image)[..., 3] > 127)
        low, high = drawn.min(0), drawn.max(0) + 1
        np.testing.assert_allclose([row.min(), column.min()], low, atol=1)
        np.testing.assert_allclose([row.max(), column.max()], high, atol=1)


def test_colours_of_the_edge_are_not_multiplied_by_alpha():
    rgba = np.float32([[[0.25, 0.25, 0.25, 0.5], [0.5, 0.5, 0.5, 1.0], [0, 0, 0, 0]]])
    image = straight(rgba)[0]
    assert (image[0, :3] == image[1, :3]).all()
    assert image[1, 0] == 188  # sRGB of 0.5
    assert image[:, 3].tolist() == [128, 255, 0]


def test_a_fixed_light_is_that_of_all_frames(brick, tmp_path):
    path = write_nerfstudio(brick, tmp_path, 3, 8, fixed_light=True)
    lights = {tuple(frame["light_position"]) for frame in json.loads(path.read_text())["frames"]}
    assert len(lights) == 1


def test_the_command_writes_a_folder_per_object_and_keeps_what_is_there(brick_path, tmp_path):
    words = ["export", "nerfstudio", str(tmp_path / "out"), str(brick_path), "-n", "2", "--resolution", "8"]
    assert CliRunner().invoke(app, words).exit_code == 0
    assert len(json.loads((tmp_path / "out/brick/transforms.json").read_text())["frames"]) == 2
    again = CliRunner().invoke(app, words)
    assert isinstance(again.exception, ObjectFolderError)
    assert "exists already" in str(again.exception)


@pytest.mark.slow
def test_nerfstudio_reads_cameras_and_pictures(path):
    name = "nerfstudio.data.dataparsers.nerfstudio_dataparser"
    module = pytest.importorskip(name, reason="nerfstudio is not installed")
    as_written = {"orientation_method": "none", "center_method": "none", "auto_scale_poses": False}
    config = module.NerfstudioDataParserConfig(
        data=path.parent, downscale_factor=1, eval_mode="all", **as_written
    )
    found = config.setup().get_dataparser_outputs("train")
    frames = sorted(json.loads(path.read_text())["frames"], key=lambda frame: frame["file_path"])
    assert [str(file) for file in found.image_filenames] == [
        str(path.parent / frame["file_path"]) for frame in frames
    ]
    truth = np.array([frame["transform_matrix"] for frame in frames])[:, :3]
    np.testing.assert_allclose(found.cameras.camera_to_worlds, truth, atol=1e-6)
    assert float(found.cameras.cx[0]) == 24
