import pytest
import torch

from objectfolder.nets.spline import SplineGrid, mark_touched


def grid(resolution=5, channels=2, used=None):
    used = torch.ones((resolution + 2) ** 3, dtype=torch.bool) if used is None else used
    return SplineGrid(resolution, channels, used)


@pytest.fixture
def points():
    return torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) - 0.5


def test_weights_are_a_partition_of_one(points):
    _, weights = grid().nodes(torch.cat([points, torch.tensor([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.5]])]))
    assert (weights >= 0).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(502))


def test_linear_functions_are_reproduced(points):
    """Node i of an axis stands at (i - 1/2) cells."""
    g = grid()
    place = (torch.arange(7) - 0.5) / 5 - 0.5
    x, y, z = torch.meshgrid(place, place, place, indexing="ij")
    with torch.no_grad():
        g.table.copy_(torch.stack([x + 2 * y - z, 1 + z], -1).reshape(-1, 2))
    expected = torch.stack([points @ torch.tensor([1.0, 2, -1]), 1 + points[:, 2]], 1)
    torch.testing.assert_close(g.lookup(*g.nodes(points)), expected, atol=1e-5, rtol=0)


def test_features_are_smooth_across_cells():
    torch.manual_seed(0)
    g = grid()
    line = torch.linspace(-0.45, 0.45, 20001)
    x = torch.stack([line, 0.3 * line, -0.2 * line], 1)
    value = g.lookup(*g.nodes(x)).double()
    slope = value.diff(dim=0) / line.diff()[:, None].double()
    assert slope.diff(dim=0).abs().max() < 0.05 * slope.abs().max()


def test_only_touched_nodes_have_features(points):
    near = points[points.norm(dim=1) < 0.2]
    used = mark_touched(near, 5)
    assert 27 <= used.sum() < 343
    part, whole = grid(used=used), grid()
    with torch.no_grad():
        whole.table[used] = part.table
    assert part.table.shape == (int(used.sum()), 2)
    torch.testing.assert_close(part.lookup(*part.nodes(near)), whole.lookup(*whole.nodes(near)))
    far = torch.tensor([[0.49, 0.49, 0.49]])
    assert part.lookup(*part.nodes(far)).abs().max() < 1e-5
    assert part.lookup(*part.nodes(torch.empty(0, 3))).shape == (0, 2)
