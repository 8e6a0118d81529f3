import pytest
import torch
from torch import nn

from objectfolder.benchmarks.models.inputs import Ground
from objectfolder.benchmarks.models.occupancy_net import (
    ConditionalBatchNorm,
    OccupancyDecoder,
    Reconstructor,
    SeveralTouches,
    occupancy_logits,
)


class Mean(nn.Module):
    """An encoder that is quick to check: the mean of each channel, projected."""

    def __init__(self, channels, features):
        super().__init__()
        self.features, self.layer = features, nn.Linear(channels, features)

    def forward(self, x):
        return self.layer(x.mean((2, 3)))


def randomised(module):
    """Weights that are not 0, so that every path counts."""
    for parameter in module.parameters():
        nn.init.normal_(parameter, std=0.3)
    return module


@pytest.fixture(autouse=True)
def _seeded():
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        yield


def test_conditional_norm_is_batch_norm_with_each_objects_scale_and_shift():
    layer = randomised(ConditionalBatchNorm(4, 6))
    points, embedding = 3 + 2 * torch.randn(3, 50, 6), torch.randn(3, 4)
    gamma = embedding @ layer.gamma.weight.T + layer.gamma.bias
    beta = embedding @ layer.beta.weight.T + layer.beta.bias
    mean, variance = points.mean((0, 1)), points.var((0, 1), correction=0)
    normal = (points - mean) / (variance + 1e-5).sqrt()
    torch.testing.assert_close(layer(points, embedding), gamma[:, None] * normal + beta[:, None])
    # The running statistics are torch's own, and evaluation uses them.
    reference = nn.BatchNorm1d(6, affine=False)
    reference(points.flatten(0, 1))
    torch.testing.assert_close(layer.norm.running_var, reference.running_var)
    layer.eval(), reference.eval()
    expected = gamma[:, None] * reference(points.flatten(0, 1)).view_as(points) + beta[:, None]
    torch.testing.assert_close(layer(points, embedding), expected)


def test_untrained_norm_ignores_the_embedding_and_blocks_pass_points_on():
    layer = ConditionalBatchNorm(4, 6)
    points = torch.randn(3, 50, 6)
    torch.testing.assert_close(layer(points, torch.randn(3, 4)), layer(points, torch.randn(3, 4)))
    decoder = OccupancyDecoder(width=8, blocks=2, embedding=4)
    block = decoder.blocks[0]
    hidden = torch.randn(3, 50, 8)
    torch.testing.assert_close(block(hidden, torch.randn(3, 4)), hidden + block.layer2.bias)


def test_decoder_has_the_papers_layers():
    decoder = OccupancyDecoder()
    sizes = {name: tuple(p.shape) for name, p in decoder.named_parameters()}
    assert len(decoder.blocks) == 5
    assert sizes["first.weight"] == (256, 3)
    assert sizes["last.weight"] == (1, 256)
    assert sizes["blocks.4.layer2.weight"] == (256, 256)
    # 5 blocks of 2 layers, 11 conditional norms with a scale and a shift each, the first and the last layer.
    square = 256 * 256 + 256
    assert sum(p.numel() for p in decoder.parameters()) == (10 + 22) * square + 4 * 256 + 257


def test_points_and_objects_are_independent_in_evaluation():
    decoder = randomised(OccupancyDecoder(width=8, blocks=2, embedding=4)).eval()
    points, embedding = torch.randn(3, 40, 3), torch.randn(3, 4)
    together = decoder(points, embedding)
    assert together.shape == (3, 40)
    torch.testing.assert_close(decoder(points[1:2], embedding[1:2]), together[1:2])
    order = torch.randperm(40)
    torch.testing.assert_close(decoder(points[:, order], embedding), together[:, order])
    torch.testing.assert_close(decoder(points[:, :1], embedding), together[:, :1])
    assert not torch.allclose(decoder(points, embedding.roll(1, 0)), together)  # the shape does depend on it
    shared = points[0]
    expected = torch.cat([decoder(shared[None], one[None]) for one in embedding])
    torch.testing.assert_close(occupancy_logits(decoder, embedding, shared, chunk=7), expected)
    assert not occupancy_logits(decoder, embedding, shared).requires_grad


def test_folded_normalizations_give_the_same_logits():
    decoder = OccupancyDecoder(width=32, blocks=3, frequencies=2)
    for block in decoder.blocks:
        randomised(block.norm1.gamma), randomised(block.norm2.beta)
        nn.init.normal_(block.layer2.weight, std=0.1)
    points, embedding = torch.randn(3, 400, 3), torch.randn(3, 256) / 8
    for _ in range(5):
        decoder(points, embedding)  # running statistics
    decoder.eval()
    with torch.no_grad():
        plain = decoder(points[:1].expand(3, -1, -1), embedding)
    assert plain.std() > 0.1
    folded = occupancy_logits(decoder, embedding, points[0])
    torch.testing.assert_close(folded, plain, rtol=1e-5, atol=1e-5)


def test_the_decoder_of_one_shape_normalizes_no_point_twice(monkeypatch):
    decoder = randomised(OccupancyDecoder(width=8, blocks=2, embedding=4)).eval()
    monkeypatch.setattr(ConditionalBatchNorm, "forward", lambda *_: pytest.fail("normalized"))
    assert occupancy_logits(decoder, torch.randn(1, 4), torch.randn(9, 3), chunk=4).shape == (1, 9)


def test_fusion_takes_one_modality_or_both():
    image, sound = Mean(3, 512), Mean(1, 512)
    inputs = {"vision": torch.randn(2, 3, 8, 8), "audio": torch.randn(2, 1, 6, 5)}
    both = {"vision": image, "audio": sound}
    for encoders, features in (({"vision": image}, 512), ({"audio": sound}, 512), (both, 1024)):
        net = randomised(Reconstructor(encoders, width=16, blocks=1))
        assert tuple(net.fusion[0].weight.shape) == (256, features)
        assert tuple(net.fusion[2].weight.shape) == (256, 256)
        assert net.embed(inputs).shape == (2, 256)
        logits = net(inputs, torch.randn(2, 9, 3))
        assert logits.shape == (2, 9)
        logits.sum().backward()
        assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in net.encoders.parameters())
    changed = inputs | {"audio": inputs["audio"] + 1}
    assert not torch.allclose(net.embed(changed), net.embed(inputs))  # both count


class Sums(nn.Module):
    """Not linear, so that it shows whether touches or features are averaged."""

    features = 2

    def forward(self, x):
        return torch.stack([x.sum((1, 2, 3)), x.square().sum((1, 2, 3))], 1)


def test_several_touches_are_encoded_by_the_mean_of_their_features():
    touches = torch.randn(3, 5, 3, 4, 6, generator=torch.Generator().manual_seed(0))
    net = SeveralTouches(Sums(), (4, 6))
    assert net.features == 2
    torch.testing.assert_close(net(touches), torch.stack([Sums()(five).mean(0) for five in touches]))
    torch.testing.assert_close(net(touches[:, [4, 2, 0, 1, 3]]), net(touches))  # a set has no order


def test_the_ground_is_subtracted_and_stored():
    touches = 7 + 0.1 * torch.randn(6, 3, 4, 6, generator=torch.Generator().manual_seed(0))
    ground = Ground.of(touches)
    net = SeveralTouches(Sums(), (4, 6))
    net.set_ground(ground)
    other = SeveralTouches(Sums(), (4, 6))
    other.load_state_dict(net.state_dict())
    torch.testing.assert_close(other(touches[:, None]), Sums()(ground.subtracted(touches)))
