"""Optimizers of small nets: Adam, and SOAP."""

from typing import Any

import torch
from torch import nn
from torch.optim.adam import adam

DECAY, EPSILON = 0.95, 1e-8  # of SOAP's running means, and added to their roots
REFRESH = 10  # steps between updates of SOAP's eigenbases
LARGEST = 256  # dimensions larger than this are not preconditioned by SOAP
#: No variant of Adam.
_PLAIN: dict[str, Any] = {"fused": True, "amsgrad": False, "weight_decay": 0, "maximize": False}


class Optimizer:
    """Groups of parameters, and what is kept of each between steps.

    A group holds ``params`` and their learning rate ``lr``, which may be set before each step.
    """

    def __init__(self, groups: list[dict[str, Any]]):
        self.param_groups = groups
        self.state: dict[torch.Tensor, dict[str, Any]] = {}

    def step(self) -> None:
        """Update every parameter that has a gradient."""
        raise NotImplementedError

    def state_dict(self) -> dict[int, dict[str, Any]]:
        """Return what is kept, by the number of the parameter."""
        return {i: self.state[p] for i, p in enumerate(self._parameters()) if p in self.state}

    def load_state_dict(self, stored: dict[int, dict[str, Any]]) -> None:
        """Continue with what `state_dict` returned."""
        parameters = self._parameters()
        self.state = {
            parameters[i]: {
                name: value.to(parameters[i].device) if isinstance(value, torch.Tensor) else value
                for name, value in kept.items()
            }
            for i, kept in stored.items()
        }

    def _parameters(self) -> list[torch.Tensor]:
        return [parameter for group in self.param_groups for parameter in group["params"]]


class Adam(Optimizer):
    """PyTorch's Adam (Kingma and Ba 2015, arXiv:1412.6980), to the same bits, without its class.

    The constructor of ``torch.optim.Adam`` imports PyTorch's compiler. The training of a default VisionNet,
    13.3 s and 785 MB, would take another 1.3 s and 70 MB with it.
    """

    def __init__(self, groups: list[dict[str, Any]], betas: tuple[float, float], eps: float):
        super().__init__(groups)
        self.betas, self.eps = betas, eps

    @torch.no_grad()
    def step(self) -> None:
        """Update every parameter that has a gradient."""
        for group in self.param_groups:
            moving = [parameter for parameter in group["params"] if parameter.grad is not None]
            for parameter in moving:
                if parameter not in self.state:
                    zeros = torch.zeros_like(parameter)
                    count = torch.zeros((), dtype=torch.float32, device=parameter.device)
                    self.state[parameter] = {"mean": zeros, "square": zeros.clone(), "count": count}
            if not moving:
                continue
            means, squares, counts = (
                [self.state[parameter][name] for parameter in moving] for name in ("mean", "square", "count")
            )
            beta1, beta2 = self.betas
            gradients = [parameter.grad for parameter in moving]
            rates: dict[str, Any] = {"lr": group["lr"], "beta1": beta1, "beta2": beta2, "eps": self.eps}
            adam(moving, gradients, means, squares, [], counts, **rates, **_PLAIN)


def make_default_adam(net: nn.Module) -> Adam:
    """Return Adam for a net of ours; a larger epsilon would freeze hash-table entries of tiny gradients."""
    return Adam([{"params": list(net.parameters())}], (0.9, 0.99), 1e-12)


def make_papers_adam(net: nn.Module) -> Adam:
    """Return Adam for a net of the paper, with the constants that supplementary E states."""
    return Adam([{"params": list(net.parameters())}], (0.9, 0.999), 1e-7)


class Soap(Optimizer):
    """SOAP: Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2024, arXiv:2409.11321).

    For vectors and matrices of small dense nets: Adam's loss in about half the steps, each a third slower.
    """

    @torch.no_grad()
    def step(self) -> None:
        """Update every parameter that has a gradient."""
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    gradient = parameter.grad.view(len(parameter), -1)
                    self._update(parameter, gradient, group["lr"])

    def _update(self, parameter: torch.Tensor, gradient: torch.Tensor, rate: float) -> None:
        state = self.state.setdefault(parameter, {})
        if not state:
            outer = [_outer(gradient, side) for side in (0, 1)]
            bases = [None if o is None else torch.linalg.eigh(o)[1].flip(1) for o in outer]
            zeros = torch.zeros_like(gradient)
            state.update(step=0, mean=zeros, square=zeros.clone(), outer=outer, bases=bases)
        state["step"] += 1
        left, right = state["bases"]
        state["mean"].lerp_(gradient, 1 - DECAY)
        state["square"].lerp_(_rotate(gradient, left, right).square(), 1 - DECAY)
        bias = 1 - DECAY ** state["step"]
        mean = _rotate(state["mean"], left, right) / bias
        step = mean / ((state["square"] / bias).sqrt() + EPSILON)
        step = _rotate(step, *(None if b is None else b.T for b in (left, right)))
        parameter.sub_(rate * step.view_as(parameter))
        for side, outer in enumerate(state["outer"]):
            if outer is None:
                continue
            outer.lerp_(_outer(gradient, side), 1 - DECAY)
            if state["step"] % REFRESH == 0:
                # One power iteration; the second moments are reordered with the eigenvectors.
                basis = state["bases"][side]
                order = (basis * (outer @ basis)).sum(0).argsort(descending=True)
                state["square"] = state["square"].index_select(side, order)
                state["bases"][side] = torch.linalg.qr(outer @ basis[:, order])[0]


def _outer(gradient: torch.Tensor, side: int) -> torch.Tensor | None:
    if gradient.shape[1] == 1 or gradient.shape[side] > LARGEST:
        return None
    return gradient @ gradient.T if side == 0 else gradient.T @ gradient


def _rotate(matrix: torch.Tensor, left: torch.Tensor | None, right: torch.Tensor | None) -> torch.Tensor:
    """Rotate a matrix into the eigenbases."""
    if left is not None:
        matrix = left.T @ matrix
    return matrix if right is None else matrix @ right
