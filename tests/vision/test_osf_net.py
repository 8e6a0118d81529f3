import dataclasses
import math

import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder import ObjectFile
from objectfolder.base.arrays import read_safetensors, write_safetensors
from objectfolder.base.metrics import psnr
from objectfolder.nets.fit import Session
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at, sphere_points
from objectfolder.vision.color import on_white
from objectfolder.vision.evaluation import evaluate_vision
from objectfolder.vision.net_settings import OsfConfig
from objectfolder.vision.osf_net import OsfNet, ScatteringFunction
from objectfolder.vision.osf_training import train_osf
from objectfolder.vision.volume import Rays

SHAPE = {"width": 24, "depth": 2, "branch_width": 16, "branch_depth": 2}
SHAPE |= {"point_octaves": 2, "direction_octaves": 1}
LARGER = {"width": 32, "depth": 3, "branch_width": 32, "point_octaves": 4}
SAMPLES = {"coarse_samples": 16, "fine_samples": 16, "hull_cells": 0}
RATES = {"learning_rate": 0.01, "final_rate": 0.01, "precision": "float32"}
CONFIG = OsfConfig(**SHAPE | LARGER, **SAMPLES, **RATES, steps=400, batch=256)
HALF = 0.52
POSE = look_at(np.array([2.5, 0, 0]))[0]
RADIUS = 0.4


def random_net(coarse=16, fine=32):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return OsfNet(coarse, fine, **SHAPE).eval()


def fog(density, fraction=0.5, coarse=16, fine=32):
    """Constant density and scattering in the whole cube."""
    net = random_net(coarse, fine)
    for field in (net.coarse, net.fine):
        share = (fraction + 0.1) / 1.2
        for layer, bias in ((field.density, density), (field.fraction, math.log(share / (1 - share)))):
            torch.nn.init.zeros_(layer.weight)
            torch.nn.init.constant_(layer.bias, bias)
    return net


def chords(pose, intrinsics):
    rows, columns = np.mgrid[: intrinsics.height, : intrinsics.width]
    centres = np.stack([columns.ravel(), rows.ravel()], 1) + 0.5
    rays = Rays.through_cube(*map(torch.from_numpy, camera_rays(pose, intrinsics, centres)), HALF)
    return (rays.far - rays.near).clamp(min=0).view(rows.shape).numpy(), rays


@pytest.mark.parametrize("position", [(2.5, 0, 0), (1.2, -1.5, 1.4), (0.1, 0.2, 0.0)])
def test_alpha_of_fog_is_one_less_exp_of_the_way_through_it(position):
    """Also from inside."""
    pose, intrinsics = look_at(np.array(position))[0], Intrinsics(40, 24, 40.0)
    length, _ = chords(pose, intrinsics)
    picture = fog(1.7).picture(pose, np.array([0, 0, 1.0]), intrinsics)
    np.testing.assert_allclose(picture.rgba[..., 3], 1 - np.exp(-1.7 * length), atol=1e-5)
    assert (picture.rgba[length == 0] == 0).all()
    assert np.isinf(picture.depth[length == 0]).all()
    assert np.isfinite(picture.depth[length > 0.01]).all()


def test_radiance_of_fog_is_the_integral_of_what_each_point_scatters():
    """rho sigma exp(-sigma s) / d^2 along the ray, by fine quadrature."""
    intrinsics, light, sigma = Intrinsics(9, 7, 9.0), np.array([0.3, -0.9, 0.4]), 3.0
    _, rays = chords(POSE, intrinsics)
    net = fog(sigma, fraction=0.6, coarse=64, fine=128)
    rgba = net.picture(POSE, light, intrinsics).rgba.reshape(-1, 4)
    for ray in range(63):
        near, far = rays.near[ray].item(), rays.far[ray].item()
        if far <= near:
            continue
        s = (np.arange(4000) + 0.5) / 4000 * (far - near)
        points = rays.origins[ray].numpy() + (near + s[:, None]) * rays.directions[ray].numpy()
        squared = ((light - points) ** 2).sum(1)
        exact = (0.6 * sigma * np.exp(-sigma * s) / squared).mean() * (far - near)
        np.testing.assert_allclose(rgba[ray, :3], exact, rtol=3e-3, atol=1e-6)


def test_depth_of_an_opaque_cube_is_its_face_whatever_the_pixel():
    """Along the optical axis: a plane that faces the camera has one depth."""
    intrinsics = Intrinsics.square(24)
    picture = fog(1e4, coarse=64, fine=128).picture(POSE, np.array([1.0, 0, 0]), intrinsics)
    inner = picture.depth[6:18, 6:18]
    np.testing.assert_allclose(inner, 2.5 - HALF, atol=1e-3)
    np.testing.assert_allclose(picture.rgba[6:18, 6:18, 3], 1, atol=1e-6)
    assert picture.rgba[..., 3].max() <= 1


def test_nothing_is_white():
    """A net without density: the picture is empty, and what rays see on white is white."""
    net = fog(-1.0)
    intrinsics = Intrinsics.square(16)
    rgba = net.picture(POSE, np.array([0, 0, 1.0]), intrinsics).rgba
    assert not rgba.any()
    assert on_white(torch.from_numpy(rgba)).min() > 1 - 1e-6
    length, rays = chords(POSE, intrinsics)
    rays = rays[torch.from_numpy(length.ravel() > 0)]
    with torch.no_grad():
        seen = net(rays, torch.zeros_like(rays.origins))
    assert all((s == 1).all() for s in seen)


def test_pictures_show_what_training_fits():
    """The same rays, sampled in the middle of their strata: the same colours."""
    net, intrinsics, light = random_net(), Intrinsics.square(12), np.array([0.2, 0.5, 0.9])
    length, rays = chords(POSE, intrinsics)
    met = torch.from_numpy(length.ravel() > 0)
    with torch.no_grad():
        _, fine = net(rays[met], torch.from_numpy(light).float().expand(int(met.sum()), 3))
    rgba = torch.from_numpy(net.picture(POSE, light, intrinsics).rgba).view(-1, 4)[met]
    torch.testing.assert_close(rgba[:, :3] + 1 - rgba[:, 3:], fine, rtol=1e-4, atol=1e-5)


def test_gradients_are_those_of_finite_differences():
    """Through opacity, falloff, both networks, and points whose fraction is not asked for."""
    net = random_net(6, 6).double()
    torch.nn.init.normal_(net.fine.density.weight, generator=torch.Generator().manual_seed(1))
    torch.nn.init.constant_(net.fine.density.bias, -4.0)
    ends = torch.tensor([[2.5, 0, 0], [2.5, 0.1, 0.2]]).double(), torch.tensor([[-1.0, 0, 0]] * 2).double()
    rays = Rays.through_cube(*ends, HALF)
    light = torch.tensor([[0.1, 0.8, 0.6]], dtype=torch.float64).expand(2, 3)
    distance = (torch.arange(12, dtype=torch.float64) + 0.5).expand(2, 12) / 12 * 1.04 + 1.98
    density, _ = net.fine(rays.points(distance).flatten(0, 1))
    assert 0 < (density == 0).sum() < len(density)

    def seen():
        radiance, alpha, _ = net._look(rays, distance, light)
        return (radiance.sum(1) - alpha).square().sum()

    seen().backward()
    for parameter in (net.fine.density.weight, net.fine.bottleneck.weight, net.fine.trunk.hidden[0].weight):
        index = parameter.grad.abs().flatten().argmax()
        with torch.no_grad():
            flat = parameter.view(-1)
            values = []
            for step in (1e-6, -2e-6):
                flat[index] += step
                values.append(seen().item())
            flat[index] += 1e-6
        slope = (values[0] - values[1]) / 2e-6
        assert parameter.grad.flatten()[index].item() == pytest.approx(slope, rel=1e-4)


def occupied(net):
    """Give a net a hull of 8^3 cells, occupied where x < 0 and y > 0."""
    hull = torch.zeros(8, 8, 8, dtype=torch.bool)
    hull[:4, 4:] = True
    found = OsfNet(*net.samples, hull_cells=8, **SHAPE).eval()
    found.load_state_dict({**net.state_dict(), "hull": hull})
    return found


def test_fog_outside_of_the_hull_is_gone():
    """Alpha is that of the way through the occupied quarter of the cube."""
    net, intrinsics = occupied(fog(1.7, coarse=256, fine=256)), Intrinsics.square(16)
    alpha = net.picture(POSE, np.array([0, 0, 1.0]), intrinsics).rgba[..., 3]
    _, rays = chords(POSE, intrinsics)
    s = 1.98 + (np.arange(4000) + 0.5) / 4000 * 1.3
    points = rays.origins.numpy()[:, None] + s[:, None] * rays.directions.numpy()[:, None]
    within = (abs(points) < HALF).all(2) & (points[..., 0] < 0) & (points[..., 1] > 0)
    exact = 1 - np.exp(-1.7 * within.mean(1) * 1.3).reshape(16, 16)
    assert exact.max() > 0.5
    np.testing.assert_allclose(alpha, exact, atol=5e-3)
    assert (alpha[exact == 0] == 0).all()


def test_a_hull_of_all_cells_changes_nothing():
    net, intrinsics, light = random_net(), Intrinsics.square(12), np.array([0.2, 0.5, 0.9])
    full = OsfNet(*net.samples, hull_cells=4, **SHAPE).eval()
    full.load_state_dict({**net.state_dict(), "hull": full.hull})
    pictures = [n.picture(POSE, light, intrinsics).rgba for n in (net, full)]
    np.testing.assert_array_equal(*pictures)


def test_nothing_is_computed_outside_of_the_hull():
    """Of either net, in training, also where all rays miss it; gradients stay finite."""
    net, rows = occupied(random_net()).train(), []
    for field in (net.coarse, net.fine):
        field.trunk.register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    length, rays = chords(POSE, Intrinsics.square(12))
    rays = rays[torch.from_numpy(length.ravel() > 0)]
    places = rays.points((rays.near[:, None] + rays.far[:, None]) / 2)[:, 0]
    light = torch.zeros_like(rays.origins)
    net(rays, light)
    assert 0 < rows[0] < 0.5 * 16 * len(light)
    assert 0 < rows[1] < 48 * len(light)
    missed = places[:, 1] < -0.1
    assert missed.any()
    seen = net(rays[missed], light[missed], torch.Generator().manual_seed(0))
    assert rows[2:] == [0, 0]
    assert all((s == 1).all() for s in seen)
    (seen[0].sum() + seen[1].sum()).backward()
    assert all(p.grad is None or p.grad.isfinite().all() for p in net.parameters())


def test_the_papers_net():
    """Supplementary E: eight layers of 256 channels for density, four of 128 for the fraction."""
    field = ScatteringFunction(256, 8, 128, 4, 10, 4)
    trunk = [tuple(layer.weight.shape) for layer in field.trunk.hidden]
    assert trunk == [(256, 63), *[(256, 256)] * 4, (256, 319), *[(256, 256)] * 2]
    assert [tuple(layer.weight.shape) for layer in field.branch.hidden] == [(128, 310), *[(128, 128)] * 3]
    points, directions = torch.rand(7, 3) - 0.5, torch.eye(3)[torch.arange(7) % 3]
    density, hidden = field(points)
    assert density.shape == (7,)
    assert (density >= 0).all()
    forth = field.scattered(hidden, directions, -directions)
    assert forth.shape == (7, 3)
    assert not torch.equal(forth, field.scattered(hidden, -directions, directions))


def painted_ball(count, seed, size=16):
    """Views of a Lambertian ball painted by octants, four samples per pixel."""
    rng = np.random.default_rng(seed)
    poses, lights = look_at(sphere_points(count, 2.5, rng)), sphere_points(count, 1.0, rng)
    intrinsics = Intrinsics.square(size)
    axis = (np.arange(2 * size) + 0.5) / 2
    pixels = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    images = []
    for pose, light in zip(poses, lights):
        origin, direction = (a.astype(np.float64) for a in camera_rays(pose, intrinsics, pixels))
        along = (origin * direction).sum(1)
        root = along**2 - (origin**2).sum(1) + RADIUS**2
        points = origin - direction * (along + np.sqrt(root.clip(0)))[:, None]
        to_light = light - points
        squared = (to_light**2).sum(1)
        received = ((to_light * points).sum(1) / RADIUS).clip(0) / squared**1.5
        rgb = np.where(points > 0, 0.8, 0.2) * received[:, None]
        rgba = np.concatenate([rgb, np.ones((len(points), 1))], 1) * (root > 0)[:, None]
        images.append(rgba.reshape(size, 2, size, 2, 4).mean((1, 3)))
    seen = {"rgba": np.float16(images), "camera_to_world": poses, "light": lights}
    return seen | {"focal": np.float64(intrinsics.focal), "center": np.full((len(images), 2), size / 2)}


@pytest.fixture(scope="module")
def views():
    return painted_ball(200, 0), painted_ball(6, 1)


@pytest.fixture(scope="module")
def trained(views):
    return train_osf(*views, CONFIG, Session(torch.Generator().manual_seed(1)))


def write_object_file(path, brick, net):
    """Write the brick's Object File with another look."""
    tensors, config = net.to_tensors()
    others = {name: t for name, t in brick.tensors.items() if not name.startswith("vision.")}
    header = {**brick.header, "vision": {"kind": net.kind, "net": config}}
    write_safetensors(path, others | {f"vision.{name}": t for name, t in tensors.items()}, header)


@pytest.fixture(scope="module")
def file(brick, trained, tmp_path_factory):
    """The brick's Object File with the ball's look."""
    path = tmp_path_factory.mktemp("file") / "o.safetensors"
    write_object_file(path, brick, trained[0])
    return ObjectFile.load(path)


@pytest.mark.slow
def test_it_learns_new_views_under_new_lights_from_pictures_alone(file, views, trained):
    """Far better than white and than the mean image, as the Object File answers."""
    test = painted_ball(8, 2)
    scores = evaluate_vision(file, test)
    train_images, truth = (on_white(torch.from_numpy(v["rgba"].astype(np.float32))) for v in (views[0], test))
    mean_image = psnr((truth - train_images.mean(0)).square().mean().item())
    assert scores["psnr_pooled"] > mean_image + 5
    assert scores["psnr_pooled"] > scores["baseline_white"] + 12
    losses = [point.val_loss for point in trained[1]]
    assert min(losses) < 0.1 * losses[0]


@pytest.mark.slow
def test_its_depth_is_the_balls(trained):
    """Alpha and depth of a sphere, though no view has told either."""
    picture = trained[0].picture(POSE, np.array([0.8, 0, 0.6]), Intrinsics.square(15))
    assert picture.rgba[7, 7, 3] > 0.95
    assert picture.depth[7, 7] == pytest.approx(2.5 - RADIUS, abs=0.2)  # the cube: 1.98 to 3.02
    assert picture.normals[7, 7] @ POSE[:3, 2] > 0.9  # the sphere faces the camera there
    assert picture.rgba[0, 0, 3] < 0.05


@pytest.mark.slow
def test_views_are_answered_row_by_row(file):
    cameras, lights = sphere_points(3, 2.5, np.random.default_rng(0)), np.array([0.0, 0.6, 0.8])
    images = file.view(cameras, lights, resolution=10)
    assert images.shape == (3, 10, 10, 3)
    assert images.dtype == np.float32
    assert images.min() >= 0
    assert images.max() <= 1
    np.testing.assert_array_equal(file.view(cameras[1:2], lights, resolution=10)[0], images[1])
    wide = file.view(cameras[0], lights, intrinsics=Intrinsics(9, 5, 4.0))
    assert wide.shape == (1, 5, 9, 3)


@pytest.mark.slow
def test_storing_costs_less_than_a_grey_level(tmp_path, trained):
    write_safetensors(tmp_path / "v.safetensors", *trained[0].to_tensors())
    back = OsfNet.from_tensors(*read_safetensors(tmp_path / "v.safetensors"))
    light, intrinsics = np.array([0.5, 0.5, 0.7]), Intrinsics.square(12)
    pictures = (net.picture(POSE, light, intrinsics).rgba for net in (trained[0], back))
    a, b = (on_white(torch.from_numpy(rgba)) for rgba in pictures)
    assert 0 < (a - b).abs().mean() < 1 / 255
    again = back.to_tensors()[0]
    for name, value in trained[0].to_tensors()[0].items():
        np.testing.assert_array_equal(again[name], value)


@pytest.mark.parametrize("net", [random_net(), occupied(random_net())], ids=["osf", "osf_hull"])
def test_object_files_answer_as_the_net(brick, tmp_path, net):
    """With and without a hull; weights are stored in 16 bits."""
    path = tmp_path / "o.safetensors"
    write_object_file(path, brick, net)
    file, camera, light = ObjectFile.load(path), np.array([2.0, 1, 1]), np.array([0.2, 0.5, 0.9])
    assert file.header["vision"]["kind"] == net.kind
    half = OsfNet.from_tensors(*net.to_tensors())
    expected = half.picture(look_at(camera)[0], light, Intrinsics.square(12))
    np.testing.assert_array_equal(file.render(camera, light, resolution=12).rgba[0], expected.rgba)


def test_hulls_are_stored_as_bits_of_their_cells():
    net = occupied(random_net())
    tensors, config = net.to_tensors()
    assert tensors["hull"].shape == (64,)
    assert torch.equal(OsfNet.from_tensors(tensors, config).hull, net.hull)
    assert "hull" not in random_net().to_tensors()[0]
    for damaged in (tensors["hull"][:10], np.tile(tensors["hull"], 2)):
        with pytest.raises(ValueError, match="expected bits of 512 cells"):
            OsfNet.from_tensors({**tensors, "hull": damaged}, config)


def test_normals_know_that_nothing_is_outside_of_the_hull():
    """A slab whose density grows upwards; above its top the net alone would go on."""
    net = occupied(random_net(64, 64))
    net.hull[:] = False
    net.hull[:, :, 2:5] = True
    for field in (net.coarse, net.fine):
        field.forward = lambda points: (1e3 * (1 + points[:, 2]), points.new_zeros(len(points), 24))
    pose = look_at(np.array([0.0, 0, 2.5]))[0]
    picture = net.picture(pose, np.array([0, 0, 1.0]), Intrinsics.square(9))
    top = 2 * HALF * 5 / 8 - HALF
    assert picture.depth[4, 4] == pytest.approx(2.5 - top, abs=0.01)
    np.testing.assert_allclose(picture.normals[4, 4], [0, 0, 1], atol=1e-3)


@pytest.mark.slow
def test_it_learns_as_well_within_the_hull_of_its_views(views, trained):
    config = dataclasses.replace(CONFIG, hull_cells=32)
    net, curve = train_osf(*views, config, Session(torch.Generator().manual_seed(1)))
    assert net.hull.float().mean() < 0.5
    within, without = (min(point.val_loss for point in points) for points in (curve, trained[1]))
    assert within < 10**0.2 * without  # 2 dB: few steps, other samples


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_learns_as_well(views, trained):
    net, curve = train_osf(*views, CONFIG, Session(torch.Generator().manual_seed(1), "cuda"))
    assert next(net.parameters()).device.type == "cpu"
    assert min(p.val_loss for p in curve) < 2 * min(p.val_loss for p in trained[1])


def test_tiles_are_refused_with_what_to_set(views):
    tiles = views[0] | {"center": views[0]["center"] + 3}
    refused(
        r"whole views, not from tiles of .*render_views.tile to null",
        train_osf,
        tiles,
        views[1],
        CONFIG,
        Session(torch.Generator().manual_seed(1)),
    )
