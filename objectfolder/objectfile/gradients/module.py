"""What the modules of an Object File have in common."""

from collections.abc import Callable
from typing import Any

from torch import nn


class AnswerModule(nn.Module):
    """A module that pickles, and copies deeply, by being made again from its Object File."""

    #: Function that makes the module, and its arguments.
    source: tuple[Callable[..., nn.Module], tuple[Any, ...]]

    def __reduce__(self) -> tuple[Any, ...]:
        return self.source
