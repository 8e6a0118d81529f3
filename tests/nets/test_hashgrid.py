import numpy as np
import pytest
import torch

from objectfolder.nets.hashgrid import HashGrid, WeightedRows, scattered_product, transposed_product


def naive(grid, x):
    """Trilinear interpolation in plain torch, one level after the other."""
    out = []
    for level, resolution in enumerate(grid.resolutions):
        table = grid.table[grid.offsets[level] : grid.offsets[level + 1]]
        position = x * resolution
        base = position.floor().clamp(max=resolution - 1)
        fraction = position - base
        total = 0
        for c in range(8):
            bit = torch.tensor([(c >> a) & 1 for a in range(3)])
            corner = base.long() + bit
            if len(table) < (resolution + 1) ** 3:
                row = (corner * torch.tensor([1, 2654435761, 805459861])).unbind(1)
                row = (row[0] ^ row[1] ^ row[2]) % len(table)
            else:
                row = (corner * torch.tensor([1, resolution + 1, (resolution + 1) ** 2])).sum(1)
            total = total + table[row] * torch.where(bit.bool(), fraction, 1 - fraction).prod(1, keepdim=True)
        out.append(total)
    return torch.cat(out, 1)


@pytest.fixture
def grid():
    torch.manual_seed(0)
    grid = HashGrid(levels=4, features=2, table_bits=9, coarsest=4, finest=40)
    assert grid._hashed == [False, True, True, True]
    torch.nn.init.normal_(grid.table)
    return grid


@pytest.fixture
def x():
    return torch.rand(200, 3, generator=torch.Generator().manual_seed(1))


def test_resolutions_grow_geometrically_to_the_finest():
    assert HashGrid(8, 2, 15, 16, 320).resolutions[::7] == [16, 320]
    assert HashGrid(3, 2, 15, 4, 16).resolutions == [4, 8, 16]
    assert HashGrid(1, 2, 15, 4, 16).resolutions == [4]


def test_forward_and_backward_equal_autograd_through_plain_torch(grid, x):
    weight = torch.randn(200, 8, generator=torch.Generator().manual_seed(2))
    gradients = []
    for function in (grid, lambda p: naive(grid, p)):
        grid.table.grad = None
        value = function(x)
        (value * weight).sum().backward()
        gradients.append(grid.table.grad.clone())
    torch.testing.assert_close(grid(x), naive(grid, x), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(*gradients, atol=1e-5, rtol=1e-5)
    assert (gradients[0] != 0).any(1).float().mean() > 0.3


def test_weights_are_a_partition_of_unity_and_rows_stay_in_their_level(grid):
    corners = torch.tensor([[i, j, k] for i in (0.0, 1) for j in (0.0, 1) for k in (0.0, 1)])
    rows, weights = grid.corners(torch.cat([corners, torch.tensor([[-1.0, 0.5, 2.0]])]))
    np.testing.assert_allclose(weights.view(9, 4, 8).sum(2), 1, atol=1e-6)
    for level in range(4):
        part = rows.view(9, 4, 8)[:, level]
        assert part.min() >= grid.offsets[level]
        assert part.max() < grid.offsets[level + 1]


def test_a_row_does_not_depend_on_its_batch(grid, x):
    whole = grid(x)
    assert torch.equal(grid(x[50:60]), whole[50:60])
    assert torch.equal(grid(x.flip(0)), whole.flip(0))


def test_no_points(grid):
    assert grid(torch.zeros(0, 3)).shape == (0, 8)


def test_both_ways_to_the_gradient_agree():
    generator = torch.Generator().manual_seed(0)
    rows = torch.randint(30, (50, 8), generator=generator).int()
    weights, gradient = torch.rand(50, 8, generator=generator), torch.rand(50, 3, generator=generator)
    a, b = (product(rows, weights, gradient, 32) for product in (transposed_product, scattered_product))
    assert a.shape == (32, 3)
    torch.testing.assert_close(a, b)


def test_sums_of_rows_have_the_derivative_of_their_formula():
    generator = torch.Generator().manual_seed(0)
    table = torch.randn(40, 3, generator=generator, requires_grad=True)
    rows = torch.randint(0, 30, (200, 27), generator=generator)  # some repeat in a sum, some are never taken
    weights, ahead = torch.randn(200, 27, generator=generator), torch.randn(200, 3, generator=generator)
    sums = WeightedRows.apply(table, rows, weights)
    expected = torch.einsum("pk,pkc->pc", weights, table[rows])
    torch.testing.assert_close(sums, expected)
    (found,), (true,) = (torch.autograd.grad(value, table, ahead) for value in (sums, expected))
    torch.testing.assert_close(found, true, atol=1e-4, rtol=1e-4)
