import pytest
import torch

from objectfolder.base.seeding import seeded
from objectfolder.benchmarks.models.resnet import Block, ResNet18


def _norm(name, width):
    return {
        **{f"{name}.{part}": (width,) for part in ("weight", "bias", "running_mean", "running_var")},
        f"{name}.num_batches_tracked": (),
    }


def _table_1_of_he_et_al(channels):
    """Names and shapes of torchvision's resnet18 without fc, in its order."""
    shapes = {"conv1.weight": (64, channels, 7, 7), **_norm("bn1", 64)}
    inputs = 64
    for stage, width in enumerate([64, 128, 256, 512], 1):
        for block in (0, 1):
            name = f"layer{stage}.{block}"
            shapes |= {f"{name}.conv1.weight": (width, inputs, 3, 3), **_norm(f"{name}.bn1", width)}
            shapes |= {f"{name}.conv2.weight": (width, width, 3, 3), **_norm(f"{name}.bn2", width)}
            if inputs != width:
                shapes |= {f"{name}.downsample.0.weight": (width, inputs, 1, 1)}
                shapes |= _norm(f"{name}.downsample.1", width)
            inputs = width
    return shapes


@pytest.mark.parametrize("channels", [3, 1])
def test_names_and_shapes_are_those_of_torchvision(channels):
    net = ResNet18(channels)
    shapes = {name: tuple(value.shape) for name, value in net.state_dict().items()}
    assert list(shapes.items()) == list(_table_1_of_he_et_al(channels).items())
    # 11,689,512 with the 513,000 of fc, as torchvision's documentation counts
    count = 11_176_512 - (3 - channels) * 64 * 49
    assert sum(p.numel() for p in net.parameters()) == count


@pytest.mark.parametrize("width", [1 / 2, 1 / 4])
def test_a_narrow_net_has_a_share_of_all_channels(width):
    net, full = ResNet18(3, width), _table_1_of_he_et_al(3)
    shapes = {name: tuple(value.shape) for name, value in net.state_dict().items()}
    # All numbers of channels but the input's three are 64 or more; kernels are at most seven pixels wide.
    expected = {name: tuple(int(n * width) if n >= 64 else n for n in shape) for name, shape in full.items()}
    assert shapes == expected
    assert net(torch.zeros(2, 3, 64, 48)).shape == (2, net.features) == (2, 512 * width)


def test_each_stage_halves_the_picture():
    net, sizes = ResNet18(3), []
    for module in (net.conv1, net.maxpool, net.layer1, net.layer2, net.layer3, net.layer4):
        module.register_forward_hook(lambda module, inputs, out: sizes.append(tuple(out.shape[1:])))
    assert net(torch.zeros(2, 3, 224, 160)).shape == (2, 512)
    assert sizes == [(64, 112, 80), (64, 56, 40), (64, 56, 40), (128, 28, 20), (256, 14, 10), (512, 7, 5)]


def test_block_of_zero_weight_passes_its_positive_input_on():
    block = Block(8, 8, 1)
    torch.nn.init.zeros_(block.bn2.weight)
    x = torch.randn(2, 8, 5, 5)
    torch.testing.assert_close(block(x), x.relu(), rtol=0, atol=0)


def test_features_are_the_mean_over_the_last_pictures_pixels():
    net = ResNet18(1).eval()
    last = []
    net.layer4.register_forward_hook(lambda module, inputs, out: last.append(out))
    features = net(torch.randn(2, 1, 64, 96))
    torch.testing.assert_close(features, last[0].flatten(2).mean(2))


def test_features_in_evaluation_do_not_depend_on_other_rows():
    net = ResNet18(3).eval()
    x = torch.randn(3, 3, 64, 64)
    with torch.no_grad():
        alone, together = net(x[:1]), net(x)[:1]
    torch.testing.assert_close(alone, together, rtol=1e-5, atol=1e-6)


def test_first_parameters_are_kaimings_and_follow_from_the_seed():
    state = torch.random.get_rng_state()
    nets = []
    for seed in (3, 3, 4):
        with seeded(seed, "test"):
            nets.append(ResNet18(3))
    assert torch.equal(state, torch.random.get_rng_state())
    first, again, other = (net.layer4[1].conv2.weight for net in nets)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    # 2.4 million numbers of deviation sqrt(2 / fan out)
    assert first.std().item() == pytest.approx((2 / (512 * 9)) ** 0.5, rel=0.01)
    assert abs(first.mean().item()) < 1e-4
