"""Nets of released files against the formulas of their description, written out in `released_files`."""

import numpy as np
import pytest
import released_files as released
import torch

from objectfolder.hub.importer.checkpoint import read_released
from objectfolder.hub.importer.nets import (
    configured_net,
    depth_net,
    gains_net,
    image_net,
    nerf_net,
    spectrogram_net,
)
from objectfolder.nets.released_network import Frame
from objectfolder.sound.released_gains import ReleasedGains
from objectfolder.sound.released_spectrogram import ReleasedSpectrogram
from objectfolder.touch.profiles import load_profile
from objectfolder.touch.released_images import DEPTH_SIZE, ReleasedDepth, ReleasedImage
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.vision.color import on_white
from objectfolder.vision.released_kilo import ReleasedKilo
from objectfolder.vision.released_nerf import ReleasedNerf

FRAME = Frame((0.01, -0.02, 0.03), 0.2)  # the object is 0.2 long in released coordinates
BOUNDS = np.array([[-0.09, -0.12, -0.07], [0.11, 0.08, 0.13]])
CAMERA, LIGHT = np.array([1.2, -1.9, 1.0]) * 2.5 / np.linalg.norm([1.2, -1.9, 1.0]), np.array([0.6, 0, 0.8])
SIZE, FOCAL = 6, 9.0


@pytest.fixture
def saved(tmp_path):
    def save(values, **options):
        path = tmp_path / "ObjectFile.pth"
        torch.save(values, path, **options)
        return read_released(path)

    return save


def again(net):
    """The net after a round trip through what is stored, as bytes."""
    tensors, config = net.to_tensors()
    return type(net).from_tensors({k: np.array(v) for k, v in tensors.items()}, config)


def rendered(net, size=SIZE, **options):
    """Image, alpha and depth by the released code."""
    return released.rendered(net, released.pose(CAMERA), LIGHT, size, FOCAL, **options)


def shown(picture):
    return on_white(torch.from_numpy(picture.rgba)).numpy()


def same_picture(picture, image, alpha, depth):
    np.testing.assert_allclose(shown(picture), np.clip(image, 0, 1), atol=2e-5)
    np.testing.assert_allclose(picture.rgba[..., 3], np.minimum(alpha, 1), atol=2e-5)
    hit = alpha > 0
    assert np.isinf(picture.depth[~hit]).all()
    np.testing.assert_allclose(picture.depth[hit], depth[hit] / alpha[hit], rtol=1e-3)


@pytest.mark.parametrize("width", [16, 256])
def test_views_of_1_0_are_the_released_rendering(saved, width):
    values = released.released_1(1 if width == 16 else 8, width, density=-1.0)
    net = again(nerf_net(saved(values).part("VisionNet")))
    assert isinstance(net, ReleasedNerf)
    names = {"coarse": "network_fn_state_dict", "fine": "network_fine_state_dict"}
    states = {which: values["VisionNet"][name] for which, name in names.items()}
    size = SIZE if width == 16 else 3
    image, alpha, depth = rendered(lambda which, *x: released.nerf(states[which], *x), size)
    picture = net.picture(look_at(CAMERA)[0], LIGHT, Intrinsics(size, size, FOCAL))
    assert np.ptp(image) > 0.2
    same_picture(picture, image, alpha, depth)


def test_sounds_of_1_0_are_the_released_spectrograms(saved):
    values = released.released_1(2)
    audio = values["AudioNet"]
    net = again(spectrogram_net(saved(values).part("AudioNet"), FRAME))
    assert isinstance(net, ReleasedSpectrogram)
    point = np.array([[0.13, -0.21, 0.34]])
    place = (FRAME.released(point)[0] + audio["translation"]) * audio["scale"] * 32
    vertices = audio["voxel_vertex"]
    nearest = np.argsort(np.linalg.norm(vertices - place, axis=1))[:4]
    frequency, time = np.meshgrid(np.arange(257) / 256, np.arange(201) / 200, indexing="ij")
    some = np.arange(0, frequency.size, 37)
    expected = np.zeros((3, len(some)), complex)
    for vertex in vertices[nearest]:
        normal = (vertex - vertices.min()) / (vertices.max() - vertices.min())
        bins = np.stack([*(np.full(frequency.size, c) for c in normal), frequency.ravel(), time.ravel()], 1)
        bins = bins[some]
        for i, axis in enumerate("xyz"):
            out = released.mlp(audio["model_state_dict"], bins, prefix=f"module.model_{axis}.")
            low, high = (float(audio["normalizer"][f"f{i + 1}_{end}"]) for end in ("min", "max"))
            out = out * (high - low) + low
            expected[i] += out[:, 0] + 1j * out[:, 1]
    found = net.spectrograms(torch.from_numpy(point))[0].flatten(1).numpy()[:, some]
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("width", [16, 256])
def test_gains_of_2_0_give_the_released_sound(saved, width):
    """As displacement: gain * exp(-|c| t) sin(2 pi f t), with modes below the Nyquist frequency only."""
    from objectfolder.sound.synthesis import gains, sinusoid_bank

    values = released.released_2(3, width)
    audio = values["AudioNet"]
    net = again(gains_net(saved(values).part("AudioNet"), FRAME))
    assert isinstance(net, ReleasedGains)
    point, force = np.array([[0.13, -0.21, 0.34]]), np.array([0.3, -1.0, 2.0])
    xyz = (FRAME.released(point) + 0.08) / 0.19
    time = np.arange(8000) / 44100
    expected = np.zeros(8000)
    for i, axis in enumerate("xyz"):
        out = released.mlp(audio["model_state_dict"], xyz, prefix=f"module.model_{axis}.")[0]
        low, high = (audio["normalizer"][f"f{i + 1}_{end}"] for end in ("min", "max"))
        for gain, f, c in zip(out * (high - low) + low, audio["frequencies"], audio["dampings"]):
            expected += force[i] * gain * np.exp(-abs(c) * time) * np.sin(2 * np.pi * f * time)
    bank = sinusoid_bank(net.damped_frequency, net.damping, 44100, 8000 / 44100)
    sound = gains(net.shapes(torch.from_numpy(point)), torch.from_numpy(force[None]).float()) @ bank
    np.testing.assert_allclose(sound[0].numpy(), expected, atol=1e-4 * np.abs(expected).max())


def test_images_of_1_0_are_the_released_ones_if_the_batch_had_the_extremes(saved):
    values = released.released_1(4)
    net = again(image_net(saved(values).part("TouchNet"), Frame(), BOUNDS))
    assert isinstance(net, ReleasedImage)
    batch = np.array([[-0.12, 0.05, 0.1], [0.03, 0.13, -0.02]])  # least and greatest number are the bounds'
    low, high = batch.min(), batch.max()
    assert (low, high) == (BOUNDS.min(), BOUNDS.max())
    row, column = np.meshgrid(2 * np.arange(160) / 159 - 1, 2 * np.arange(120) / 119 - 1, indexing="ij")
    images = net.images(batch)
    for image, point in zip(images, 2 * ((batch - low) / high) - 1):
        inputs = np.stack([*(np.full(row.size, c) for c in point), row.ravel(), column.ravel()], 1)
        out = released.mlp(values["TouchNet"]["model_state_dict"], inputs, prefix="module.")
        expected = np.clip(np.rint((out + 1) / 2 * 255), 0, 255).reshape(160, 120, 3)
        assert np.ptp(expected) > 100
        assert np.abs(image - expected).max() <= 1
        assert (image == expected).mean() > 0.99


def test_depth_maps_of_2_0_are_the_released_ones(saved):
    values = released.released_2(5)
    net = again(depth_net(saved(values).part("TouchNet"), FRAME, load_profile("gelsight_r15")))
    assert isinstance(net, ReleasedDepth)
    point, theta, phi, press = np.array([[0.1, 0.2, -0.3]]), 0.12, 2.5, 0.0011
    row, column = np.meshgrid(np.arange(120) / 119, np.arange(160) / 159, indexing="ij")
    xyz = (FRAME.released(point)[0] + 0.08) / 0.19
    contact = [*xyz, theta / np.radians(15), np.cos(phi), np.sin(phi), (press - 0.0005) / 0.0015]
    inputs = np.stack([*(np.full(row.size, c) for c in contact), row.ravel(), column.ravel()], 1)
    out = released.mlp(values["TouchNet"]["model_state_dict"], inputs, prefix="module.")
    expected = (out * (0.04 - 0.0339) + 0.0339).reshape(DEPTH_SIZE)
    found = net.depth_maps(point, np.array([press]), np.array([theta]), np.array([phi]))[0]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_views_of_2_0_are_rendered_as_its_settings_say(saved):
    values = released.released_2(6)["VisionNet"]
    net = again(configured_net(saved({"VisionNet": values}).part("VisionNet")))
    image, *_ = rendered(lambda which, *x: released.nerf(values["model_state_dict"], *x), samples=48, more=0)
    picture = net.picture(look_at(CAMERA)[0], LIGHT, Intrinsics(SIZE, SIZE, FOCAL))
    np.testing.assert_allclose(shown(picture), np.clip(image, 0, 1), atol=2e-5)


def test_views_of_kiloosf_are_the_released_rendering(saved):
    values = released.released_kilo(7)
    net = again(configured_net(saved(values).part("VisionNet")))
    assert isinstance(net, ReleasedKilo)
    image, alpha, depth = rendered(
        lambda which, *x: released.kilo(values["VisionNet"], *x), samples=48, more=0
    )
    picture = net.picture(look_at(CAMERA)[0], LIGHT, Intrinsics(SIZE, SIZE, FOCAL))
    assert 0.2 < (alpha > 0.5).mean() < 0.9
    same_picture(picture, image, alpha, depth)
