"""AudioNet of a released ObjectFolder 1.0 file: spectrograms at the vertices of a voxel grid."""

import math
from typing import Any

import numpy as np
import torch

from objectfolder.nets.released_network import (
    Frame,
    ReleasedNetwork,
    build_network,
    float_tensors,
    stored_tensors,
)
from objectfolder.sound.spectrogram import SHAPE

AXES = ("x", "y", "z")
GRID = 32  # voxels along an axis
NEIGHBOURS = 4  # vertices whose answers are summed for a point
_CHUNK = 4096  # bins evaluated at once: their activations stay in the cache


class ReleasedSpectrogram:
    """Net from surface points to spectrograms of unit forces along x, y and z.

    A point p is mapped to the voxel grid by ((p + translation) * scale) * 32; the answers at its four nearest
    ``vertices`` (V, 3), in voxels, are summed, as in the original. The three branches are nets from (x, y, z,
    frequency, time) to real and imaginary part, one per axis.

    ``config`` holds ``frame``; ``translation`` (3) and ``scale``; ``coordinates`` (low, high), the voxel
    coordinates that inputs 0 and 1 represent; ``values`` (3, 2), what outputs 0 and 1 of each branch
    represent. The original normalises by the extremes of the queried vertices, so that an answer depends on
    the other points of the query; here ``coordinates`` is fixed.
    """

    damped_frequency = torch.zeros(0, dtype=torch.float64, device="cpu")  #: no modes are known

    def __init__(self, branches: list[ReleasedNetwork], vertices: np.ndarray, config: dict[str, Any]):
        from scipy.spatial import KDTree  # imported here: takes half a second, and other kinds do not need it

        self.branches = branches
        self.vertices = np.asarray(vertices, np.float64)
        self.config = config
        self.frame = Frame.from_dict(config["frame"])
        self._translation = np.array(config["translation"], np.float64).reshape(3)
        self._scale = float(config["scale"])
        self._low, self._high = map(float, config["coordinates"])
        self._values = torch.from_numpy(np.array(config["values"], np.float64).reshape(3, 2))
        finite = np.isfinite([*self._translation, self._scale, *self._values.flatten().tolist()]).all()
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3 or len(self.vertices) < NEIGHBOURS:
            raise ValueError(
                f"voxel vertices of shape {self.vertices.shape}, expected (at least {NEIGHBOURS}, 3)"
            )
        if not finite or not -math.inf < self._low < self._high < math.inf:
            raise ValueError(f"coordinates {config['coordinates']} not ascending, or values not finite")
        if [len(branch.output.weight) for branch in branches] != [2, 2, 2]:
            raise ValueError("branches without two outputs each, the real and the imaginary part")
        self._tree = KDTree(self.vertices)
        frequency, time = (np.arange(n) / (n - 1) for n in SHAPE)
        bins = np.stack(np.meshgrid(frequency, time, indexing="ij"), -1).reshape(-1, 2)
        self._bins = torch.from_numpy(bins.astype(np.float32))

    def to(self, device: str | torch.device) -> "ReleasedSpectrogram":
        """Move to a device and return self."""
        self.branches = [branch.to(device) for branch in self.branches]
        self._bins, self._values = self._bins.to(device), self._values.to(device)
        return self

    @torch.no_grad()
    def spectrograms(self, points: torch.Tensor) -> torch.Tensor:
        """Evaluate complex spectrograms at (N, 3) points of the unit frame; (N, 3, 257, 201)."""
        out = torch.empty(len(points), 3, *SHAPE, dtype=torch.complex64, device=self._bins.device)
        place = (self.frame.released(points.cpu()) + self._translation) * self._scale * GRID
        for image, index in zip(out, self._tree.query(place, NEIGHBOURS)[1]):
            near = (self.vertices[index] - self._low) / (self._high - self._low)
            answers = [self._answers(vertex) for vertex in torch.from_numpy(near).float().to(self._bins)]
            image[:] = torch.view_as_complex(torch.stack(answers).sum(0)).view(3, *SHAPE)
        return out

    def _answers(self, vertex: torch.Tensor) -> torch.Tensor:
        """Evaluate the real and imaginary parts of all bins at one vertex; (3, bins, 2) float64."""
        parts = []
        for bins in self._bins.split(_CHUNK):
            x = torch.cat([vertex.expand(len(bins), 3), bins], 1)
            parts.append(torch.stack([branch(x) for branch in self.branches]))
        low, high = self._values[:, None, None].unbind(-1)
        return torch.cat(parts, 1).double() * (high - low) + low

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors and configuration for storing."""
        tensors = {"voxel_vertex": self.vertices.astype(np.float32)}
        for axis, branch in zip(AXES, self.branches):
            tensors |= stored_tensors(branch, f"{axis}.")
        return tensors, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "ReleasedSpectrogram":
        """Invert `to_tensors`."""
        state = float_tensors(tensors)
        vertices = state.pop("voxel_vertex").numpy()
        return cls([build_network(state, 5, f"{axis}.") for axis in AXES], vertices, dict(config))
