"""Trained policies as plain arrays, in files without pickle."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from objectfolder.base.arrays import open_safetensors, write_safetensors
from objectfolder.base.errors import ObjectFolderError

FORMAT = "objectfolder actor 1"
CLIP = 10.0  #: standard deviations to which normalized observations are clipped


@dataclass(frozen=True)
class Actor:
    """Mean action of a Gaussian policy: normalization, layers with tanh between them, clipping to [-1, 1].

    Mean and deviation (n,) float64 are those of the training observations. Each layer is a weight (out, in)
    and a bias (out,), float32.
    """

    mean: np.ndarray
    deviation: np.ndarray
    layers: Sequence[tuple[np.ndarray, np.ndarray]]

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Map observations (..., n) to actions (..., m), float32."""
        x = np.clip((observation - self.mean) / self.deviation, -CLIP, CLIP).astype(np.float32)
        *hidden, (weight, bias) = self.layers
        for inner, shift in hidden:
            x = np.tanh(x @ inner.T + shift)
        return np.clip(x @ weight.T + bias, -1, 1)

    def tensors(self) -> dict[str, np.ndarray]:
        """Return all arrays by name."""
        named = {"mean": self.mean, "deviation": self.deviation}
        for i, (weight, bias) in enumerate(self.layers):
            named |= {f"layers.{i}.weight": weight, f"layers.{i}.bias": bias}
        return named

    @classmethod
    def of(cls, tensors: Mapping[str, np.ndarray]) -> "Actor":
        """Make an actor from its `tensors`."""
        count = sum(name.endswith(".weight") for name in tensors)
        layers = [(tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"]) for i in range(count)]
        return cls(tensors["mean"], tensors["deviation"], layers)

    def save(self, path: str | Path, task: str) -> None:
        """Write a safetensors file; its header names the task."""
        write_safetensors(path, self.tensors(), {"format": FORMAT, "task": task})

    @classmethod
    def load(cls, path: str | Path) -> "Actor":
        """Read a file written by `save`; ObjectFolderError if it is no policy file."""
        tensors, header = open_safetensors(path)
        if header.get("format") != FORMAT:
            raise ObjectFolderError(
                f"{path} is not a trained policy ({FORMAT}); train one: objectfolder bench reach"
            )
        return cls.of(tensors)
