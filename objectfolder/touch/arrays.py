"""NumPy arrays or torch tensors in one code: NumPy is faster on small images, torch runs on GPUs."""

from types import ModuleType
from typing import Any

import numpy as np
import torch

Array = Any  #: NumPy array or torch tensor


def array_library(of: Array) -> ModuleType:
    """Return the module that works on an array: torch or numpy."""
    return torch if isinstance(of, torch.Tensor) else np


def zeros(shape: tuple[int, ...], like: Array) -> Array:
    """Return float32 zeros of the same library and on the same device as an array."""
    library = array_library(like)
    return library.zeros(shape, dtype=library.float32, device=like.device)
