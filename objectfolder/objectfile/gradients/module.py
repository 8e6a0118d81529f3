"""What the modules of an Object File have in common."""

from collections.abc import Callable
from typing import Any, Self

import torch
from torch import nn

from objectfolder.checks import holds_tensors
from objectfolder.objectfile.torch_modes import usual_modes


class AnswerModule(nn.Module):
    """A module that pickles, and copies deeply, by being made again from its Object File.

    Lists that hold tensors are joined, so that gradients flow to these. torch.compile leaves it as it is, and
    a module that holds it neither moves nor casts it.
    """

    #: Function that makes the module, and its arguments.
    source: tuple[Callable[..., nn.Module], tuple[Any, ...]]

    def __call__(self, *arguments: Any, **settings: Any) -> Any:
        """Answer; see ``forward``."""
        if torch.compiler.is_compiling():
            # A decorator would import the compiler, which takes a second, for everybody.
            return torch.compiler.disable(self._answer)(*arguments, **settings)
        return self._answer(*arguments, **settings)

    def _answer(self, *arguments: Any, **settings: Any) -> Any:
        with usual_modes():
            joined = {name: _joined(value) for name, value in settings.items()}
            return super().__call__(*map(_joined, arguments), **joined)

    def _apply(self, fn: Any, recurse: bool = True) -> Self:
        return self  # it answers on the CPU in its own type, to all who share it

    def __reduce__(self) -> tuple[Any, ...]:
        return self.source


def _joined(value: Any) -> Any:
    """Return nested lists that hold tensors as one; anything else as it is."""
    if not holds_tensors(value):
        return value
    try:
        return _stacked(value)
    except (RuntimeError, TypeError, ValueError):  # the module names the argument
        return value


def _stacked(value: Any) -> torch.Tensor:
    if isinstance(value, list | tuple):
        return torch.stack([_stacked(part) for part in value])
    return torch.as_tensor(value, dtype=torch.float64)
