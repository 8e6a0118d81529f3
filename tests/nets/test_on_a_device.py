"""Every net answers, and those of the paper train, on a device that is not the CPU.

A GPU is seldom there when tests run, so the device is `pretend_device`, which is as strict about devices.
"""

import numpy as np
import pytest
import released_files as released
import torch
from pretend_device import pretend_device
from small_trainings import train_sounds, train_touches, train_views

from objectfolder import ObjectFile
from objectfolder.hub.importer.checkpoint import read_released
from objectfolder.hub.importer.nets import configured_net, depth_net, gains_net, image_net, spectrogram_net
from objectfolder.nets.fit import Session
from objectfolder.nets.released_network import Frame
from objectfolder.sound.spectrogram_net import SpectrogramNet
from objectfolder.touch.image_net import ImageTouch
from objectfolder.touch.profiles import load_profile
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.vision.osf_net import OsfNet

POSE = look_at(np.array([2.0, -1.0, 0.7]))[0]
LIGHT = np.array([2.0, 0.0, 1.0])
FRAME = Frame((0.01, -0.02, 0.03), 0.2)
POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (3, 3)).astype(np.float32)


def see(net):
    picture = net.picture(POSE, LIGHT, Intrinsics(6, 6, 9.0))
    return picture.rgba, picture.depth


def _osf():
    shape = {"width": 16, "depth": 2, "branch_width": 16, "branch_depth": 2}
    return OsfNet(8, 8, **shape, point_octaves=2, direction_octaves=1)


def _vivid(net):
    """Give a fresh net, whose answer is a constant, an output layer."""
    for network in getattr(net, "branches", None) or [net.network]:
        torch.nn.init.normal_(network.output.weight)
    return net


def _read(values, part, tmp_path):
    path = tmp_path / "ObjectFile.pth"
    torch.save(values, path)
    return read_released(path).part(part)


NETS = {
    "osf": (lambda tmp: _osf(), see),
    "image": (
        lambda tmp: _vivid(ImageTouch("digit", (6, 8), (0.001, 0.0), 16, 2, 3, 3)),
        lambda net: net.images(POINTS),
    ),
    "spectrogram": (
        lambda tmp: _vivid(
            SpectrogramNet(torch.tensor([400.0, 900.0]), torch.tensor([[-1.0, 1.0]] * 3), 16, 2, 1, 3)
        ),
        lambda net: net.spectrograms(torch.from_numpy(POINTS[:1])),
    ),
    "released_nerf": (lambda tmp: configured_net(_read(released.released_2(6), "VisionNet", tmp)), see),
    "released_kilo": (lambda tmp: configured_net(_read(released.released_kilo(7), "VisionNet", tmp)), see),
    "released_spectrogram": (
        lambda tmp: spectrogram_net(_read(released.released_1(2), "AudioNet", tmp), FRAME),
        lambda net: net.spectrograms(torch.from_numpy(POINTS[:1])),
    ),
    "released_gains": (
        lambda tmp: gains_net(_read(released.released_2(3), "AudioNet", tmp), FRAME),
        lambda net: net.shapes(torch.from_numpy(POINTS)),
    ),
    "released_image": (
        lambda tmp: image_net(
            _read(released.released_1(4), "TouchNet", tmp),
            Frame(),
            np.array([[-0.09, -0.12, -0.07], [0.11, 0.08, 0.13]]),
        ),
        lambda net: net.images(POINTS[:1]),
    ),
    "released_depth": (
        lambda tmp: depth_net(
            _read(released.released_2(5), "TouchNet", tmp), FRAME, load_profile("gelsight_r15")
        ),
        lambda net: net.depth_maps(POINTS[:1], np.array([0.001]), np.array([0.1]), np.array([1.0])),
    ),
}


@pytest.mark.parametrize("kind", NETS)
def test_a_net_on_a_device_answers_as_on_the_cpu(kind, tmp_path):
    make, query = NETS[kind]
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        net = make(tmp_path)
    here = query(net)
    with pretend_device() as device:
        there = query(net.to(device))
        answers = (y if isinstance(y, tuple) else (y,) for y in (here, there))
        arrays = [[np.asarray(x.cpu() if isinstance(x, torch.Tensor) else x) for x in y] for y in answers]
    assert all(len(np.unique(x)) > 1 for x in arrays[0])
    for a, b in zip(*arrays, strict=True):
        np.testing.assert_array_equal(a, b)


def ask(file):
    points = file.sample_surface(2, seed=0)
    return {
        "view": file.view(POSE, LIGHT, 16),
        "impact": file.impact(points, np.ones((2, 3))),
        "shapes": file.mode_shapes(points),
        "touch": file.touch(points, 0.001),
        "displacement": file.press(points, 0.001).displacement,
    }


def test_an_object_file_on_a_device_answers_as_on_the_cpu(brick_path):
    here = ask(ObjectFile.load(brick_path))
    with pretend_device() as device:
        there = ask(ObjectFile.load(brick_path, device))
    for name in here:
        np.testing.assert_allclose(there[name], here[name], rtol=1e-5, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("train", [train_views, train_sounds, train_touches])
def test_training_on_a_device_gives_the_net_of_the_cpu(train):
    here, _ = train(Session(torch.Generator().manual_seed(0)), steps=3, final_rate=0.01)
    with pretend_device() as device:
        there, curve = train(Session(torch.Generator().manual_seed(0), device), steps=3, final_rate=0.01)
    assert len(curve) > 0
    for (name, a), b in zip(here.state_dict().items(), there.state_dict().values(), strict=True):
        assert b.device.type == "cpu", name
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)
