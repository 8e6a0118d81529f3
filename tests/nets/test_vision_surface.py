import numpy as np
import pytest
import torch
from solids import isosurface, sphere

from objectfolder.artifacts import read_safetensors, write_safetensors
from objectfolder.nets.vision_surface import SurfaceNet, VisionConfig, ggx, train_surface
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at, sphere_points
from objectfolder.vision.trace import trace
from objectfolder.vision.view import draw

SIZE = {"levels": 3, "features": 2, "table_bits": 10, "coarsest": 4, "finest": 24, "width": 16}


@pytest.fixture(scope="module")
def ball():
    return isosurface(sphere(0.45, 4), 48)


@pytest.fixture(scope="module")
def samples(ball):
    pixels = np.random.default_rng(0).random((400, 2)) * 32
    pose = look_at(np.array([2.0, 1.0, 1.0]))[0]
    return trace(ball, *camera_rays(pose, Intrinsics.square(32), pixels), np.array([0.5, 0.5, 1.0]))


def net():
    torch.manual_seed(0)
    net = SurfaceNet(**SIZE).eval()
    torch.nn.init.normal_(net.grid.table, std=0.3)
    return net


def test_storing_changes_radiance_by_quantisation_only(tmp_path, samples):
    original = net()
    write_safetensors(tmp_path / "v.safetensors", *original.to_tensors())
    back = SurfaceNet.from_tensors(*read_safetensors(tmp_path / "v.safetensors"))
    for start, stop in zip(original.grid.offsets[:-1], original.grid.offsets[1:]):
        table, stored = original.grid.table[start:stop], back.grid.table[start:stop]
        assert (table - stored).abs().max() <= table.abs().max() / 254 * 1.001
    light = torch.tensor([0.5, 0.5, 1.0])
    with torch.no_grad():
        a, b = original(samples, light), back(samples, light)
    assert (a - b).abs().max() < 0.02 * a.max()
    again = back.to_tensors()[0]
    for name, value in original.to_tensors()[0].items():
        np.testing.assert_allclose(again[name], value, atol=1 if value.dtype == np.int8 else 1e-6)


def test_precomputed_corners_give_the_same_radiance(samples):
    original, light = net(), torch.tensor([0.5, 0.5, 1.0])
    corners = original.grid.corners((samples.points / 0.52 + 1) / 2)
    with torch.no_grad():
        assert torch.equal(original(samples, light, corners), original(samples, light))
        per_row = original(samples, light.expand(len(samples.points), 3))
    assert torch.equal(per_row, original(samples, light))


def test_radiance_is_positive_finite_and_smaller_in_shadow(samples):
    original, light = net(), torch.tensor([0.5, 0.5, 1.0])
    with torch.no_grad():
        radiance = original(samples, light)
    assert torch.isfinite(radiance).all()
    assert (radiance > 0).all()
    assert radiance[samples.lit].mean() > 3 * radiance[~samples.lit].mean()


def test_the_highlight_is_reciprocal_and_peaks_at_the_mirror_direction():
    n = torch.tensor([[0.0, 0, 1]])
    alpha = torch.tensor(0.2)

    def at(angle):
        return torch.stack([torch.sin(angle), torch.zeros_like(angle), torch.cos(angle)], -1)

    light, eye = at(torch.tensor([0.6])), at(torch.tensor([-0.2]))
    forth = ggx(n, -eye, light, alpha) / light[:, 2:]
    back = ggx(n, -light, eye, alpha) / eye[:, 2:]
    torch.testing.assert_close(forth, back, rtol=1e-3, atol=0)
    angles = torch.linspace(-1.2, 1.2, 241)
    values = ggx(n.expand(241, 3), -at(angles), light.expand(241, 3), alpha)[:, 0]
    assert abs(angles[values.argmax()] + 0.6) < 0.12
    assert ggx(n, -eye, at(torch.tensor([2.0])), alpha).item() == 0


def test_highlight_reflects_no_more_than_it_receives():
    """Furnace test by quadrature over light directions."""
    rng = np.random.default_rng(0)
    z, phi = rng.random(200_000), rng.random(200_000) * 2 * np.pi
    r = np.sqrt(1 - z * z)
    light = torch.from_numpy(np.stack([r * np.cos(phi), r * np.sin(phi), z], 1)).float()
    n, eye = torch.tensor([[0.0, 0, 1]]).expand_as(light), torch.tensor([[0.3, 0, -0.954]]).expand_as(light)
    reflected = (ggx(n, eye, light, torch.tensor(0.5)).mean() * 2).item()  # (1/pi) * 2 pi * mean
    assert 0.02 < reflected < 0.08  # F0 = 0.04


@pytest.fixture(scope="module")
def views(ball):
    """A checkered Lambertian ball, drawn."""

    def shade(samples, light):
        to_light = light - samples.points
        squared = to_light.square().sum(1)
        received = samples.lit * (to_light * samples.normals).sum(1).clamp(min=0) / squared**1.5
        albedo = torch.where(samples.points > 0, 0.8, 0.2)
        return albedo * received[:, None]

    def split(count, seed):
        rng = np.random.default_rng(seed)
        poses, lights = look_at(sphere_points(count, 2.5, rng)), sphere_points(count, 1.0, rng)
        intrinsics = Intrinsics.square(32)
        rgba = [draw(ball, shade, p, l, intrinsics).rgba for p, l in zip(poses, lights)]
        return {
            "rgba": np.float16(rgba),
            "camera_to_world": poses,
            "light": lights,
            "focal": np.float64(intrinsics.focal),
        }

    return split(24, 0), split(4, 1)


def test_training_explains_a_painted_ball_and_is_deterministic(tmp_path, ball, views):
    config = VisionConfig(**SIZE, steps=150, batch=1024, learning_rate=0.02)
    for name in "ab":
        trained, curve = train_surface(ball, *views, config, torch.Generator().manual_seed(3))
        write_safetensors(tmp_path / name, *trained.to_tensors())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert min(p.val_loss for p in curve) < 3e-3  # 25 dB
    assert curve[0].val_loss > 2 * curve[-1].val_loss
