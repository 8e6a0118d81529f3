import numpy as np
import torch

from objectfolder.vision.color import linear_to_srgb, on_white


def test_srgb_is_continuous_monotonic_and_known_at_its_anchors():
    x = torch.linspace(0, 1, 100001, dtype=torch.float64)
    y = linear_to_srgb(x)
    assert (y.diff() > 0).all()
    assert y.diff().max() < 2e-4
    np.testing.assert_allclose(y[[0, -1]], [0, 1], atol=1e-9)
    np.testing.assert_allclose(linear_to_srgb(torch.tensor([0.2140])), [0.5], atol=1e-3)


def test_gradient_is_finite_at_black():
    x = torch.zeros(1, requires_grad=True)
    linear_to_srgb(x).sum().backward()
    assert x.grad.item() == np.float32(12.92)


def test_white_shows_where_nothing_covers_it():
    rgba = torch.tensor([[0.0, 0, 0, 0], [0, 0, 0, 1], [5, 0.5, 0, 1], [0, 0, 0, 0.5]])
    image = on_white(rgba)
    np.testing.assert_allclose(image[0], 1)
    np.testing.assert_allclose(image[1], 0)
    np.testing.assert_allclose(image[2, 0], 1)
    assert image.max() <= 1
    np.testing.assert_allclose(image[3], linear_to_srgb(torch.tensor(0.5)))


def test_a_picture_is_composited_pixel_by_pixel():
    """The bare ones too, which are passed over."""
    generator = torch.Generator().manual_seed(0)
    rgba = torch.rand(9, 7, 4, generator=generator) * (torch.rand(9, 7, 1, generator=generator) > 0.5)
    expected = linear_to_srgb((rgba[..., :3] + (1 - rgba[..., 3:])).clamp(0, 1))
    assert torch.equal(on_white(rgba), expected)
    assert torch.equal(on_white(rgba.transpose(0, 1)), expected.transpose(0, 1))
