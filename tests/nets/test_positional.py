import math

import torch

from objectfolder.nets.positional import (
    HiddenLinear,
    PointwiseNetwork,
    SkipNetwork,
    octave_angles,
    train_in,
)


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


def test_a_layer_between_hidden_layers_is_trained_in_their_precision_and_answers_in_float32():
    torch.manual_seed(0)
    layer, x = HiddenLinear(64, 32), torch.randn(200, 64)
    exact = layer(x)
    train_in(layer, "bfloat16")
    trained = layer.train()(x)
    assert trained.dtype == torch.float32
    assert 1e-4 < (trained - exact).norm() / exact.norm() < 0.01
    assert torch.equal(layer.eval()(x), exact)


def test_bfloat16_gives_nearly_the_gradients_of_float32_and_the_same_answers():
    torch.manual_seed(0)
    net, x = PointwiseNetwork(64, 8, 6, 6, outputs=2), torch.rand(200, 5) * 2 - 1
    gradients = []
    for precision in ("float32", "bfloat16"):
        train_in(net, precision)
        net.zero_grad()
        out = net.train()(x)
        assert out.dtype == torch.float32
        (out - x[:, :2]).square().mean().backward()
        gradients.append(torch.cat([p.grad.flatten() for p in net.parameters()]))
        assert gradients[-1].dtype == torch.float32
    difference = (gradients[1] - gradients[0]).norm() / gradients[0].norm()
    assert 1e-4 < difference < 0.03  # 8 bits of a hidden value: 0.4 %
    answer = net.eval()(x)  # an answer does not depend on how the net was trained
    train_in(net, "float32")
    assert torch.equal(net(x), answer)
