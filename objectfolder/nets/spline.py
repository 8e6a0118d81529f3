"""Features on a grid of quadratic B-splines, stored only near a surface."""

import torch
import torch.nn.functional as F
from torch import nn

from objectfolder.nets.hashgrid import WeightedRows

_OFFSETS = torch.arange(3, device="cpu")


class SplineGrid(nn.Module):
    """Smooth features at points of the unit frame, each interpolated from 27 nodes.

    The grid has ``resolution`` cells along each axis of [-0.5, 0.5]^3, so (resolution + 2)^3 nodes. ``used``
    marks those with features; others have zeros. See `mark_touched`.
    """

    used: torch.Tensor
    row: torch.Tensor

    def __init__(self, resolution: int, channels: int, used: torch.Tensor):
        super().__init__()
        self.resolution = resolution
        self.register_buffer("used", used)
        count = int(used.sum())
        row = torch.where(used, used.cumsum(0) - 1, count)
        self.register_buffer("row", row, persistent=False)
        self.table = nn.Parameter(torch.empty(count, channels))
        if not self.table.is_meta:  # where normal numbers would import a third of torch, for nothing
            nn.init.normal_(self.table, std=0.5)

    def nodes(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Compute table rows and weights of (N, 3) points; both (N, 27).

        Compute them once for points that are looked up repeatedly.
        """
        index, weights = _nodes(x, self.resolution)
        return self.row[index], weights

    def lookup(self, rows: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Interpolate features, given the output of `nodes`; (N, channels)."""
        # With a last row of zeros, for nodes without features.
        padded = torch.cat([self.table, torch.zeros_like(self.table[:1])])
        if weights.requires_grad:  # the slope along the points, which `WeightedRows` lacks
            return F.embedding_bag(rows, padded, per_sample_weights=weights, mode="sum")
        return WeightedRows.apply(padded, rows, weights)


def mark_touched(x: torch.Tensor, resolution: int) -> torch.Tensor:
    """Return a mask of the nodes that affect (N, 3) points; ((resolution + 2)^3,) bool."""
    used = torch.zeros((resolution + 2) ** 3, dtype=torch.bool)
    used[_nodes(x, resolution)[0]] = True
    return used


def _nodes(x: torch.Tensor, resolution: int) -> tuple[torch.Tensor, torch.Tensor]:
    position = (x.double() + 0.5).clamp(0, 1) * resolution
    cell = position.floor().long().clamp(max=resolution - 1)
    t = (position - cell).to(x.dtype)
    # (N, 3 axes, 3 nodes)
    weights = torch.stack([(1 - t) ** 2 / 2, 0.5 + t - t * t, t * t / 2], -1)
    along = cell[:, :, None] + _OFFSETS.to(x.device)
    side = resolution + 2
    index = (along[:, 0, :, None, None] * side + along[:, 1, None, :, None]) * side + along[:, 2, None, None]
    product = weights[:, 0, :, None, None] * weights[:, 1, None, :, None] * weights[:, 2, None, None]
    return index.flatten(1), product.flatten(1)
