import dataclasses
import lzma

import numpy as np
import pytest
import torch
from pretend_device import pretend_device
from refusals import refused
from solids import isosurface, sphere

from objectfolder.base.arrays import read_safetensors, write_safetensors
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.nets.fit import Session
from objectfolder.nets.hashgrid import HashGrid
from objectfolder.vision.appearance import appearance_at
from objectfolder.vision.bsdf import principled
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at, sphere_points
from objectfolder.vision.color import on_white
from objectfolder.vision.net_settings import SurfaceConfig
from objectfolder.vision.scene import Scene
from objectfolder.vision.surface_net import ALIKE, SurfaceNet
from objectfolder.vision.surface_training import train_surface
from objectfolder.vision.trace import trace
from objectfolder.vision.view import SQUARE, draw

GRID = {"levels": 3, "features": 2, "table_bits": 12, "coarsest": 4, "finest": 24}
LOOK = {"width": 16, "roughness": 0.4, "metallic": 0.1}
LIGHT = torch.tensor([0.5, 0.5, 1.0])


def training(points: int, point_steps: int, pixels: int, steps: int) -> SurfaceConfig:
    size = {"points": points, "point_steps": point_steps, "pixels": pixels, "steps": steps}
    return SurfaceConfig(**GRID, width=16, **size, point_batch=1024, batch=1024, learning_rate=0.02)


@pytest.fixture(scope="module")
def ball():
    return isosurface(sphere(0.45, 4), 48)


@pytest.fixture(scope="module")
def samples(ball):
    pixels = np.random.default_rng(0).random((400, 2)) * 32
    pose = look_at(np.array([2.0, 1.0, 1.0]))[0]
    return trace(ball, *camera_rays(pose, Intrinsics.square(32), pixels), LIGHT.numpy())


@pytest.fixture
def net():
    torch.manual_seed(0)
    net = SurfaceNet(HashGrid(**GRID), **LOOK).eval()
    for grid in (net.grid, net.transport):
        torch.nn.init.normal_(grid.table, std=0.3)
    return net


def test_storing_changes_radiance_by_quantisation_only(tmp_path, ball, samples, net):
    write_safetensors(tmp_path / "v.safetensors", *net.to_tensors())
    back = SurfaceNet.from_tensors(*read_safetensors(tmp_path / "v.safetensors"))
    for name in ("grid", "transport"):
        original, stored = getattr(net, name), getattr(back, name)
        for start, stop in zip(original.offsets[:-1], original.offsets[1:]):
            apart = (original.table[start:stop] - stored.table[start:stop]).abs().max()
            assert apart <= original.table[start:stop].abs().max() / 254 * 1.001
    pixel = np.arange(len(samples.points))
    a, b = (n.shader(ball)(samples, LIGHT, pixel) for n in (net, back))
    assert (a - b).abs().max() < 0.02 * a.max()
    again = SurfaceNet.from_tensors(*back.to_tensors())
    for name, value in back.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value)


def test_a_damaged_table_is_an_error(net):
    tensors, config = net.to_tensors()
    for table in (tensors["grid.table"][:500], tensors["transport.table"], tensors["grid.table"][20:]):
        with pytest.raises((ValueError, lzma.LZMAError)):
            SurfaceNet.from_tensors({**tensors, "grid.table": table}, config)


def test_radiance_is_positive_finite_and_smaller_in_shadow(ball, samples, net):
    radiance = net.shader(ball)(samples, LIGHT, np.arange(len(samples.points)))
    assert torch.isfinite(radiance).all()
    assert (radiance > 0).all()
    assert radiance[samples.lit].mean() > 3 * radiance[~samples.lit].mean()


def test_a_light_on_the_surface_gives_a_finite_picture(ball, samples, net):
    for light in (samples.points[0], samples.points[0] + 1e-6):
        assert torch.isfinite(net.shader(ball)(samples, light, np.arange(len(samples.points)))).all()


def test_samples_of_a_pixel_share_what_bounces_and_nothing_else(ball, samples, net):
    shade, number = net.shader(ball), np.arange(len(samples.points))
    alone = shade(samples, LIGHT, SQUARE * number)
    together = shade(samples, LIGHT, SQUARE * (number // 2))
    torch.testing.assert_close(together[::2], alone[::2])
    direct = net.direct(samples, LIGHT, *net.bake(ball).look_of(samples))
    assert (together > direct).all()


def test_pixels_of_a_square_share_the_net_if_they_are_alike(ball, samples, net, monkeypatch):
    count = len(samples.points)
    order = samples.points[:, 0].argsort()
    samples, number = samples.select(order), np.arange(count)
    evaluated = []
    monkeypatch.setattr(
        SurfaceNet, "corrections", lambda self, i, t: evaluated.append(i) or torch.zeros(len(t), 12)
    )
    net.shader(ball)(samples, LIGHT, number)
    facing = torch.cat([inputs.features[:, 18:21] for inputs in evaluated])
    leaders, row = {}, 0
    for i, (normal, lit) in enumerate(zip(samples.normals, samples.lit.tolist())):
        leader = leaders.setdefault((i // SQUARE, lit), normal)
        if leader is normal or leader @ normal < ALIKE:
            torch.testing.assert_close(facing[row], normal)
            row += 1
    assert count / SQUARE < row == len(facing) < count


def test_a_shader_on_a_device_answers_alike_and_leaves_the_net_alone(ball, samples, net):
    pixel = np.arange(len(samples.points)) // 2
    here = net.shader(ball)(samples, LIGHT, pixel)
    with pretend_device() as device:
        there = net.shader(ball, device)(samples, LIGHT, pixel)
        assert there.device == torch.device("cpu")
    torch.testing.assert_close(there, here, rtol=1e-5, atol=1e-6)
    assert {p.device for p in net.parameters()} == {torch.device("cpu")}


@pytest.fixture(scope="module")
def painted():
    vertices, faces = sphere(0.45, 4)
    colors = np.where(vertices > 0, 230, 60).astype(np.uint8)
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return Scene(TexturedMesh(vertices, faces, vertex_colors=colors, normals=normals, roughness=0.5))


@pytest.fixture(scope="module")
def views(ball, painted):
    """The painted ball under its own BSDF, and a glow that is no part of it."""

    def shade(samples, light, pixel):
        base_color, normals = map(torch.from_numpy, appearance_at(painted, samples.points.numpy()))
        to_light = light - samples.points
        squared = to_light.square().sum(1, keepdim=True)
        direct = principled(normals, samples.directions, to_light / squared.sqrt(), base_color, 0.5, 0.0)
        return direct * samples.lit[:, None] / squared + 0.1 * base_color

    def split(count, seed):
        rng = np.random.default_rng(seed)
        poses, lights = look_at(sphere_points(count, 2.5, rng)), sphere_points(count, 1.0, rng)
        intrinsics = Intrinsics.square(32)
        rgba = [draw(ball, shade, p, l, intrinsics).rgba for p, l in zip(poses, lights)]
        seen = {"rgba": np.float16(rgba), "camera_to_world": poses, "light": lights}
        return seen | {"focal": np.float64(intrinsics.focal), "center": np.full((count, 2), 16.0)}

    return split(24, 0), split(4, 1)


def train(ball, scene, train, val, config):
    return train_surface(ball, scene, train, val, config, Session(torch.Generator().manual_seed(3)))


def test_training_explains_a_painted_ball_and_is_deterministic(tmp_path, ball, painted, views):
    config = training(points=20_000, point_steps=150, pixels=8000, steps=150)
    for name in "ab":
        trained, curve = train(ball, painted, *views, config)
        write_safetensors(tmp_path / name, *trained.to_tensors())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert curve[0].val_loss > 2 * min(p.val_loss for p in curve)
    shade, held_out = trained.shader(ball), views[1]
    intrinsics = Intrinsics.square(32)
    for rgba, pose, light in zip(held_out["rgba"], held_out["camera_to_world"], held_out["light"]):
        drawn = on_white(torch.from_numpy(draw(ball, shade, pose, light, intrinsics).rgba))
        truth = on_white(torch.from_numpy(rgba.astype(np.float32)))
        assert (drawn - truth).square().mean() < 1e-3  # 30 dB; paint's edges are finer than the grid


def test_a_mesh_that_is_turned_inside_out_looks_the_same(ball, painted, views):
    config = training(points=5000, point_steps=60, pixels=2000, steps=20)
    mesh = painted.mesh
    turned = Scene(dataclasses.replace(mesh, faces=mesh.faces[:, ::-1], normals=-mesh.normals))
    a, b = (train(ball, scene, *views, config)[0].bake(ball).look for scene in (painted, turned))
    assert (a[:, 3:] * b[:, 3:]).sum(1).min() > 0.9
    assert ((a - b)[:, :3].abs()).mean() < 0.02


def test_facets_too_fine_to_learn_leave_no_noise_in_the_normals(ball, views):
    vertices, faces = sphere(0.45, 5)
    rough = Scene(
        TexturedMesh(vertices * np.random.default_rng(0).normal(1, 0.01, (len(vertices), 1)), faces)
    )
    config = training(points=4000, point_steps=200, pixels=1000, steps=5)
    learned = train(ball, rough, *views, config)[0].bake(ball).look[:, 3:]
    _, facets = appearance_at(rough, ball.shading.vertices)
    known = torch.from_numpy(facets)
    noise = (known - ball.shading.tensor).square().mean()
    assert noise > 0.01
    assert (known - learned).square().mean() < 1.05 * noise


def test_views_that_show_nothing_are_passed_over_unless_all_do(ball, painted, views):
    config = training(points=2000, point_steps=5, pixels=2000, steps=5)
    seen, val = views
    half = seen | {"rgba": seen["rgba"] * (np.arange(len(seen["rgba"])) % 2)[:, None, None, None]}
    half["rgba"][2, 16, 16] = 1  # one pixel
    train(ball, painted, half, val, config)
    refused("none of 24 images shows", train, ball, painted, seen | {"rgba": 0 * seen["rgba"]}, val, config)


def test_tiles_teach_what_the_views_teach_that_they_are_cut_from(ball, painted, views):
    """Every quarter of every view is a tile."""
    config = training(points=5000, point_steps=40, pixels=4000, steps=40)

    def quarters(view):
        whole = view["rgba"].reshape(-1, 2, 16, 2, 16, 4)
        center = np.tile([[16.0, 16], [0, 16], [16, 0], [0, 0]], (len(whole), 1))
        cut = {"rgba": whole.transpose(0, 1, 3, 2, 4, 5).reshape(-1, 16, 16, 4), "center": center}
        return view | cut | {name: view[name].repeat(4, 0) for name in ("camera_to_world", "light")}

    whole, tiles = (train(ball, painted, *data, config)[1] for data in (views, map(quarters, views)))
    assert tiles[-1].val_loss == pytest.approx(whole[-1].val_loss, rel=0.15)


def test_noise_does_not_choose_the_pixels(ball, painted, views):
    """Noise of mean zero on dark pixels must not teach light, though it makes half of them bright."""
    config = training(points=5000, point_steps=40, pixels=1200, steps=60)
    seen, val = views
    rng = np.random.default_rng(0)
    flipped = rng.choice([0.0, 2.0], (*seen["rgba"].shape[:3], 1))  # as rare bright paths would
    noisy = seen | {"rgba": seen["rgba"].copy()}
    noisy["rgba"][..., :3] *= np.where(seen["rgba"][..., :3] < 0.1, flipped, 1)
    shade, light = [], np.array([0.0, 0, -1.0])
    pose = look_at(np.array([[0.0, 1.0, 2.2]]))[0]
    for data in (seen, noisy):
        net, _ = train(ball, painted, data, val, config)
        rgba = draw(ball, net.shader(ball), pose, light, Intrinsics.square(32)).rgba
        shade.append(rgba[rgba[..., 3] == 1][:, :3].mean())
    assert shade[1] == pytest.approx(shade[0], rel=0.1)
