"""Queries answer the same, whatever the default type and device of torch are."""

import numpy as np
import pytest
import torch

from objectfolder import ObjectFile

CAMERA, LIGHT = torch.tensor([[2.0, 1.0, 1.0]]), torch.tensor([[0.5, 0.5, 0.9]])


def answers(file, points):
    """Of all senses, also with gradients; the file is new, so that its parts are read here."""
    place, force = torch.from_numpy(points), [[0, 0, 1.0]]
    yield file.view(CAMERA.numpy(), LIGHT.numpy(), 16)
    yield file.render(CAMERA.numpy(), LIGHT.numpy(), 16).normals
    yield file.impact(points, force, duration=0.1, contact_time=0.0)
    yield file.impact(points, force, duration=0.1, listener=[[1.0, 1.0, 1.0]])
    yield file.touch(points)
    yield file.press(points, shear=[1e-4, 0], markers=True).marker_flow
    senses = file.torch()
    yield senses.view(CAMERA, LIGHT, resolution=16).images
    yield senses.sound(place, torch.from_numpy(np.ones((1, 3), np.float32)), duration=0.1)
    yield senses.touch(place).images


@pytest.mark.parametrize(
    ("dtype", "device"), [(torch.float64, "cpu"), (torch.float16, "cpu"), (torch.float32, "meta")]
)
def test_answers_do_not_depend_on_the_defaults_of_torch(brick, dtype, device):
    points = brick.sample_surface(2)
    expected = [*answers(ObjectFile(brick.header, brick.tensors), points)]
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        with torch.device(device):
            found = [*answers(ObjectFile(brick.header, brick.tensors), points)]
    finally:
        torch.set_default_dtype(before)
    for answer, same in zip(found, expected):
        assert answer.dtype == same.dtype
        np.testing.assert_array_equal(np.asarray(answer), np.asarray(same))
