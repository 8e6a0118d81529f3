import re

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from refusals import refused
from torch import nn
from typer.testing import CliRunner

from objectfolder.base.arrays import read_safetensors, write_safetensors
from objectfolder.base.seeding import seeded
from objectfolder.benchmarks.models.encoders import register_encoder
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.models.shape_model import Setup, ShapeModel, new_net, save_model
from objectfolder.benchmarks.tasks import photograph
from objectfolder.cli import app
from objectfolder.mesh.reading.load import default_up, load_mesh

VIEW = 32


@register_encoder("middle")
class Mean(nn.Module):
    """One feature: how dark the middle of the picture is."""

    features = 1

    def __init__(self, channels):
        super().__init__()

    def forward(self, x):
        return -x[..., 8:20, 8:20].mean((1, 2, 3))[:, None]


def picture(colour=(200, 30, 30), background=(0, 255, 0), box=(10, 20, 40, 35), size=(80, 60)):
    """A plain rectangle (left, top, right, bottom) on a plain background; (60, 80, 4) uint8."""
    image = np.zeros((size[1], size[0], 4), np.uint8)
    image[:] = (*background, 255)
    left, top, right, bottom = box
    image[top:bottom, left:right] = (*colour, 255)
    return image


def mask_of(box=(10, 20, 40, 35), size=(80, 60)):
    mask = np.zeros((size[1], size[0]), np.uint8)
    mask[box[1] : box[3], box[0] : box[2]] = 255
    return mask


def untrained(resolution):
    setup = Setup(("vision",), "middle", InputSizes(28, (8, 8), (8, 8)), VIEW, 4, 1, 0, resolution, ("ball",))
    with seeded(0, "untrained"):
        return ShapeModel(setup, new_net(setup).eval())


@pytest.fixture
def model():
    """A net that sees a ball: the darker the middle of the picture, the larger."""
    model = untrained(24)
    model.net.decoder, model.net.fusion = Ball(), nn.Identity()
    return model


class Ball(nn.Module):
    def __init__(self):
        super().__init__()
        self.unused = nn.Parameter(torch.zeros(1))  # says on which device the net is

    def forward(self, points, embedding):
        return 20 * (0.3 + 0.02 * embedding - points.norm(dim=-1))

    def one_shape(self, embedding):
        return lambda points: self(points[None], embedding[None])[0]


@pytest.fixture
def model_path(tmp_path):
    """An untrained net whose answer is everything above a plane."""
    save_model(tmp_path / "model.safetensors", untrained(12))
    return tmp_path / "model.safetensors"


@pytest.fixture
def photo(tmp_path):
    Image.fromarray(picture()[..., :3]).save(tmp_path / "photo.png")
    return tmp_path / "photo.png"


def test_the_three_ways_of_cutting_out_agree():
    plain = picture()
    by_mask = photograph.cut_out(plain, mask=mask_of())
    by_colour = photograph.cut_out(plain, background=(0, 250, 5))
    transparent = plain.copy()
    transparent[..., 3] = mask_of()
    assert np.array_equal(by_mask, by_colour)
    assert np.array_equal(by_mask, photograph.cut_out(transparent))
    assert np.array_equal(by_mask[..., 3] == 1, mask_of() > 0)
    assert not by_mask[by_mask[..., 3] == 0].any()
    linear = [((level / 255 + 0.055) / 1.055) ** 2.4 for level in (200, 30, 30)]
    assert by_mask[25, 15] == pytest.approx([*linear, 1])


def test_alpha_goes_before_the_mask_and_the_mask_before_the_colour():
    image, other = picture(), mask_of((50, 5, 70, 15))
    assert np.array_equal(photograph.cut_out(image, other, (0, 255, 0))[..., 3] == 1, other > 0)
    image[..., 3] = mask_of()
    assert np.array_equal(photograph.cut_out(image, other)[..., 3] == 1, mask_of() > 0)


def test_specks_elsewhere_are_not_the_object():
    image = picture()
    image[2, 70] = (0, 0, 0, 255)
    assert np.array_equal(photograph.cut_out(image, background=(0, 255, 0))[..., 3] == 1, mask_of() > 0)


@pytest.mark.parametrize(
    ("alpha", "given", "message"),
    [
        (255, {}, "expected an image with transparency"),
        (255, {"mask": np.zeros((60, 80), np.uint8)}, "no foreground by the mask"),
        (255, {"mask": np.zeros((80, 60), np.uint8)}, "60 x 80 pixels, expected 80 x 60"),
        (255, {"background": (200, 30, 30), "tolerance": 255}, "foreground by the background 200,30,30"),
        (0, {}, "no foreground by its alpha"),
    ],
)
def test_pictures_without_an_object_are_refused(alpha, given, message):
    image = picture()
    image[..., 3] = alpha
    refused(message, photograph.cut_out, image, **given)


def test_pictures_are_read_upright_and_others_refused(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned by 90 degrees
    Image.fromarray(picture()[..., :3]).save(tmp_path / "turned.png", exif=exif)
    assert photograph.read_picture(tmp_path / "turned.png").shape == (80, 60, 4)
    (tmp_path / "text.jpg").write_text("no picture")
    for name, message in (("text.jpg", "cannot be read as an image"), ("none.png", "does not exist")):
        refused(message, photograph.read_picture, tmp_path / name)


@pytest.mark.parametrize("ending", photograph.FORMATS)
def test_a_written_mesh_is_read_upright(ending, tmp_path):
    vertices = np.array([[0.1, 0.2, 0.5], [-0.3, 0.2, -0.5], [0.1, -0.4, -0.5]])
    path = tmp_path / f"mesh{ending}"
    photograph.write_mesh(path, vertices, np.array([[0, 1, 2]]))
    read = load_mesh(path, default_up(path))
    np.testing.assert_allclose(read.vertices[read.faces[0]], vertices, atol=1e-6)


def run(*arguments):
    done = CliRunner().invoke(app, ["reconstruct", *map(str, arguments)])
    if done.exception:
        raise done.exception
    return done.output


@pytest.mark.parametrize("ending", ["obj", "ply", "glb"])
def test_command_writes_a_mesh_in_the_unit_frame(ending, model_path, photo, tmp_path):
    Image.fromarray(mask_of()).save(tmp_path / "mask.png")
    out, again = (tmp_path / f"{name}.{ending}" for name in ("mesh", "again"))
    output = run(photo, out, "--model", model_path, "--mask", tmp_path / "mask.png")
    mesh = trimesh.load(out, force="mesh")
    counts = re.search(r"([\d,]+) v.* ([\d,]+) t", output).groups()
    vertices, triangles = (int(count.replace(",", "")) for count in counts)
    assert len(mesh.faces) == triangles > 0
    assert len(mesh.vertices) <= vertices
    assert np.abs(mesh.vertices).max() < 0.66
    run(photo, again, "--model", model_path, "--background", "0,255,0")
    assert again.read_bytes() == out.read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--background", "1,2"], "expected three levels"),
        (["--background", "1,2,256"], "expected three levels"),
        ([], "--mask.*--background R,G,B"),
    ],
)
def test_command_refuses_bad_options(options, message, model_path, photo, tmp_path):
    for name, expected in (("mesh.ply", message), ("mesh.stp", "cannot write a mesh")):
        refused(expected, run, photo, tmp_path / name, "--model", model_path, *options)
        assert not (tmp_path / name).exists()


def test_a_model_with_an_own_encoder_is_read_with_that(model_path, photo, tmp_path):
    tensors, header = read_safetensors(model_path)
    write_safetensors(model_path, tensors, header | {"encoder": "own"})
    own = tmp_path / "mine.py"
    own.write_text(
        "from objectfolder.benchmarks.models import encoders\n"
        "encoders.register_encoder('own')(encoders._FACTORIES['middle'])\n"
    )
    words = (photo, tmp_path / "mesh.ply", "--model", model_path, "--background", "0,255,0")
    refused(r"encoder 'own' is not one of .*--encoder FILE.py:NAME", run, *words)
    run(*words, "--encoder", f"{own}:own")
    assert (tmp_path / "mesh.ply").is_file()


def test_clutter_is_busy_and_seeded():
    first, again, other = (photograph.cluttered(64, 64, np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.min() >= 0
    assert first.max() <= 1
    assert first.std(axis=(0, 1)).min() > 0.1


def test_removing_the_background_undoes_it(model):
    rgba = np.zeros((128, 128, 4), np.float16)
    rgba[40:100, 50:90] = (0.2, 0.1, 0.1, 1)
    seen = photograph.photograph_conditions(rgba, VIEW, np.random.default_rng(0))
    assert list(seen) == ["white", "white, removed", "clutter", "clutter, removed"]
    assert all(image.shape == (VIEW, VIEW, 3) for image in seen.values())
    assert np.array_equal(seen["white, removed"], seen["clutter, removed"])
    corner = np.s_[:4, :4]
    assert (seen["white"][corner] == 255).all()
    assert seen["clutter"][corner].std() > 0

    points = np.random.default_rng(1).uniform(-0.55, 0.55, (4000, 3)).astype(np.float32)
    dark = model.embed({"vision": seen["white, removed"][None]})
    truth = model.is_inside(dark, points)[0]
    scores = photograph.photograph_scores(model, rgba[None], points, truth, np.random.default_rng(0))
    assert scores["white, removed"].tolist() == scores["clutter, removed"].tolist() == [1]
    assert 0 < scores["clutter"][0] < 1
