"""Channel order of positional encodings: from that of released networks to ours."""

import numpy as np
import torch

from objectfolder.nets.positional import SKIP
from objectfolder.released.checkpoint import ReleasedDict

DEPTH = 8  #: default number of hidden layers


def by_octave(inputs: int, octaves: int) -> np.ndarray:
    """Return the channels of the released encoding in the order of `objectfolder.nets.positional.encoded`.

    Released: all numbers, then for each octave all sines and all cosines. Ours: all numbers, then all sines,
    then all cosines, each ordered by number.
    """
    number, octave = np.mgrid[:inputs, :octaves].reshape(2, -1)
    sine = inputs * (1 + 2 * octave) + number
    return np.concatenate([np.arange(inputs), sine, sine + inputs])


def by_number(inputs: int, octaves: int) -> np.ndarray:
    """Return the same for KiloOSF, which stores each number, its cosines and then its sines."""
    number, octave = np.mgrid[:inputs, :octaves].reshape(2, -1)
    size = 1 + 2 * octaves
    cosine = number * size + 1 + octave
    return np.concatenate([np.arange(inputs) * size, cosine + octaves, cosine])


def octaves_of(state: ReleasedDict, key: str, channels: int, inputs: int) -> int:
    """Return the octaves of an encoding with ``channels`` channels of ``inputs`` numbers."""
    octaves, rest = divmod(channels // inputs - 1, 2)
    if channels % inputs or rest or octaves < 0:
        raise state.wrong(
            key, f"for {channels} channels", f"{inputs} times an odd number: an encoding of {inputs} numbers"
        )
    return octaves


def trunk(
    state: ReleasedDict, inputs: int, prefix: str, refeed: bool = True, depth: int = DEPTH
) -> tuple[dict[str, torch.Tensor], int]:
    """Read the layers ``pts_linears.N`` as those of a `SkipNetwork`.

    Parameters
    ----------
    inputs : int
        Numbers before encoding.
    prefix : str
        Prefix of the returned names.
    refeed : bool
        Whether the input is concatenated again after the layer of index 4.
    depth : int
        Number of layers.

    Returns
    -------
    tensors : dict
    octaves : int
    """
    first = state.tensor("pts_linears.0.weight", None, None)
    width, channels = first.shape
    octaves = octaves_of(state, "pts_linears.0.weight", channels, inputs)
    order = by_octave(inputs, octaves)
    tensors = {}
    for i in range(depth):
        joined = channels if i == SKIP + 1 and refeed else 0
        size = width + joined if i else channels
        weight = state.tensor(f"pts_linears.{i}.weight", width, size)
        if i == 0 or joined:
            weight = torch.cat([weight[:, :channels][:, order], weight[:, channels:]], 1)
        elif i == SKIP + 1:  # ours always concatenates the input: weights of zero ignore it
            weight = torch.cat([weight.new_zeros(width, channels), weight], 1)
        tensors[f"{prefix}hidden.{i}.weight"] = weight
        tensors[f"{prefix}hidden.{i}.bias"] = state.tensor(f"pts_linears.{i}.bias", width)
    return tensors, octaves


def network(state: ReleasedDict, inputs: int, outputs: int, prefix: str = "") -> dict[str, torch.Tensor]:
    """Read ``pts_linears`` and ``output_linear`` as a `ReleasedNetwork`; the view layer is unused."""
    tensors, _ = trunk(state, inputs, prefix)
    width = len(tensors[f"{prefix}hidden.0.weight"])
    tensors[f"{prefix}output.weight"] = state.tensor("output_linear.weight", outputs, width)
    tensors[f"{prefix}output.bias"] = state.tensor("output_linear.bias", outputs)
    return tensors
