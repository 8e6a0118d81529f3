"""What the modules of an Object File have in common: one call, first derivatives alone, and the surface."""

from collections.abc import Callable
from typing import Any, Self

import numpy as np
import torch
from torch import nn

from objectfolder.base.checks import holds_tensors
from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.stored.arguments import usual_modes


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
            joined = {name: _join(value) for name, value in settings.items()}
            return super().__call__(*map(_join, arguments), **joined)

    def _apply(self, fn: Any, recurse: bool = True) -> Self:
        return self  # it answers on the CPU in its own type, to all who share it

    def __reduce__(self) -> tuple[Any, ...]:
        return self.source


def _join(value: Any) -> Any:
    """Return nested lists that hold tensors as one; anything else as it is."""
    if not holds_tensors(value):
        return value
    try:
        return _stack(value)
    except (RuntimeError, TypeError, ValueError):  # the module names the argument
        return value


def _stack(value: Any) -> torch.Tensor:
    if isinstance(value, list | tuple):
        return torch.stack([_stack(part) for part in value])
    return torch.as_tensor(value, dtype=torch.float64)


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
        raise ObjectFolderError("results of an Object File have first derivatives only, no second ones")


def follow_surface(points: torch.Tensor, closest: np.ndarray, surface: Isosurface) -> torch.Tensor:
    """Return the closest points of a surface, with the gradients of a projection of the points onto it.

    The closest point of a moving point moves by the part of the motion that the implicit function theorem
    leaves: the stored distance d stays 0, and its normal n is the direction of projection, so that d(closest)
    = (I - n grad(d)' / (n . grad(d))) d(point). This is exact for points on the surface. Of points off it,
    the surface's curvature is left out, an error of the order of the distance over the radius of curvature.
    Those equal to their closest point, (N, 3) in the unit frame, follow it without constraint.
    """
    place = torch.from_numpy(closest).to(points)
    if not points.requires_grad:
        return place
    points = first_order(points)
    at = torch.tensor(closest, dtype=torch.float32, requires_grad=True)
    with torch.enable_grad():
        (slope,) = torch.autograd.grad(surface.grid.distance(at).sum(), at)
    normal, slope = surface.grid.normals(at.detach()).to(points), slope.to(points)
    moved = points - points.detach()
    free = (place == points.detach()).all(1, keepdim=True)
    along = (moved * slope).sum(1, keepdim=True) / (normal * slope).sum(1, keepdim=True)
    return place + torch.where(free, moved, moved - along * normal)
