"""Readers of the AudioNets of released files."""

import numpy as np
import torch

from objectfolder.nets.released.gains import ReleasedGains
from objectfolder.nets.released.network import Frame, build_network
from objectfolder.nets.released.spectrogram import AXES, NEIGHBOURS, ReleasedSpectrogram
from objectfolder.released.checkpoint import ReleasedDict
from objectfolder.released.encoding import network

MAX_MODES = 1 << 16


def spectrogram_net(audio: ReleasedDict, frame: Frame) -> ReleasedSpectrogram:
    """Read an AudioNet of ObjectFolder 1.0.

    Raises
    ------
    ObjectFolderError
        If an entry is missing or not as documented.
    """
    vertices = audio.numbers("voxel_vertex", None, 3)
    if len(vertices) < NEIGHBOURS or np.ptp(vertices) == 0:
        raise audio.wrong("voxel_vertex", f"{len(vertices)} vertices", f"{NEIGHBOURS} or more, not all equal")
    normalizer = audio.part("normalizer")
    values = [_range(normalizer, axis) for axis in range(1, 4)]
    state = audio.state("model_state_dict")
    branches = []
    for axis in AXES:
        tensors = network(state.below(f"model_{axis}."), 5, 2)
        branches.append(build_network(tensors, 5))
    config = {
        "frame": frame.to_dict(),
        "translation": audio.numbers("translation", 3).tolist(),
        "scale": audio.number("scale"),
        "coordinates": [float(vertices.min()), float(vertices.max())],
        "values": values,
    }
    return ReleasedSpectrogram(branches, vertices, config)


def gains_net(audio: ReleasedDict, frame: Frame) -> ReleasedGains:
    """Read an AudioNet of ObjectFolder 2.0.

    Raises
    ------
    ObjectFolderError
        If an entry is missing or not as documented.
    """
    frequencies = audio.numbers("frequencies", None)
    count = len(frequencies)
    dampings = audio.numbers("dampings", count)
    if not 0 < count <= MAX_MODES or frequencies.min() < 0:
        raise audio.wrong("frequencies", f"{count} numbers, not all positive", "frequencies in Hz")
    normalizer = audio.part("normalizer")
    low, high = (
        torch.from_numpy(np.stack([normalizer.numbers_or_one(f"f{i}_{end}", count) for i in (1, 2, 3)]))
        for end in ("min", "max")
    )
    state = audio.state("model_state_dict")
    heard = torch.from_numpy(frequencies > 0)  # sin(2 pi 0 t) is silent
    branches = []
    for axis in AXES:
        tensors = network(state.below(f"model_{axis}."), 3, count)
        for name in ("output.weight", "output.bias"):
            tensors[name] = tensors[name][heard]
        branches.append(build_network(tensors, 3))
    config = {"frame": frame.to_dict(), "bounds": box(normalizer)}
    modes = (torch.from_numpy(frequencies), torch.from_numpy(dampings), low, high)
    return ReleasedGains(branches, config, *(x.float()[..., heard] for x in modes))


def box(part: ReleasedDict) -> list[list[float]]:
    """Return the bounds ``xyz_min`` and ``xyz_max``, each stored as three numbers or as one for all axes."""
    low, high = (part.numbers_or_one(f"xyz_{end}", 3) for end in ("min", "max"))
    if not (low < high).all():
        raise part.wrong("xyz_min", f"{low.tolist()}", f"numbers below xyz_max, {high.tolist()}")
    return [low.tolist(), high.tolist()]


def _range(normalizer: ReleasedDict, axis: int) -> list[float]:
    low, high = (normalizer.number(f"f{axis}_{end}") for end in ("min", "max"))
    return [low, high]
