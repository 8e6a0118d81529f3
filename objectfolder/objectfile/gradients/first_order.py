"""Refusal of second derivatives, which would silently lack what the first ones hold constant."""

from typing import Any

import torch

from objectfolder.errors import ObjectFolderError


def first_order(values: torch.Tensor) -> torch.Tensor:
    """Return values whose gradients raise ObjectFolderError when they are differentiated again.

    Modules hold constant which triangle a ray meets, which pixels touch, and how the surface curves. This
    changes no first derivative, but the second ones.
    """
    return _FirstOrder.apply(values) if values.requires_grad else values


class _FirstOrder(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(values)
        return values.view_as(values)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> torch.Tensor:
        # `once_differentiable` would not do: it cuts a gradient off from the values, so that a second
        # derivative can be a silent 0.
        again = torch.is_grad_enabled()
        return _Gradient.apply(gradients[0], *ctx.saved_tensors) if again else gradients[0]


class _Gradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, gradient: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        return gradient.clone()

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> Any:
        raise ObjectFolderError("the answers of an Object File have first derivatives only, no second ones")
