"""Checkpoints of a training: a run that was killed continues, and ends with the bytes of one that was not."""

import hashlib
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from objectfolder.errors import ObjectFolderError
from objectfolder.io import file_digest, read_safetensors, write_safetensors

INTERVAL = 60.0  #: wall seconds between two checkpoints


def identity(settings: object, seed: int, files: Iterable[Path]) -> str:
    """Return the digest of all that a training depends on: settings, seed, files that exist, and PyTorch."""
    digests = [file_digest(path) for path in files if path.is_file()]
    return hashlib.sha256(repr((settings, seed, digests, torch.__version__)).encode()).hexdigest()


@dataclass
class Checkpoint:
    """A file that holds the state of an unfinished training.

    Parameters
    ----------
    path : Path
    identity : str
        See `identity`. A file of another identity is ignored and replaced.
    generator : torch.Generator
        From which the training draws; its state is stored, too.
    interval : float
        Wall seconds between two writes.
    """

    path: Path
    identity: str
    generator: torch.Generator
    interval: float = INTERVAL
    _written: float = field(default_factory=time.monotonic, init=False)

    def load(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]] | None:
        """Return stored tensors and numbers, and restore the generator; None without any."""
        try:
            arrays, header = read_safetensors(self.path)
        except ObjectFolderError:  # none yet, or damaged
            return None
        if header.get("identity") != self.identity:
            return None
        tensors = {name: torch.from_numpy(np.array(value)) for name, value in arrays.items()}
        self.generator.set_state(tensors.pop("generator"))
        return tensors, header["numbers"]

    def due(self) -> bool:
        """Whether the last write is an interval ago."""
        return time.monotonic() - self._written >= self.interval

    def save(self, tensors: dict[str, torch.Tensor], numbers: dict[str, Any]) -> None:
        """Write the state of a training; the file is complete or the earlier one."""
        arrays = {name: value.cpu().numpy() for name, value in tensors.items()}
        arrays["generator"] = self.generator.get_state().numpy()
        write_safetensors(self.path, arrays, {"identity": self.identity, "numbers": numbers})
        self._written = time.monotonic()
