import torch

from objectfolder.vision.vectors import column_major, concatenate, dot, normalize_rows, take_rows

ROWS = torch.rand(7, 3, generator=torch.Generator().manual_seed(0))


def test_the_order_of_memory_is_kept_and_changes_nothing():
    index = torch.tensor([4, 0, 0, 6])
    for values, strides in ((ROWS, (3, 1)), (column_major(ROWS), (1, 7))):
        assert values.stride() == strides
        assert torch.equal(values, ROWS)
        assert torch.equal(take_rows(values, index), ROWS[index])
        assert torch.equal(concatenate([values, ROWS]), torch.cat([ROWS, ROWS]))
        assert torch.equal(concatenate([values, ROWS], 1), torch.cat([ROWS, ROWS], 1))
        for made in (take_rows(values, index), concatenate([values, ROWS]), concatenate([values, ROWS], 1)):
            assert made.mT.is_contiguous() == values.mT.is_contiguous()
        torch.testing.assert_close(dot(values, values)[:, 0], ROWS.square().sum(1))


def test_unit_vectors_and_zero():
    torch.testing.assert_close(normalize_rows(5 * ROWS).norm(dim=1), torch.ones(7))
    assert not normalize_rows(torch.zeros(2, 3)).any()
