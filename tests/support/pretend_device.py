"""A second device for tests without a GPU: it computes on the CPU and is as strict about devices as CUDA.

Tensors on it hold real values, so that answers can be compared with those of the CPU. An operation on
tensors of two devices raises, with CUDA's exceptions for numbers (0-dimensional tensors), indices and copies.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any
from unittest.mock import patch

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map
from torch.utils.backend_registration import _DummyBackendModule, _setup_privateuseone_for_python_backend

NAME = "pretend"
_aten = torch.ops.aten
_COPIES = {_aten.copy_.default, _aten._to_copy.default, _aten.set_.source_Tensor}
_INDEXED = {_aten.index.Tensor, _aten.index_put_.default, _aten._index_put_impl_.default}


class PretendTensor(torch.Tensor):
    """A tensor on the device; ``held`` is the one on the CPU that it stands for."""

    held: torch.Tensor

    @staticmethod
    def __new__(cls, held: torch.Tensor) -> "PretendTensor":
        like = {"strides": held.stride(), "storage_offset": held.storage_offset(), "dtype": held.dtype}
        make = torch.Tensor._make_wrapper_subclass  # type: ignore[attr-defined]
        tensor = make(cls, held.size(), device=f"{NAME}:0", **like)
        tensor.held = held
        return tensor

    @classmethod
    def __torch_dispatch__(cls, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _dispatch(operation, args, kwargs or {})

    def tolist(self) -> Any:
        """Return the values as lists, as tensors of any device do, but not their subclasses."""
        return self.held.tolist()

    def new_tensor(self, data: Any, **kwargs: Any) -> torch.Tensor:
        """Return a tensor of values, of this type and on this device unless said otherwise."""
        return torch.tensor(data, **{"dtype": self.dtype, "device": self.device, **kwargs})


class _Factories(TorchDispatchMode):
    """Serve operations that make tensors on the device, which get no tensor of it."""

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False  # nothing is compiled here, and importing the compiler takes seconds

    def __torch_dispatch__(self, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _dispatch(operation, args, kwargs or {})


def _from_data(function: Callable[..., torch.Tensor]) -> Callable[..., torch.Tensor]:
    """Make tensors of Python values on the CPU first: torch does so out of reach of dispatch modes."""

    def make(*args: Any, device: Any = None, **kwargs: Any) -> torch.Tensor:
        return function(*args, **kwargs).to(device)

    return make


@contextmanager
def pretend_device() -> Iterator[str]:
    """Provide the name of the device, which exists inside this block."""
    _register()
    # Backward passes would start a thread for the device, which aborts the process at its end.
    makers = {name: _from_data(getattr(torch, name)) for name in ("tensor", "as_tensor")}
    with torch.autograd.set_multithreading_enabled(False), _Factories(), patch.multiple(torch, **makers):
        yield NAME


class _Module(_DummyBackendModule):
    """What other code finds of the device after the block: none, so that it saves no random state of it."""

    def device_count(self) -> int:
        return 0


@cache
def _register() -> None:
    _setup_privateuseone_for_python_backend(NAME, _Module())


def _dispatch(operation: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    tensors = [x for x in tree_leaves((args, kwargs)) if isinstance(x, torch.Tensor)]
    here = any(isinstance(x, PretendTensor) for x in tensors)
    if (device := kwargs.get("device")) is not None:
        here = torch.device(device).type == NAME
        kwargs = {**kwargs, "device": torch.device("cpu")}
    elif here and operation not in _COPIES:
        _demand_one_device(operation, args, tensors)
    answer = operation(*tree_map(_held, args), **tree_map(_held, kwargs))
    if operation is _aten._to_copy.default and tensors[0].device.type != device:
        answer = answer.clone()  # another device never shares memory
    if operation._schema.is_mutable and isinstance(args[0], torch.Tensor):
        return args[0]
    wrap = PretendTensor if here else lambda tensor: tensor
    return tree_map(lambda x: wrap(x) if isinstance(x, torch.Tensor) else x, answer)


def _demand_one_device(operation: Any, args: Any, tensors: list[torch.Tensor]) -> None:
    if operation in _INDEXED and isinstance(args[0], PretendTensor):
        tensors = [args[0], *(x for x in args[2:] if isinstance(x, torch.Tensor))]
    strangers = [x for x in tensors if not isinstance(x, PretendTensor) and x.dim()]
    first = args[0] if isinstance(args[0], torch.Tensor) else tensors[0]
    if strangers or not isinstance(first, PretendTensor):
        shapes = [(str(x.device), tuple(x.shape)) for x in tensors]
        raise RuntimeError(f"{operation}: expected all tensors to be on the same device, found {shapes}")


def _held(value: Any) -> Any:
    return value.held if isinstance(value, PretendTensor) else value
