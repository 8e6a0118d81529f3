"""Random generators that depend only on the seed, the object and the purpose."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import torch


def numpy_generator(seed: int, *purpose: str) -> np.random.Generator:
    """Return the generator for one purpose, such as ``(key, "render_views", "train")``."""
    return np.random.default_rng(_digest(seed, purpose))


def draw_seed(seed: int, *purpose: str) -> int:
    """Return a seed for one purpose, below 2**31, for libraries that take a number."""
    return int(numpy_generator(seed, *purpose).integers(2**31))


def torch_generator(seed: int, *purpose: str) -> torch.Generator:
    """Return the torch generator (CPU) for one purpose."""
    import torch  # here, because stages that use no net start in half the time without it

    return torch.Generator().manual_seed(_digest(seed, purpose) % 2**63)


@contextmanager
def seeded(seed: int, *purpose: str) -> Iterator[None]:
    """Seed torch's global generator (CPU) for one purpose, and restore its state afterwards.

    For layers, which draw their initial parameters from it.
    """
    import torch

    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(_digest(seed, purpose) % 2**63)
        yield


def _digest(seed: int, purpose: tuple[str, ...]) -> int:
    return int.from_bytes(hashlib.sha256("/".join([str(seed), *purpose]).encode()).digest()[:16], "little")
