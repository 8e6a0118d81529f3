"""Adam (Kingma and Ba 2015, arXiv:1412.6980)."""

from typing import Any

import torch
from torch.optim.adam import adam


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
