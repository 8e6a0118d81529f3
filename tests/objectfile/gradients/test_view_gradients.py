"""Views with gradients: the answers of `ObjectFile.view`, and slopes beside central differences."""

import numpy as np
import pytest
import torch
from central_differences import disagreement
from refusals import refused
from scipy.ndimage import binary_erosion

from objectfolder import ObjectFile
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.metrics import psnr
from objectfolder.vision.cameras import Intrinsics, look_at

CAMERA = torch.tensor([[2.0, 1.0, 1.2]], dtype=torch.float64)
LIGHT = torch.tensor([[0.5, 0.5, 0.7]], dtype=torch.float64)
SIDE = 64


@pytest.fixture(scope="module")
def mug():
    return ObjectFile.sample("mug")


@pytest.fixture(scope="module")
def view(mug):
    return mug.torch(torch.float64).view


@pytest.fixture(scope="module")
def single(mug):
    return mug.torch().view


def test_the_images_are_those_of_view(mug, single):
    cameras, lights = torch.cat([CAMERA, -CAMERA, 0.1 * CAMERA]), torch.cat([LIGHT, LIGHT, 2 * LIGHT])
    cameras[2] = torch.tensor([0.1, 0.0, 2.0])  # near the pole, where up is y
    expected = mug.view(cameras.numpy(), lights.numpy(), resolution=SIDE, supersample=False)
    seen = single(cameras, lights, resolution=SIDE)
    assert seen.images.dtype == torch.float32
    assert seen.inside.sum((1, 2)).min() > 300
    errors = np.square(seen.images.numpy() - expected)
    assert psnr(errors[seen.inside.numpy()].mean()) > 90
    assert psnr(errors.mean((1, 2, 3))).min() > 60  # a ray on the silhouette may round to the other side


def test_supersampled_views_agree_off_edges(mug, single):
    seen = single(CAMERA, LIGHT, resolution=SIDE)
    expected = mug.view(CAMERA.numpy(), LIGHT.numpy(), resolution=SIDE)
    plain = mug.view(CAMERA.numpy(), LIGHT.numpy(), resolution=SIDE, supersample=False)
    same = (expected == plain).all(-1) & seen.inside.numpy()  # creases and shadow edges are supersampled
    assert same.sum() > 0.2 * seen.inside.sum()
    assert psnr(np.square(seen.images.numpy() - expected)[same].mean()) > 50


def test_matrices_and_intrinsics_are_cameras_too(mug, view):
    pose, seen_by = look_at(CAMERA.numpy()), Intrinsics(40, 30, 50.0, (22.5, 14.0), 48.0)
    expected = mug.view(pose, LIGHT.numpy(), intrinsics=seen_by, supersample=False)
    found = view(torch.from_numpy(pose), LIGHT, intrinsics=seen_by)
    assert psnr(np.square(found.images.numpy() - expected)[found.inside.numpy()].mean()) > 90
    with pytest.raises(ObjectFolderError, match=r"200000 x 200000 pixels: needs .* bytes"):
        view(torch.from_numpy(pose), LIGHT, resolution=200_000)
    refused("intrinsics is of type int, expected Intrinsics", view, CAMERA, LIGHT, intrinsics=5)
    away = view(-CAMERA + 1, LIGHT, intrinsics=Intrinsics(4, 4, 1e4, (5000.0, 0.0)))
    assert (away.images == 1).all()
    assert not away.inside.any()


@pytest.mark.parametrize("name", ["camera", "pose", "light"])
def test_slopes(view, name):
    poses = torch.from_numpy(look_at(CAMERA.numpy()))
    seen = view(CAMERA, LIGHT, resolution=SIDE)
    inside = torch.from_numpy(binary_erosion(seen.inside[0].numpy(), iterations=2))
    weights = torch.randn(seen.images.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    weights = weights * inside[None, :, :, None] / seen.images.norm()

    def total(x):
        if name == "pose":  # a shift along the camera's axes
            shift = torch.cat([torch.zeros(1, 4, 3), torch.cat([x, torch.zeros(1)])[None, :, None]], 2)
            given = poses + poses @ shift, LIGHT
        else:
            given = (x, LIGHT) if name == "camera" else (CAMERA, x)
        return (view(*given, resolution=SIDE).images * weights).sum()

    start = {"camera": CAMERA, "pose": torch.zeros(3), "light": LIGHT}[name]
    assert disagreement(total, start, 1e-6) < 1e-4


@pytest.mark.slow
def test_a_light_is_found_by_descent(mug, single):
    truth = torch.from_numpy(mug.view(CAMERA.numpy(), LIGHT.numpy(), resolution=SIDE, supersample=False))
    light = (LIGHT + torch.tensor([[0.15, -0.1, 0.1]])).requires_grad_()
    adam = torch.optim.Adam([light], lr=0.02)
    for _ in range(60):
        adam.zero_grad()
        seen = single(CAMERA, light, resolution=SIDE)
        ((seen.images - truth)[seen.inside]).square().mean().backward()
        adam.step()
    assert float((light.detach() - LIGHT).norm()) < 0.02
