import math

import torch

from objectfolder.nets.positional import SkipNetwork, octave_angles


def test_octaves_double_from_the_lowest():
    x = torch.tensor([[0.5, -0.25]])
    expected = [0.5, 1, 2, -0.25, -0.5, -1]
    torch.testing.assert_close(octave_angles(x, 3, 1.0), torch.tensor([expected]))
    torch.testing.assert_close(octave_angles(x, 3), torch.tensor([expected]) * math.pi)
    assert octave_angles(x, 0).shape == (1, 0)


def test_the_input_joins_again_after_the_fifth_layer_and_nowhere_else():
    net = SkipNetwork(3, 16, 8)
    assert [layer.in_features for layer in net.hidden] == [3, 16, 16, 16, 16, 19, 16, 16]
    assert [layer.in_features for layer in SkipNetwork(3, 16, 4).hidden] == [3, 16, 16, 16]
    x = torch.randn(5, 3)
    before = net(x)
    torch.nn.init.zeros_(net.hidden[0].weight)  # what is left reaches the output through the skip
    changed = net(x)
    assert changed.shape == (5, 16)
    assert not torch.equal(changed, before)
    assert changed.var(0).sum() > 0
