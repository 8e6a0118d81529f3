import torch

from objectfolder.vision.vectors import columns, dot, joined, select, unit

ROWS = torch.rand(7, 3, generator=torch.Generator().manual_seed(0))


def test_the_order_of_memory_is_kept_and_changes_nothing():
    index = torch.tensor([4, 0, 0, 6])
    for values, strides in ((ROWS, (3, 1)), (columns(ROWS), (1, 7))):
        assert values.stride() == strides
        assert torch.equal(values, ROWS)
        assert torch.equal(select(values, index), ROWS[index])
        assert torch.equal(joined([values, ROWS]), torch.cat([ROWS, ROWS]))
        assert torch.equal(joined([values, ROWS], 1), torch.cat([ROWS, ROWS], 1))
        for made in (select(values, index), joined([values, ROWS]), joined([values, ROWS], 1)):
            assert made.mT.is_contiguous() == values.mT.is_contiguous()
        torch.testing.assert_close(dot(values, values)[:, 0], ROWS.square().sum(1))


def test_unit_vectors_and_zero():
    torch.testing.assert_close(unit(5 * ROWS).norm(dim=1), torch.ones(7))
    assert not unit(torch.zeros(2, 3)).any()
