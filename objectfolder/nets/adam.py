"""Adam (Kingma and Ba 2015, arXiv:1412.6980)."""

from typing import Any

import torch
from torch import nn
from torch.optim.adam import adam

_KEPT = ("mean", "square", "count")


class Adam:
    """PyTorch's Adam without its class, whose constructor imports PyTorch's compiler: a second and 75 MB.

    Parameters
    ----------
    groups : list of dict
        ``params``: parameters; ``lr``: their learning rate, which may be set before each step.
    betas : (float, float)
        Decay rates of the running means of gradients and of their squares.
    eps : float
    """

    def __init__(self, groups: list[dict[str, Any]], betas: tuple[float, float], eps: float):
        self.param_groups, self.betas, self.eps = groups, betas, eps
        self.state: dict[torch.Tensor, tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = {}

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the running means, by the number of the parameter."""
        kept = [self.state.get(p, ()) for group in self.param_groups for p in group["params"]]
        return {f"{i}.{name}": t for i, of in enumerate(kept) for name, t in zip(_KEPT, of)}

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Continue with the running means that `tensors` returned."""
        for i, p in enumerate(p for group in self.param_groups for p in group["params"]):
            if f"{i}.{_KEPT[0]}" in tensors:
                mean, square, count = (tensors[f"{i}.{name}"].to(p.device) for name in _KEPT)
                self.state[p] = mean, square, count

    @torch.no_grad()
    def step(self) -> None:
        """Update every parameter that has a gradient."""
        for group in self.param_groups:
            moving = [parameter for parameter in group["params"] if parameter.grad is not None]
            for parameter in moving:
                if parameter not in self.state:
                    zeros = torch.zeros_like(parameter)
                    count = torch.zeros((), dtype=torch.float32, device=parameter.device)
                    self.state[parameter] = zeros, zeros.clone(), count
            if not moving:
                continue
            means, squares, counts = (list(kept) for kept in zip(*(self.state[p] for p in moving)))
            adam(
                moving,
                [parameter.grad for parameter in moving],
                means,
                squares,
                [],
                counts,
                fused=True,
                amsgrad=False,
                beta1=self.betas[0],
                beta2=self.betas[1],
                lr=group["lr"],
                weight_decay=0,
                eps=self.eps,
                maximize=False,
            )


def papers_adam(net: nn.Module) -> Adam:
    """Return Adam for a net of the paper, with the constants that supplementary E states."""
    return Adam([{"params": list(net.parameters())}], (0.9, 0.999), 1e-7)
