"""Training of AudioNet ``gains``."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from objectfolder.nets.fit import CurvePoint, FitSettings, Session, fit, minibatches
from objectfolder.nets.optimizers import Soap
from objectfolder.nets.siren import sine_bound
from objectfolder.nets.spline import mark_touched
from objectfolder.nets.storage import round_to_codes, round_with
from objectfolder.sound.gains_net import GainsNet, GainsShape, energy_weights
from objectfolder.sound.net_settings import AudioConfig, GainsConfig

ENERGY_SHARE = 0.8  # share of the energy-weighted error in the loss; the rest is weighted by gain
DROPPED = 0.012  #: share (root mean square) of the weighted shapes dropped in training, for speed
SPANNED = 0.02  #: share (root mean square) that features may leave, as too few to span the shapes
RIDGE = 1e-6  # regularisation of the output layer's least squares, relative to the mean feature power


@dataclass(frozen=True)
class ModeSamples:
    """Mode shapes at points of a surface, from which nets of sound learn."""

    points: np.ndarray  #: (P, 3), unit frame
    shapes: np.ndarray  #: (P, 3, M), kg^-1/2
    damped_frequency: np.ndarray  #: (M,), rad/s
    damping: np.ndarray  #: (M,), 1/s
    train: np.ndarray  #: rows to learn from
    val: np.ndarray  #: rows of the validation


def train(samples: ModeSamples, settings: AudioConfig, session: Session) -> tuple[GainsNet, list[CurvePoint]]:
    """Train a net of this kind, as the stage asks."""
    return train_gains(samples, settings.size(len(samples.damping)), settings.batch, session)


def train_gains(
    samples: ModeSamples, config: GainsConfig, batch: int, session: Session
) -> tuple[GainsNet, list[CurvePoint]]:
    """Fit a `GainsNet` to mode shapes at surface points, ``batch`` of them a step, on the CPU.

    Losses of the curve are relative squared errors of the gains.

    The loss is a weighted mean of the two relative squared errors of `gain_errors`, of energy and of gain;
    weighting by energy alone leaves weak modes 50 % wrong. It is computed on the principal components of the
    weighted shapes, without the weakest; see `DROPPED`. The net has as many features as there are components
    that matter, see `SPANNED`, within the limits of ``config``. At the end the linear output layer is solved
    by least squares, which is optimal for every mode whatever its weight.
    """
    x = torch.from_numpy(np.asarray(samples.points, np.float32))
    shape = torch.from_numpy(np.asarray(samples.shapes, np.float32))
    rows, val_rows = torch.from_numpy(samples.train), torch.from_numpy(samples.val)
    damped_frequency, damping = samples.damped_frequency, samples.damping
    amplitude = shape[rows].square().mean((0, 1)).sqrt().clamp(min=1e-12)
    target = (shape / amplitude).flatten(1)
    energy = amplitude.square() * torch.from_numpy(energy_weights(damped_frequency, damping)).float()
    gain = (amplitude / torch.from_numpy(damped_frequency).float()).square()
    weight = ENERGY_SHARE * energy / energy.sum() + (1 - ENERGY_SHARE) * gain / gain.sum()
    components, power = _principal_components(target * weight.sqrt().repeat(3), rows)
    features = count_features(power, config)
    with session.initialisation():
        net = GainsNet(
            *(torch.from_numpy(damped_frequency), torch.from_numpy(damping), amplitude),
            mark_touched(x[rows], config.resolution),
            GainsShape(config.resolution, config.channels, config.width, features, config.frequency),
        )
        if len(damping) == 0:
            return net.eval(), []
        head = nn.Linear(features, components.shape[1])
        bound = sine_bound(features, config.frequency)
        nn.init.uniform_(head.weight, -bound, bound)
    batches = iter(minibatches(len(rows), batch, session.generator))
    nodes, weights = net.grid.nodes(x)

    def loss(index: torch.Tensor) -> torch.Tensor:
        taken = (values.index_select(0, index) for values in (x, nodes, weights, components))
        points, of_points, with_weights, true = taken
        found = head(net.features(points, net.grid.lookup(of_points, with_weights)))
        return F.mse_loss(found, true, reduction="sum") / (len(index) * 3 * len(damping))

    groups: list[dict[str, Any]] = [
        {"params": [*net.sines.parameters(), *head.parameters()]},
        {"params": [net.grid.table], "relative_rate": config.grid_rate},
    ]
    curve = fit(
        nn.ModuleList([net, head]),
        batch_loss=lambda: loss(rows[next(batches)]),
        val_loss=lambda: loss(val_rows).item(),
        settings=FitSettings(config.steps, config.learning_rate, final_rate=0.005),
        session=session,
        optimizer=Soap(groups),
    )
    _finish(net, x[rows], nodes[rows], weights[rows], target[rows])
    return net.eval(), curve


def count_features(power: torch.Tensor, config: GainsConfig) -> int:
    """Return how many features a net needs for shapes whose principal components have a power, ascending."""
    needed = int((power.cumsum(0) > SPANNED**2 * power.sum()).sum())
    return max(config.features, min(needed, config.most_features))


def _principal_components(weighted: torch.Tensor, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Project (P, 3M) columns on their principal components in some rows, but the weakest.

    Returns the (P, K) components, scaled to a mean power of 1, and the power of all (3M,), ascending.
    """
    if weighted.shape[1] == 0:
        return weighted, weighted.new_zeros(0)
    power, axes = torch.linalg.eigh((weighted[rows].T @ weighted[rows]).double() / len(rows))
    kept = power.cumsum(0) > DROPPED**2 * power.sum()
    return weighted @ axes[:, kept].flip(1).float() / float(power.mean()) ** 0.5, power


@torch.no_grad()
def _finish(
    net: GainsNet, points: torch.Tensor, nodes: torch.Tensor, weights: torch.Tensor, target: torch.Tensor
) -> None:
    """Quantise the net as stored, then solve its output layer by least squares over all points."""
    for matrix in (net.grid.table, net.sines.weights[1]):
        matrix.copy_(round_to_codes(matrix))
    features = torch.cat(
        [net.features(points, net.grid.lookup(nodes, weights)), torch.ones(len(points), 1)], 1
    ).double()
    gram = features.T @ features
    gram += RIDGE * gram.diagonal().mean() * torch.eye(len(gram))
    right = features.T @ target.double()
    solution = torch.linalg.solve(gram, right)
    # The bias corrects the mean error of rounding.
    covariance = gram[:-1, :-1] - torch.outer(gram[:-1, -1], gram[-1, :-1]) / gram[-1, -1]
    net.output.weight.copy_(round_with(solution[:-1].T, covariance))
    net.output.bias.copy_((target - features[:, :-1].float() @ net.output.weight.T).mean(0))
