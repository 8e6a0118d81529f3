"""Occupancy Networks (Mescheder et al. 2019) conditioned on what was sensed (supplementary I.3)."""

import math
from collections.abc import Mapping
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import nn

from objectfolder.benchmarks.models.inputs import Ground

EMBEDDING = 256  #: size of shape embeddings


class ConditionalBatchNorm(nn.Module):
    """Batch normalization over all points of a batch, with scale and shift predicted from the embedding.

    Initially the scale is 1 and the shift 0.
    """

    def __init__(self, embedding: int, width: int):
        super().__init__()
        self.gamma, self.beta = nn.Linear(embedding, width), nn.Linear(embedding, width)
        for layer, value in ((self.gamma, 1.0), (self.beta, 0.0)):
            nn.init.zeros_(layer.weight)
            nn.init.constant_(layer.bias, value)
        self.norm = nn.BatchNorm1d(width, affine=False)

    def forward(self, points: torch.Tensor, embedding: torch.Tensor) -> torch.Tensor:
        """Normalize (B, P, width) points of objects with (B, embedding) embeddings."""
        if self.training:
            gamma, beta = self.gamma(embedding)[:, None], self.beta(embedding)[:, None]
            return torch.addcmul(beta, gamma, self.norm(points.flatten(0, 1)).view_as(points))
        # One pass over the points instead of two.
        scale, shift = self.folded(embedding[:, None])
        return torch.addcmul(shift, scale, points)

    def folded(self, embedding: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return scale and shift in evaluation, (..., embedding) -> (..., width) each.

        They hold the running statistics, too.
        """
        mean, variance = self.norm.running_mean, self.norm.running_var
        assert mean is not None
        assert variance is not None
        scale = self.gamma(embedding) * torch.rsqrt(variance + self.norm.eps)
        return scale, self.beta(embedding) - scale * mean


class ConditionalBlock(nn.Module):
    """Residual block of two fully connected layers, each preceded by `ConditionalBatchNorm` and ReLU.

    The second layer is initialized to 0, so that the block is initially the identity.
    """

    def __init__(self, embedding: int, width: int):
        super().__init__()
        self.norm1, self.norm2 = (ConditionalBatchNorm(embedding, width) for _ in range(2))
        self.layer1, self.layer2 = (nn.Linear(width, width) for _ in range(2))
        nn.init.zeros_(self.layer2.weight)

    def forward(self, points: torch.Tensor, embedding: torch.Tensor) -> torch.Tensor:
        """Transform (B, P, width) points."""
        hidden = self.layer1(F.relu(self.norm1(points, embedding)))
        return points + self.layer2(F.relu(self.norm2(hidden, embedding)))


class OccupancyDecoder(nn.Module):
    """Predict occupancy logits of points from the embedding of a shape.

    ``width`` is the size of point features, ``frequencies`` the octaves of sines and cosines of the
    coordinates. The paper uses none and hundreds of thousands of steps; with a few, thin walls are learned in
    hundreds.
    """

    def __init__(self, width: int = 256, blocks: int = 5, frequencies: int = 0, embedding: int = EMBEDDING):
        super().__init__()
        self.frequencies = frequencies
        self.first = nn.Linear(3 + 6 * frequencies, width)
        self.blocks = nn.ModuleList(ConditionalBlock(embedding, width) for _ in range(blocks))
        self.norm = ConditionalBatchNorm(embedding, width)
        self.last = nn.Linear(width, 1)

    def forward(self, points: torch.Tensor, embedding: torch.Tensor) -> torch.Tensor:
        """Logits (B, P) of (B, P, 3) points of objects described by a (B, embedding) tensor."""
        hidden = self.start(points)
        for block in self.blocks:
            hidden = block(hidden, embedding)
        return self.last(F.relu(self.norm(hidden, embedding)))[..., 0]

    def one_shape(self, embedding: torch.Tensor) -> "OneShape":
        """Return the decoder, in evaluation, for one embedding (embedding,)."""
        return OneShape(self, embedding)

    def start(self, points: torch.Tensor) -> torch.Tensor:
        """Return what enters the first block, (..., 3) -> (..., width)."""
        angles = [points * (math.pi * 2**octave) for octave in range(self.frequencies)]
        return self.first(torch.cat([points, *map(torch.sin, angles), *map(torch.cos, angles)], -1))


class OneShape:
    """A decoder in evaluation for the embedding (embedding,) of one shape.

    Equals the decoder, but reads the points less often: normalizations are scales and shifts, the second one
    of a block part of the layer before.
    """

    def __init__(self, decoder: OccupancyDecoder, embedding: torch.Tensor):
        self._decoder, self._norm = decoder, decoder.norm.folded(embedding)
        self._blocks = []
        for block in cast(list[ConditionalBlock], decoder.blocks):
            scale, shift = block.norm2.folded(embedding)
            weight, bias = block.layer1.weight * scale[:, None], block.layer1.bias * scale + shift
            self._blocks.append((block.norm1.folded(embedding), weight, bias, block.layer2))

    def __call__(self, points: torch.Tensor) -> torch.Tensor:
        """Logits (P,) of (P, 3) points."""
        hidden = self._decoder.start(points)
        for (scale, shift), weight, bias, layer2 in self._blocks:
            inner = F.linear(torch.addcmul(shift, scale, hidden).relu_(), weight, bias).relu_()
            hidden.add_(layer2.bias).addmm_(inner, layer2.weight.T)
        scale, shift = self._norm
        return self._decoder.last(torch.addcmul(shift, scale, hidden).relu_())[..., 0]


class SeveralTouches(nn.Module):
    """Encode several touches of an object by the mean of their features; where they are is not told.

    The encoder is that of one touch, with an attribute ``features``; ``size`` is height and width of its
    inputs.
    """

    def __init__(self, encoder: nn.Module, size: tuple[int, int]):
        super().__init__()
        self.encoder = encoder
        self.features = int(cast(Any, encoder).features)
        self.median: torch.Tensor
        self.deviation: torch.Tensor
        self.register_buffer("median", torch.zeros(3, *size))
        self.register_buffer("deviation", torch.ones(()))

    def set_ground(self, ground: Ground) -> None:
        """Subtract what touches have in common from all inputs."""
        self.median.copy_(ground.median)
        self.deviation.copy_(ground.deviation)

    def forward(self, touches: torch.Tensor) -> torch.Tensor:
        """Encode (B, K, 3, H, W) inputs; (B, features)."""
        inputs = Ground(self.median, self.deviation).subtracted(touches.flatten(0, 1))
        encoded: torch.Tensor = self.encoder(inputs)
        return encoded.unflatten(0, touches.shape[:2]).mean(1)


class Reconstructor(nn.Module):
    """IMAGE2MESH and its like: encoders, two fully-connected layers, an occupancy decoder.

    Encoders are by modality, in the order of concatenation; each has an attribute ``features``.
    """

    def __init__(
        self, encoders: Mapping[str, nn.Module], width: int = 256, blocks: int = 5, frequencies: int = 0
    ):
        super().__init__()
        self.encoders = nn.ModuleDict(dict(encoders))
        features = sum(int(cast(Any, encoder).features) for encoder in encoders.values())
        self.fusion = nn.Sequential(
            nn.Linear(features, EMBEDDING), nn.ReLU(), nn.Linear(EMBEDDING, EMBEDDING)
        )
        self.decoder = OccupancyDecoder(width, blocks, frequencies)

    def features(self, inputs: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Encode a batch of inputs of the same objects; (B, features)."""
        return torch.cat([encoder(inputs[modality]) for modality, encoder in self.encoders.items()], 1)

    def embed(self, inputs: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Embed the shapes of a batch of inputs of the same objects; (B, 256)."""
        return self.fusion(self.features(inputs))

    def forward(self, inputs: Mapping[str, torch.Tensor], points: torch.Tensor) -> torch.Tensor:
        """Return the occupancy logits (B, P) of points (B, P, 3), unit frame."""
        return self.decoder(points, self.embed(inputs))


@torch.no_grad()
def occupancy_logits(
    decoder: OccupancyDecoder, embedding: torch.Tensor, points: torch.Tensor, chunk: int = 2**11
) -> torch.Tensor:
    """Return logits (B, P) at points (P, 3) shared by all objects, in evaluation and in chunks of points."""
    return torch.stack([torch.cat([*map(decoder.one_shape(one), points.split(chunk))]) for one in embedding])
