"""Vectors (S, 3) whose three columns lie each in one piece of memory.

Operations on them keep that order, and take a fraction of the time that they take on rows of three.
"""

from collections.abc import Sequence

import torch


def columns(rows: torch.Tensor) -> torch.Tensor:
    """Return the same (S, C) values, each column in one piece."""
    return rows.mT.contiguous().mT


def dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Scalar products of (S, 3) vectors; (S, 1)."""
    return (a * b).sum(-1, keepdim=True)


def unit(vectors: torch.Tensor) -> torch.Tensor:
    """Return (S, 3) vectors at unit length; zero stays zero."""
    return vectors / dot(vectors, vectors).sqrt().clamp(min=1e-12)


def select(values: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """Rows of (S, ...) values, in the order of memory that they have."""
    return values.mT.index_select(1, index).mT if _in_columns(values) else values.index_select(0, index)


def joined(parts: Sequence[torch.Tensor], axis: int = 0) -> torch.Tensor:
    """Concatenate tensors in the order of memory that the first has."""
    if _in_columns(parts[0]):
        return torch.cat([part.mT for part in parts], 1 - axis).mT
    return torch.cat(list(parts), axis)


def _in_columns(values: torch.Tensor) -> bool:
    return values.dim() > 1 and values.stride(0) < values.stride(1)
