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
    """Return zeros of the library, the type and the device of an array."""
    return array_library(like).zeros(shape, dtype=like.dtype, device=like.device)
