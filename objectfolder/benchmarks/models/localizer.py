"""Beliefs over places on an object: the net that gives them, what to answer, and how several add up."""

from typing import cast

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import nn

SOFTNESS = 0.03  #: deviation of the belief that nets learn, longest sides
WIDTH = 128  #: of the features that are compared
OCTAVES = 5  #: of sines and cosines of the places


class Localizer(nn.Module):
    """Encoder of what is felt or heard, and a net of the places (P, 3); their product is the belief."""

    def __init__(self, encoder: nn.Module, places: np.ndarray):
        super().__init__()
        self.encoder = encoder
        self.query = nn.Linear(cast(int, encoder.features), WIDTH)
        angles = np.pi * places[:, None] * 2.0 ** np.arange(OCTAVES)[:, None]
        waves = [places, np.sin(angles).reshape(len(places), -1), np.cos(angles).reshape(len(places), -1)]
        self.register_buffer("waves", torch.from_numpy(np.concatenate(waves, 1)).float())
        self.keys = nn.Sequential(
            nn.Linear(3 + 6 * OCTAVES, WIDTH),
            nn.ReLU(),
            nn.Linear(WIDTH, WIDTH),
            nn.ReLU(),
            nn.Linear(WIDTH, WIDTH),
        )

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Inputs (B, C, H, W) of the encoder -> (B, P) logarithms of the belief."""
        found = self.query(self.encoder(inputs)) @ self.keys(self.waves).T
        return (found / WIDTH**0.5).float().log_softmax(1)


def choose_likeliest(belief: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """Return the places (N,) with the least expected distance.

    A belief (N, P) holds logarithms of probabilities, up to a constant in each row; distances (P, P) are
    between the places.
    """
    share = np.exp(belief - belief.max(1, keepdims=True))
    return np.argmin(share / share.sum(1, keepdims=True) @ distances, axis=1)


def add_beliefs(
    beliefs: np.ndarray, moves: np.ndarray, places: np.ndarray, softness: float = SOFTNESS
) -> np.ndarray:
    """Add up the beliefs (n, P), logarithms, of contacts between which the moves (n, 3) are known.

    Moves lead from the last contact to each one. If the last contact is at a place p, contact i was at p +
    move i. Its belief there is that of the nearest of the places (P, 3), less the squared distance to it over
    twice the squared softness: points off the surface are unlikely. Returns the logarithm of the belief about
    the last contact (P,), up to a constant.
    """
    off, nearest = cKDTree(places).query(places + moves[:, None])
    rows = np.arange(len(beliefs))[:, None]
    return np.sum(beliefs[rows, nearest] - off**2 / (2 * softness**2), axis=0)
