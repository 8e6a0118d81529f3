"""Random numbers that depend on the seed, the object and the purpose, and on nothing else."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


def numpy_generator(seed: int, *purpose: str) -> np.random.Generator:
    """Generator for one purpose, such as ``(key, "render_views", "train")``."""
    return np.random.default_rng(_digest(seed, purpose))


def torch_generator(seed: int, *purpose: str) -> torch.Generator:
    """Torch generator (CPU) for one purpose."""
    return torch.Generator().manual_seed(_digest(seed, purpose) % 2**63)


@contextmanager
def seeded(seed: int, *purpose: str) -> Iterator[None]:
    """Seed torch's global generator (CPU) for one purpose, and afterwards put back its state.

    For layers, which take their first parameters from it.
    """
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(_digest(seed, purpose) % 2**63)
        yield


def _digest(seed: int, purpose: tuple[str, ...]) -> int:
    return int.from_bytes(hashlib.sha256("/".join([str(seed), *purpose]).encode()).digest()[:16], "little")
