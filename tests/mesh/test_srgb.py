import numpy as np
import pytest
import torch

from objectfolder.mesh import srgb


@pytest.mark.parametrize("library", [np, torch])
def test_curve_is_continuous_monotonic_and_known_at_its_anchors(library):
    x = library.linspace(0, 1, 100001, dtype=library.float64)
    y = srgb.encode(x)
    steps = library.diff(y)
    assert (steps > 0).all()
    assert steps.max() < 2e-4
    np.testing.assert_allclose(y[[0, -1]], [0, 1], atol=1e-9)
    np.testing.assert_allclose(srgb.encode(library.asarray([0.2140])), [0.5], atol=1e-3)
    np.testing.assert_allclose(srgb.decode(y), x, atol=2e-5)


def test_gradient_is_the_slope_and_finite_at_black():
    x = torch.tensor([0, 0.002, 0.1, 1.0], requires_grad=True)
    srgb.encode(x).sum().backward()
    assert x.grad[0] == np.float32(12.92)
    torch.testing.assert_close(srgb.encode_slope(x.detach()), x.grad)


@pytest.mark.parametrize("convert", [srgb.encode, srgb.decode, srgb.encode_slope])
def test_arrays_and_tensors_keep_their_precision(convert):
    x = np.linspace(0, 1, 1001)
    for values in (x, x.astype(np.float32)):
        array, tensor = convert(values), convert(torch.from_numpy(values))
        assert array.dtype == values.dtype
        np.testing.assert_allclose(tensor.numpy(), array, rtol=1e-6 if values.dtype == np.float32 else 1e-14)
