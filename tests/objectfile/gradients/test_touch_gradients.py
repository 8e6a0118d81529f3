"""Touch with gradients: the answers of `ObjectFile.press`, and slopes beside central differences."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from central_differences import disagreement
from refusals import refused
from scipy.ndimage import binary_erosion

from objectfolder import ObjectFile
from objectfolder.base.metrics import psnr
from objectfolder.touch.gradient import Touch
from objectfolder.touch.profiles import load_profile

RIGID, SOFT = load_profile("tacto_digit"), load_profile("digit")
STEPS = {"points": 1e-7, "depth": 1e-7, "angle": 1e-5, "tilt": 1e-5, "azimuth": 1e-5}
RIM = 14  # pixels that slopes and blur reach


@pytest.fixture(scope="module")
def mug():
    return ObjectFile.sample("mug")


def contacts(mug, count, seed):
    rng = np.random.default_rng(seed)
    drawn = {
        "points": mug.sample_surface(count, seed) * 1.0001,
        "depth": rng.uniform(0.0005, 0.002, count),
        "angle": rng.uniform(-3, 3, count),
        "tilt": rng.uniform(0.05, 0.2, count),
        "azimuth": rng.uniform(-3, 3, count),
    }
    return {name: torch.from_numpy(values) for name, values in drawn.items()}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("sensor", [RIGID, SOFT], ids=lambda sensor: sensor.gel)
def test_the_images_are_those_of_press(mug, dtype, sensor):
    given = contacts(mug, 4, 3)
    expected, found = mug.press(**given, sensor=sensor), mug.torch(dtype).touch(**given, sensor=sensor)
    assert found.images.dtype == dtype
    errors = np.square(found.images.round().numpy() / 255 - expected.images / 255).mean((1, 2, 3))
    assert psnr(errors).min() > 60
    np.testing.assert_allclose(found.height.numpy(), expected.height, atol=1e-7)
    np.testing.assert_allclose(found.force.numpy(), expected.force, rtol=1e-2)


def test_a_point_off_the_surface_and_an_obstructed_sensor_are_pressed_as_by_press(mug):
    inside = mug.nearest([[0.0, 0.0, -0.04]])[0] + [[0, 0, 0.0009]]
    expected, found = mug.press(inside), mug.torch().touch(torch.from_numpy(inside))
    assert np.square(found.images.round().numpy() - expected.images).mean() < 0.065  # 60 dB


def weighted(touch, given, what, sensor, mask=None):
    """A number that sums an answer with random weights, relative to its size."""
    answer = getattr(touch(**given, sensor=sensor), what)
    weights = torch.randn(answer.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    weights = weights / answer.norm() * (1 if mask is None else mask)
    return lambda name: lambda x: (getattr(touch(**{**given, name: x}, sensor=sensor), what) * weights).sum()


SLOPES = [("displacement", RIGID, 0.02)]
SLOPES += [("displacement", SOFT, 0.01), ("images", SOFT, 0.01), ("force", SOFT, 1e-4)]


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize(("what", "sensor", "most"), SLOPES, ids=lambda v: getattr(v, "gel", str(v)))
def test_slopes_along_the_pose(mug, name, what, sensor, most):
    # Pixels that reach the limits of the gel, or pass to another wall, jump.
    given = contacts(mug, 1, 4)
    total = weighted(mug.torch(torch.float64).touch, given, what, sensor)
    assert disagreement(total(name), given[name], STEPS[name]) < most


@pytest.mark.parametrize("name", STEPS)
def test_slopes_of_a_rigid_imprint_within_its_rim(mug, name):
    given, touch = contacts(mug, 1, 4), mug.torch(torch.float64).touch
    inside = binary_erosion(touch(**given, sensor=RIGID).displacement[0].numpy() > 0, iterations=RIM)
    assert inside.sum() > 500
    total = weighted(touch, given, "images", RIGID, torch.from_numpy(inside)[None, :, :, None])
    assert disagreement(total(name), given[name], STEPS[name]) < 0.02


def test_a_sensor_has_a_name_or_is_a_profile_and_faces_the_surface(mug):
    touch, point = mug.torch().touch, torch.from_numpy(mug.sample_surface(1))
    named, profile = (touch(point, sensor=one).images for one in ("digit", load_profile("digit")))
    assert torch.equal(named, profile)
    refused("unknown sensor profile 'thumb'", touch, point, sensor="thumb")
    for tilt in (15.0, torch.tensor(-torch.pi, requires_grad=True)):
        refused(r"tilt: row 0 is .* rad, .*angles are in radians", touch, point, tilt=tilt)


def test_other_nets_are_refused(mug):
    sense = copy.copy(mug.torch().touch._sense)
    sense.net = type(sense.net)(mug.surface, mug.scale, replace(RIGID, name="t"), renderer="tacto")
    refused("renderer gel", Touch, sense, torch.float32)
