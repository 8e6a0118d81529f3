import numpy as np
import torch

from objectfolder.mesh import srgb
from objectfolder.vision.color import find_lit_foreground, on_white


def test_a_picture_is_composited_pixel_by_pixel():
    """The bare ones too, which are passed over."""
    generator = torch.Generator().manual_seed(0)
    rgba = torch.rand(9, 7, 4, generator=generator) * (torch.rand(9, 7, 1, generator=generator) > 0.5)
    expected = srgb.encode((rgba[..., :3] + (1 - rgba[..., 3:])).clamp(0, 1))
    shown = on_white(rgba)
    torch.testing.assert_close(shown, expected, rtol=0, atol=2e-7)
    assert torch.equal(on_white(rgba.transpose(0, 1)), shown.transpose(0, 1))


def test_lit_foreground_is_covered_whole_and_over_a_hundredth_of_white():
    rgba = np.array([[0.5, 0, 0, 1], [0.5, 0, 0, 0.99], [0.009, 0.009, 0.009, 1], [0, 0, 0.011, 1]])
    assert find_lit_foreground(rgba).tolist() == [True, False, False, True]
