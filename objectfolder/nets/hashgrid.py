"""Multiresolution hash encoding (Mueller et al. 2022) in torch.

Interpolating a table is a product with a sparse matrix of eight weights per row. On a CPU the backward pass
of ``embedding_bag`` would dominate training; SciPy's transposed product is 25 times as fast.
"""

import itertools
import lzma
import math
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn
from torch.autograd.function import once_differentiable

_PRIMES = (1, 2654435761 - 2**32, 805459861)  # as int32: only the lower 32 bits of a product are used


class HashGrid(nn.Module):
    """Trainable features of points in the unit cube [0, 1]^3, so many for each of several grids.

    ``coarsest`` and ``finest`` are the cells along a side of the first and the last grid; those between form
    a geometric progression. A level with more than ``2**table_bits`` vertices is hashed into that many
    entries.
    """

    def __init__(self, levels: int, features: int, table_bits: int, coarsest: int, finest: int):
        super().__init__()
        self.config = {"levels": levels, "features": features, "table_bits": table_bits}
        self.config |= {"coarsest": coarsest, "finest": finest}
        growth = (finest / coarsest) ** (1 / max(levels - 1, 1))
        self.resolutions = [math.floor(coarsest * growth**level + 1e-9) for level in range(levels)]
        capacity = 2**table_bits
        self._hashed = [(r + 1) ** 3 > capacity for r in self.resolutions]
        sizes = [capacity if h else (r + 1) ** 3 for r, h in zip(self.resolutions, self._hashed)]
        self.offsets = [0, *np.cumsum(sizes).tolist()]
        self.width = levels * features
        self.table = nn.Parameter(torch.empty(self.offsets[-1], features).uniform_(-1e-4, 1e-4))

    def corners(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Compute table rows and trilinear weights of (N, 3) points; both (N, levels * 8).

        Compute them once for points that are looked up repeatedly.
        """
        count, width = len(x), 8 * len(self.resolutions)
        rows, weights = x.new_empty(count, width, dtype=torch.int32), x.new_empty(count, width)
        axes = x.clamp(0, 1).mT.contiguous()
        for level, resolution in enumerate(self.resolutions):
            position = axes * resolution
            base = position.floor().clamp(max=resolution - 1)
            upper = position - base
            shares = (1 - upper, upper)
            hashed, side = self._hashed[level], resolution + 1
            # Contribution of each coordinate to the row number, for the lower and the upper corner.
            factors = x.new_tensor(_PRIMES if hashed else (1, side, side**2), dtype=torch.int32)[:, None]
            first = base.int() * factors
            terms = (first, first + factors)
            join = torch.bitwise_xor if hashed else torch.add
            for a, b in itertools.product(range(2), range(2)):
                row, weight = join(terms[a][0], terms[b][1]), shares[a][0] * shares[b][1]
                for c in range(2):
                    column, number = 8 * level + a + 2 * b + 4 * c, join(row, terms[c][2])
                    if hashed:
                        number &= 2 ** self.config["table_bits"] - 1
                    rows[:, column] = number + self.offsets[level]
                    weights[:, column] = weight * shares[c][2]
        return rows, weights

    def lookup(self, rows: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Interpolate features, given the output of `corners`; (N, levels * features)."""
        sums = WeightedRows.apply(self.table, rows.reshape(-1, 8), weights.reshape(-1, 8).float())
        return sums.view(len(rows), self.width)

    def packed(self) -> dict[str, np.ndarray]:
        """Return the table for storing: an xz stream of int8, and a float32 factor per level."""
        levels = self.table.detach().split(np.diff(self.offsets).tolist())
        factors = [level.abs().max().clamp(min=1e-12) / 127 for level in levels]
        whole = torch.cat([(level / factor).round().to(torch.int8) for level, factor in zip(levels, factors)])
        stream = lzma.compress(whole.numpy().tobytes())
        return {"table": np.frombuffer(stream, np.uint8), "factors": torch.stack(factors).numpy()}

    def unpacked(self, table: np.ndarray, factors: np.ndarray) -> torch.Tensor:
        """Invert `packed`; return a float32 table.

        Raises ValueError if the number of values is not that of this grid (larger streams are not
        decompressed further), lzma.LZMAError if the stream is damaged.
        """
        size = self.table.numel()
        raw = lzma.LZMADecompressor(memlimit=2**30).decompress(table.tobytes(), size + 1)
        if len(raw) != size:
            raise ValueError(f"{len(raw)} values in the table of a hash grid, expected {size}")
        whole = torch.from_numpy(np.frombuffer(raw, np.int8).astype(np.float32)).view(self.table.shape)
        rows = torch.from_numpy(np.diff(self.offsets))
        return whole * torch.from_numpy(np.array(factors)).repeat_interleave(rows)[:, None]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate features at (N, 3) points; (N, levels * features)."""
        return self.lookup(*self.corners(x))


class WeightedRows(torch.autograd.Function):
    """Sums (N, C) of (N, K) rows of a (T, C) table with (N, K) weights; differentiable in the table.

    They are a product with a sparse matrix.
    """

    @staticmethod
    def forward(ctx: Any, table: torch.Tensor, rows: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Evaluate the sums."""
        ctx.save_for_backward(rows, weights)
        ctx.entries = len(table)
        return F.embedding_bag(rows, table, mode="sum", per_sample_weights=weights)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        """Return the gradient of the table, (T, C)."""
        rows, weights = ctx.saved_tensors
        product = transposed_product if rows.is_cpu else scattered_product
        return product(rows, weights, gradients[0], ctx.entries), None, None


def transposed_product(
    rows: torch.Tensor, weights: torch.Tensor, gradient: torch.Tensor, entries: int
) -> torch.Tensor:
    """Scatter gradients (N, C) to a table (entries, C), by rows and weights (N, K)."""
    from scipy.sparse import csc_array  # only training needs it

    taken = rows.numpy()
    starts = np.arange(0, taken.size + 1, taken.shape[1], dtype=taken.dtype)
    matrix = csc_array((weights.numpy().ravel(), taken.ravel(), starts), shape=(entries, len(taken)))
    return torch.from_numpy(matrix @ np.ascontiguousarray(gradient.numpy()))


def scattered_product(
    rows: torch.Tensor, weights: torch.Tensor, gradient: torch.Tensor, entries: int
) -> torch.Tensor:
    """Compute `transposed_product` on any device: fast with atomic additions, slow on a CPU."""
    parts = (weights[:, :, None] * gradient[:, None]).flatten(0, 1)
    return gradient.new_zeros(entries, gradient.shape[1]).index_add_(0, rows.flatten(), parts)
