import torch
from torch import nn

from objectfolder.benchmarks.models.inputs import Ground
from objectfolder.benchmarks.models.several_touches import SeveralTouches


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
