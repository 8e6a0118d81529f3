"""Loading of nets from stored tensors."""

from typing import TypeVar

import torch
from torch import nn

_Net = TypeVar("_Net", bound=nn.Module)

#: Nets are made here to be `filled`: a wrong size allocates nothing before it is compared with the tensors.
UNFILLED = torch.device("meta")


def filled(net: _Net, state: dict[str, torch.Tensor]) -> _Net:
    """Give a net made on device `UNFILLED` its tensors, and return it for evaluation.

    Parameters become single precision on the CPU, whatever the default type and device of torch are.

    Parameters
    ----------
    net : Module
        Its buffers have explicit types; those outside its state dictionary are on the CPU.
    state : dict
        Its state dictionary.

    Raises
    ------
    RuntimeError
        If the tensors are not those of the net, or of other shapes.
    """
    types = {name: buffer.dtype for name, buffer in net.named_buffers()}
    typed = {name: value.to(types.get(name, torch.float32)) for name, value in state.items()}
    net.load_state_dict(typed, assign=True)
    return net.eval()
