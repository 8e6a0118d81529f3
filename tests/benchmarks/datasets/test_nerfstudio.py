"""Views for Nerfstudio: what transforms.json says of each picture is true."""

import json

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from typer.testing import CliRunner

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.nerfstudio import unpremultiply, write_nerfstudio
from objectfolder.cli import app
from objectfolder.objectfile.file import ObjectFile


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
            np.testing.assert_array_equal(np.asarray(image), unpremultiply(answer.rgba[0]))


def projected(points, frame, described):
    """Rows and columns of points, by the pinhole of the format."""
    world_to_camera = np.linalg.inv(frame["transform_matrix"])
    x, y, z = (points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]).T
    return described["fl_y"] * -y / -z + described["cy"], described["fl_x"] * x / -z + described["cx"]


def test_the_pose_projects_the_object_where_it_is_drawn(brick, path):
    """By the pinhole of the format: the surface covers the same rectangle as the picture."""
    described = json.loads(path.read_text())
    points = brick.surface.vertices
    for frame in described["frames"]:
        row, column = projected(points, frame, described)
        with Image.open(path.parent / frame["file_path"]) as image:
            drawn = np.argwhere(np.asarray(image)[..., 3] > 127)
        low, high = drawn.min(0), drawn.max(0) + 1
        np.testing.assert_allclose([row.min(), column.min()], low, atol=1)
        np.testing.assert_allclose([row.max(), column.max()], high, atol=1)


def test_colours_of_the_edge_are_not_multiplied_by_alpha():
    rgba = np.float32([[[0.25, 0.25, 0.25, 0.5], [0.5, 0.5, 0.5, 1.0], [0, 0, 0, 0]]])
    image = unpremultiply(rgba)[0]
    assert (image[0, :3] == image[1, :3]).all()
    assert image[1, 0] == 188  # sRGB of 0.5
    assert image[:, 3].tolist() == [128, 255, 0]


def test_a_fixed_light_is_that_of_all_frames(brick, tmp_path):
    path = write_nerfstudio(brick, tmp_path, 3, 8, fixed_light=True)
    lights = {tuple(frame["light_position"]) for frame in json.loads(path.read_text())["frames"]}
    assert len(lights) == 1


def test_the_command_writes_a_folder_per_object_and_keeps_what_is_there(brick_path, tmp_path):
    words = ["export", "nerfstudio", str(brick_path), str(tmp_path / "out"), "-n", "2", "--resolution", "8"]
    assert CliRunner().invoke(app, words).exit_code == 0
    assert len(json.loads((tmp_path / "out/brick/transforms.json").read_text())["frames"]) == 2
    again = CliRunner().invoke(app, words)
    assert isinstance(again.exception, ObjectFolderError)
    assert "exists already" in str(again.exception)


@pytest.mark.parametrize("part", ["vision", "geometry"])
def test_the_command_checks_all_objects_before_it_writes_one(brick, brick_path, tmp_path, part):
    header = {name: value for name, value in brick.header.items() if name != part} | {"key": "second"}
    ObjectFile(header, brick.tensors).save(tmp_path / "second.safetensors")
    files = [str(brick_path), str(tmp_path / "second.safetensors")]
    done = CliRunner().invoke(app, ["export", "nerfstudio", *files, str(tmp_path / "out"), "-n", "1"])
    assert f"second: the file holds no {part}" in str(done.exception)
    assert not (tmp_path / "out").exists()


#: Options of Nerfstudio's parser with which poses stay as they are written.
AS_WRITTEN = {"orientation_method": "none", "center_method": "none", "auto_scale_poses": False}

#: Nerfstudio 1.1.5 indexes tensors by lists of tensors.
LISTS = pytest.mark.filterwarnings("ignore:Using a non-tuple sequence:UserWarning")


@pytest.fixture
def parsed(path):
    """Return a function: what Nerfstudio's parser finds, given its options and a split."""
    name = "nerfstudio.data.dataparsers.nerfstudio_dataparser"
    module = pytest.importorskip(name, reason="nerfstudio is not installed")

    def parse(split="train", **options):
        config = module.NerfstudioDataParserConfig(data=path.parent, downscale_factor=1, **options)
        return config.setup().get_dataparser_outputs(split)

    return parse


@pytest.mark.slow
def test_nerfstudio_reads_cameras_and_pictures(path, parsed):
    from nerfstudio.cameras.cameras import CameraType
    from nerfstudio.data.datasets.base_dataset import InputDataset

    found = parsed(eval_mode="all", **AS_WRITTEN)
    described = json.loads(path.read_text())
    frames = sorted(described["frames"], key=lambda frame: frame["file_path"])
    assert found.image_filenames == [path.parent / frame["file_path"] for frame in frames]
    assert found.mask_filenames is None
    truth = np.array([frame["transform_matrix"] for frame in frames])[:, :3]
    np.testing.assert_allclose(found.cameras.camera_to_worlds, truth, atol=1e-6)
    names = {"fx": "fl_x", "fy": "fl_y", "cx": "cx", "cy": "cy", "width": "w", "height": "h"}
    for field, name in names.items():
        np.testing.assert_allclose(getattr(found.cameras, field), described[name], rtol=1e-6)
    assert (found.cameras.camera_type == CameraType.PERSPECTIVE.value).all()
    assert not found.cameras.distortion_params.any()
    read = InputDataset(found)
    assert len(read) == len(frames)
    for k, frame in enumerate(frames):
        with Image.open(path.parent / frame["file_path"]) as image:
            np.testing.assert_allclose(read[k]["image"], np.asarray(image) / 255, atol=1e-6)


@LISTS
@pytest.mark.slow
def test_nerfstudios_rays_meet_the_object_where_it_is_drawn(brick, path, parsed):
    """By rays of its own cameras: those of opaque pixels hit the surface, the others miss it."""
    found = parsed(eval_mode="all", **AS_WRITTEN)
    surface = trimesh.Trimesh(brick.surface.vertices, brick.surface.faces, process=False)
    for k, file in enumerate(found.image_filenames):
        rays = found.cameras.generate_rays(camera_indices=k)
        origins, directions = rays.origins.reshape(-1, 3).numpy(), rays.directions.reshape(-1, 3).numpy()
        hit = surface.ray.intersects_any(origins, directions)
        with Image.open(file) as image:
            alpha = np.asarray(image)[..., 3].ravel()
        assert 50 < hit.sum() < hit.size - 50
        assert (alpha[hit] > 0).all()
        assert (alpha[~hit] < 255).all()


@LISTS
@pytest.mark.slow
def test_nerfstudio_projects_known_points_where_the_format_does(brick, path, parsed):
    found = parsed(eval_mode="all", **AS_WRITTEN)
    described = json.loads(path.read_text())
    points = brick.surface.vertices[:: len(brick.surface.vertices) // 50]
    frames = sorted(described["frames"], key=lambda frame: frame["file_path"])
    for k, frame in enumerate(frames):
        row, column = projected(points, frame, described)
        coords = torch.from_numpy(np.float32(np.stack([row, column], 1)))
        rays = found.cameras.generate_rays(camera_indices=k, coords=coords)
        away = points - rays.origins.numpy()
        along = (away * rays.directions.numpy()).sum(1)
        assert (along > 0).all()
        np.testing.assert_allclose(along, np.linalg.norm(away, axis=1), rtol=1e-6)


@pytest.mark.slow
def test_nerfstudios_defaults_part_and_place_the_views(path, parsed):
    """As ns-train reads them: every view is of one split, and the cameras fill a cube of side 2."""
    train, val = parsed("train"), parsed("val")
    names = [file.name for file in train.image_filenames + val.image_filenames]
    assert sorted(names) == sorted(file.name for file in (path.parent / "images").iterdir())
    centres = np.concatenate([found.cameras.camera_to_worlds[:, :, 3] for found in (train, val)])
    assert np.abs(centres).max() == pytest.approx(1, abs=1e-5)
