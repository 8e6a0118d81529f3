"""The modes of torch in which an Object File answers, whatever those of its caller."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TypeVar

import torch

from objectfolder.checks import TRANSFORMED
from objectfolder.errors import ObjectFolderError

_KINDS = "cpu", "cuda", "mps", "xpu"  # of devices for which nets may be cast automatically
_Part = TypeVar("_Part")


@contextmanager
def usual_modes() -> Iterator[None]:
    """Compute as if the caller used neither autocast nor inference mode; gradients are recorded as it wants.

    Answers then have the same values everywhere, and what is kept can serve a later gradient: tensors that
    are made in inference mode never can.

    Raises
    ------
    ObjectFolderError
        In a function that torch.func or vmap transforms.
    """
    transforms = getattr(torch._C._functorch, "peek_interpreter_stack", lambda: None)
    if transforms() is not None:
        raise ObjectFolderError(TRANSFORMED)
    recorded = torch.is_grad_enabled()
    with ExitStack() as modes:
        modes.enter_context(torch.inference_mode(False))  # records gradients
        modes.enter_context(torch.set_grad_enabled(recorded))
        for kind in _KINDS:
            if torch.is_autocast_enabled(kind):
                modes.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":  # not always: it slows every call
            modes.enter_context(torch.device("cpu"))
        yield


def each_in_usual_modes(parts: Iterator[_Part]) -> Iterator[_Part]:
    """Return an iterator that computes each part in `usual_modes`, and leaves the caller its own between."""
    return iter(usual_modes()(partial(next, parts, None)), None)
