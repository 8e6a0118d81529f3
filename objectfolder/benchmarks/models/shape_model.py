"""Trained reconstructors with their configuration, and their file format."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from objectfolder.base.arrays import read_safetensors, write_safetensors
from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.occupancy import extract_mesh, grid_points
from objectfolder.benchmarks.models.encoders import Weights, make_encoder
from objectfolder.benchmarks.models.framing import frame_views
from objectfolder.benchmarks.models.inputs import encoder_inputs
from objectfolder.benchmarks.models.occupancy_net import Reconstructor, SeveralTouches, occupancy_logits
from objectfolder.benchmarks.models.settings import InputSizes

FORMAT = "objectfolder reconstruction 2"
ROWS = 64  # observations encoded at once


@dataclass(frozen=True)
class Setup:
    """Configuration of a reconstructor; the header of its file."""

    modalities: tuple[str, ...]  #: inputs, in this order: "vision", "audio", both, or "touch"
    encoder: str  #: a name of `objectfolder.benchmarks.models.encoders`
    sizes: InputSizes
    view: int  #: side of the views before cropping, pixels
    width: int  #: of the decoder
    blocks: int
    frequencies: int
    resolution: int  #: nodes along a side for marching cubes
    keys: tuple[str, ...]  #: training objects
    threshold: float = 0.5  #: occupancy above which a point is inside


@dataclass(frozen=True)
class ShapeModel:
    """A reconstructor in evaluation mode."""

    setup: Setup
    net: Reconstructor

    @property
    def level(self) -> float:
        """Logit of the threshold."""
        return math.log(self.setup.threshold / (1 - self.setup.threshold))

    @torch.no_grad()
    def embed(self, observations: Mapping[str, np.ndarray]) -> torch.Tensor:
        """Embed the shapes of B observations of each modality; (B, 256) float32.

        They are from `Observations.read`; of touches (B, K, h, w, 3), K are of each object.
        """
        device, (first, *_) = next(self.net.parameters()).device, self.setup.modalities

        def inputs(name: str, rows: slice) -> torch.Tensor:
            return shape_inputs(name, observations[name][rows], self.setup.sizes, device=device)

        parts = [slice(start, start + ROWS) for start in range(0, len(observations[first]), ROWS)]
        return torch.cat(
            [self.net.embed({name: inputs(name, rows) for name in self.setup.modalities}) for rows in parts]
        )

    def logits(self, embedding: torch.Tensor, points: np.ndarray) -> np.ndarray:
        """Return the occupancy logits (B, P) of points (P, 3), unit frame, for each of B shapes."""
        places = torch.from_numpy(points).to(embedding.device)
        return occupancy_logits(self.net.decoder, embedding, places).cpu().numpy()

    def is_inside(self, embedding: torch.Tensor, points: np.ndarray) -> np.ndarray:
        """Return whether points (P, 3), unit frame, are inside each of B shapes; (B, P) bool."""
        return self.logits(embedding, points) > self.level

    def mesh(self, embedding: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
        """Extract vertices (V, 3), unit frame, and faces (F, 3) of the shape of an embedding (256,)."""
        side = self.setup.resolution
        values = self.logits(embedding[None], self._grid)[0]
        return extract_mesh(values.reshape(side, side, side), self.level)

    @cached_property
    def _grid(self) -> np.ndarray:
        return grid_points(self.setup.resolution)


def shape_inputs(
    modality: str,
    raw: np.ndarray,
    sizes: InputSizes,
    rng: np.random.Generator | None = None,
    device: str | torch.device = "cpu",
) -> torch.Tensor:
    """Make a reconstructor's inputs: as `encoder_inputs`, with views framed, and several touches a row."""
    if modality == "touch":
        inputs = encoder_inputs(modality, raw.reshape(-1, *raw.shape[2:]), sizes, rng, device)
        return inputs.unflatten(0, raw.shape[:2])
    return encoder_inputs(modality, frame_views(raw) if modality == "vision" else raw, sizes, rng, device)


def new_net(setup: Setup, weights: Weights | None = None) -> Reconstructor:
    """Make an untrained net, initialized from torch's global generator or, for encoders, given weights."""
    encoders = {name: make_encoder(setup.encoder, name, weights) for name in setup.modalities}
    if "touch" in encoders:
        encoders["touch"] = SeveralTouches(encoders["touch"], setup.sizes.touch)
    return Reconstructor(encoders, setup.width, setup.blocks, setup.frequencies)


def save_model(path: str | Path, model: ShapeModel) -> None:
    """Write a model as a safetensors file with its setup as the header."""
    tensors = {name: value.detach().cpu().numpy() for name, value in model.net.state_dict().items()}
    write_safetensors(path, tensors, {"format": FORMAT, **asdict(model.setup)})


def load_model(path: str | Path, device: str | torch.device = "cpu") -> ShapeModel:
    """Read a model written by `save_model`; nothing in the file is executed.

    Raises ObjectFolderError if the file is missing, damaged, or no model file.
    """
    tensors, header = read_safetensors(path)
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ObjectFolderError(
            f"{path} holds no reconstruction model of this version; train one with `objectfolder bench "
            "reconstruct`"
        )
    try:
        setup = _setup(header)
        net = new_net(setup)
        expected = net.state_dict()
        if expected.keys() != tensors.keys():
            wrong = sorted(expected.keys() ^ tensors.keys())
            raise ValueError(f"{len(wrong)} tensors are missing or too many, such as {wrong[0]}")
        # Scalars are stored as arrays of one element.
        net.load_state_dict(
            {name: torch.from_numpy(value.reshape(expected[name].shape)) for name, value in tensors.items()}
        )
        broken = [name for name, value in net.state_dict().items() if not value.isfinite().all()]
        if broken:
            raise ValueError(f"{broken[0]} is not finite")
    except ObjectFolderError as error:
        raise ObjectFolderError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ObjectFolderError(f"{path} is damaged ({error}); train the model again") from error
    return ShapeModel(setup, net.to(device).eval())


def _setup(header: Mapping[str, Any]) -> Setup:
    values = {name: value for name, value in header.items() if name != "format"}
    sizes = values["sizes"]
    values["sizes"] = InputSizes(int(sizes["image"]), tuple(sizes["spectrogram"]), tuple(sizes["touch"]))
    setup = Setup(**values | {name: tuple(values[name]) for name in ("modalities", "keys")})
    positive = (setup.view, setup.width, setup.blocks, setup.sizes.image)
    if min(positive) < 1 or setup.resolution < 2 or setup.frequencies < 0 or not 0 < setup.threshold < 1:
        raise ValueError("its sizes are out of range")
    return setup
