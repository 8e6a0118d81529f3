"""What queries have in common: arguments, checked and as float64 arrays, and the modes of torch."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

import numpy as np
import torch
from typing_extensions import TypeVar  # the standard one has defaults since Python 3.13

from objectfolder.base.checks import TRANSFORMED, real_array, refuse_rows
from objectfolder.base.errors import ObjectFolderError

_KINDS = "cpu", "cuda", "mps", "xpu"  # of devices for which nets may be cast automatically
_Part = TypeVar("_Part")

# The answer to a query is a tensor if its first argument is one, and an array if that is an array or a list.
Answer = TypeVar("Answer", np.ndarray, torch.Tensor, default=np.ndarray)
#: Rows of numbers, of any real dtype and any strides.
Rows = np.ndarray | torch.Tensor | Sequence[float] | Sequence[Sequence[float]]
#: One number for all rows, or one per row.
Scalars = float | np.ndarray | torch.Tensor | Sequence[float]


def finite_rows(name: str, values: object, width: int) -> np.ndarray:
    """Return finite numbers as an (N, width) array; one row may lack its first axis."""
    array = real_array(name, values)
    if array.ndim == 1 and len(array) == width:
        array = array[None]
    if array.ndim != 2 or array.shape[1] != width:
        raise ObjectFolderError(f"{name} has shape {array.shape}, expected (N, {width})")
    refuse_rows(name, ~np.isfinite(array).all(1), array, ", expected finite numbers")
    return array


def broadcast_rows(a_name: str, a: np.ndarray, b_name: str, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays with equal numbers of rows; a single row is repeated."""
    if len(a) != len(b) and 1 not in (len(a), len(b)):
        raise ObjectFolderError(f"{a_name} has {len(a)} rows, {b_name} {len(b)}; expected as many, or one")
    count = len(b) if len(a) == 1 else len(a)
    first, second = (np.repeat(x, count, 0) if len(x) == 1 else x for x in (a, b))
    return first, second


def finite_scalars(name: str, values: object, count: int) -> np.ndarray:
    """Return one finite number, repeated, or ``count`` of them; (count,)."""
    array = real_array(name, values)
    if array.ndim > 1 or array.size not in (1, count):
        raise ObjectFolderError(f"{name} has shape {array.shape}, expected one number or {count} of them")
    refuse_rows(name, ~np.isfinite(array), array.reshape(-1), ", expected finite numbers")
    return np.broadcast_to(array.reshape(-1), (count,)) if array.size == 1 else array


def like_first(answer: np.ndarray, first: Answer | Sequence[Any]) -> Answer:
    """Return an answer as a tensor on the device of a query's first argument, if that is a tensor."""
    like: Any = torch.from_numpy(answer).to(first.device) if isinstance(first, torch.Tensor) else answer
    return like


def true_or_false(name: str, value: object) -> bool:
    """Return a truth value; anything else is refused."""
    if not isinstance(value, bool | np.bool_):
        raise ObjectFolderError(f"{name} is of type {type(value).__name__}, expected True or False")
    return bool(value)


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
