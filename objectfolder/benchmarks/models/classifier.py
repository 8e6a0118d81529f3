"""Encoders of one or several modalities with a linear layer to classes."""

import copy
from collections.abc import Sequence
from typing import cast

import torch
from torch import nn

from objectfolder.base.seeding import seeded

Inputs = dict[str, torch.Tensor]  #: of encoders, by name


class Classifier(nn.Module):
    """Encoders by letter, one per modality, and a linear layer from their ``features`` to classes."""

    def __init__(self, encoders: dict[str, nn.Module], classes: int):
        super().__init__()
        self.encoders = nn.ModuleDict(encoders)
        width = sum(cast(int, encoder.features) for encoder in encoders.values())
        self.head = nn.Linear(width, classes)

    def forward(self, inputs: Inputs) -> torch.Tensor:
        """Inputs (B, C, H, W) of each encoder -> (B, classes) logits."""
        features = [encoder(inputs[letter]) for letter, encoder in self.encoders.items()]
        return self.head(torch.cat(features, 1))


def join_classifiers(parts: Sequence[Classifier]) -> Classifier:
    """Join trained classifiers of different modalities.

    The joint classifier initially outputs the sum of their logits, the product of their probabilities, which
    is exact for observations that are conditionally independent given the object.
    """
    encoders = {name: copy.deepcopy(net) for part in parts for name, net in part.encoders.items()}
    with seeded(0, "fused"):  # the layer is filled below
        net = Classifier(encoders, parts[0].head.out_features)
    net.head.load_state_dict(
        {
            "weight": torch.cat([part.head.weight.detach() for part in parts], 1),
            "bias": sum(part.head.bias.detach() for part in parts),
        }
    )
    return net
