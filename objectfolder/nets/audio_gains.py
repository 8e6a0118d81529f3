"""AudioNet ``gains``: frequencies and dampings are stored, a small net maps position to mode shapes.

The spectrogram that the paper's net memorises is linear in the modal gains, so the gains are all there
is to learn: M numbers per force axis instead of 257 x 201.

Features on a grid near the surface and the position go through two layers of sines; mode shapes are linear in
the second. The large matrices are stored as int8.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.nets import int8
from objectfolder.nets.audio_config import GainsConfig
from objectfolder.nets.fit import CurvePoint, fit, minibatches
from objectfolder.nets.siren import Siren, sine_bound
from objectfolder.nets.soap import Soap
from objectfolder.nets.spline import SplineGrid, touched

ENERGY_SHARE = 0.8  # of the energy-weighted error in the loss; the rest weighs by gain
DROPPED = 0.012  #: of the weighted shapes (root mean square) that training does not see: faster
RIDGE = 1e-6  # of the output layer's least squares, relative to a feature's power
# The first layer is small, and its weights of position and of features differ in size.
INT8 = ("grid.table", "sines.layers.1.weight", "output.weight")
BLOCK = 32  # queries run in blocks of this many rows, so that a row's bits do not depend on its batch


class GainsNet(nn.Module):
    """Mode shapes at points of the surface.

    Parameters
    ----------
    damped_frequency : (M,) tensor, rad/s
    damping : (M,) tensor, 1/s
    amplitude : (M,) tensor
        Root mean square of each mode shape, kg^-1/2; the net predicts shapes relative to it.
    used : bool tensor
        Nodes of the grid; see `SplineGrid`.
    resolution, channels, width, features, frequency
        See `GainsConfig`.
    """

    damped_frequency: torch.Tensor
    damping: torch.Tensor
    amplitude: torch.Tensor

    def __init__(
        self,
        damped_frequency: torch.Tensor,
        damping: torch.Tensor,
        amplitude: torch.Tensor,
        used: torch.Tensor,
        resolution: int,
        channels: int,
        width: int,
        features: int,
        frequency: float,
    ):
        super().__init__()
        self.config = {
            "resolution": resolution,
            "channels": channels,
            "width": width,
            "features": features,
            "frequency": frequency,
        }
        self.register_buffer("damped_frequency", damped_frequency.double())
        self.register_buffer("damping", damping.double())
        self.register_buffer("amplitude", amplitude.float())
        self.grid = SplineGrid(resolution, channels, used)
        self.sines = Siren(3 + channels, [width, features], frequency)
        with torch.no_grad():
            # Features of the grid grow to what the net needs; the position starts at the frequency itself.
            first = self.sines.weights[0]
            first[:, :3].uniform_(-1 / 3, 1 / 3)
            first[:, 3:].normal_(0, 1 / (frequency * math.sqrt(first.shape[1])))
        self.output = nn.Linear(features, 3 * len(damping))

    def features(self, points: torch.Tensor, rows: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Evaluate the second layer at (N, 3) points of the unit frame and the grid's nodes of them."""
        return self.sines(torch.cat([2 * points, self.grid.lookup(rows, weights)], 1))

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """Mode shapes over amplitude at (N, 3) points of the unit frame; (N, 3, M)."""
        features = self.features(points, *self.grid.nodes(points))
        return self.output(features).view(len(points), 3, len(self.damping))

    @torch.no_grad()
    def shapes(self, points: torch.Tensor) -> torch.Tensor:
        """Mode shapes at (N, 3) points of the unit frame, kg^-1/2; (N, 3, M), on the device of the net."""
        out = []
        for block in points.to(self.amplitude.device, torch.float32).split(BLOCK):
            padded = block.new_zeros(BLOCK, 3)
            padded[: len(block)] = block
            out.append(self(padded)[: len(block)])
        empty = self.amplitude.new_zeros(0, 3, len(self.damping))
        return (torch.cat(out) if out else empty) * self.amplitude

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors and configuration, for storing."""
        tensors = {}
        for name, value in self.state_dict().items():
            if name in INT8:
                tensors[name], tensors[f"{name}_exponent"] = int8.pack(value)
            elif value.dtype == torch.bool:
                tensors[name] = np.packbits(value.numpy())
            else:
                tensors[name] = value.numpy()
        return tensors, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "GainsNet":
        """Inverse of `to_tensors`.

        Raises
        ------
        LookupError, RuntimeError, TypeError, ValueError
            If they are not what it returns.
        """
        nodes = (config["resolution"] + 2) ** 3
        used = torch.from_numpy(np.unpackbits(tensors["grid.used"], count=nodes).astype(bool))
        state = {}
        for name, value in tensors.items():
            if name.endswith("_exponent"):
                continue
            if value.dtype == np.int8:
                state[name] = int8.unpack(np.array(value), np.array(tensors[f"{name}_exponent"]))
            else:
                state[name] = torch.from_numpy(np.array(value))
        state["grid.used"] = used
        modes = [state[name] for name in ("damped_frequency", "damping", "amplitude")]
        if any(of_modes.shape != (modes[0].numel(),) for of_modes in modes):
            raise ValueError(f"modes of shapes {', '.join(str(tuple(x.shape)) for x in modes)}")
        if (modes[0] <= 0).any() or (modes[1] < 0).any():
            raise ValueError("modes that do not swing, or grow")
        net = cls(state["damped_frequency"], state["damping"], state["amplitude"], used, **config)
        net.load_state_dict(state)
        return net.eval()


def energy_weights(damped_frequency: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Energy of each mode's displacement per squared shape value, 1 / (4 c w^2); (M,)."""
    return 1 / (4 * damping * damped_frequency**2)


def train_gains(
    points: np.ndarray,
    shapes: np.ndarray,
    damped_frequency: np.ndarray,
    damping: np.ndarray,
    train: np.ndarray,
    val: np.ndarray,
    config: GainsConfig,
    batch: int,
    generator: torch.Generator,
    report: Callable[[CurvePoint], None] = lambda point: None,
) -> tuple[GainsNet, list[CurvePoint]]:
    """Fit a `GainsNet` to mode shapes at surface points.

    Parameters
    ----------
    points : (P, 3) array, unit frame
    shapes : (P, 3, M) array, kg^-1/2
    damped_frequency, damping : (M,) arrays
    train, val : int arrays
        Rows of the two splits.
    config : GainsConfig
    batch : int
        Points in a training step.
    generator : torch.Generator
        Seeds initialisation and batches.
    report : callable
        Called with each `CurvePoint`; its losses are relative squared errors of the gains.

    Notes
    -----
    The loss is a mean of the two relative squared errors that `gain_errors` gives, of energy and of gain.
    Weighing by energy alone leaves weak modes 50 % wrong. It is taken of the principal components of the
    weighted shapes but for `DROPPED`. At the end the linear output layer is solved for exactly, which is
    every mode's own optimum whatever its weight.
    """
    x = torch.from_numpy(np.asarray(points, np.float32))
    shape = torch.from_numpy(np.asarray(shapes, np.float32))
    rows, val_rows = torch.from_numpy(train), torch.from_numpy(val)
    amplitude = shape[rows].square().mean((0, 1)).sqrt().clamp(min=1e-12)
    target = (shape / amplitude).flatten(1)
    energy = amplitude.square() * torch.from_numpy(energy_weights(damped_frequency, damping)).float()
    gain = (amplitude / torch.from_numpy(damped_frequency).float()).square()
    weight = ENERGY_SHARE * energy / energy.sum() + (1 - ENERGY_SHARE) * gain / gain.sum()
    components = _principal_components(target * weight.sqrt().repeat(3), rows)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
        net = GainsNet(
            torch.from_numpy(damped_frequency),
            torch.from_numpy(damping),
            amplitude,
            touched(x[rows], config.resolution),
            config.resolution,
            config.channels,
            config.width,
            config.features,
            config.frequency,
        )
        head = nn.Linear(config.features, components.shape[1])
        bound = sine_bound(config.features, config.frequency)
        nn.init.uniform_(head.weight, -bound, bound)
    if len(damping) == 0:
        return net.eval(), []
    batches = iter(minibatches(len(train), batch, generator))
    nodes, weights = net.grid.nodes(x)

    def loss(index: torch.Tensor) -> torch.Tensor:
        found = head(net.features(x[index], nodes[index], weights[index]))
        return (found - components[index]).square().sum() / (len(index) * 3 * len(damping))

    parameters = [
        {"params": [*net.sines.parameters(), *head.parameters()]},
        {"params": [net.grid.table], "relative_rate": config.grid_rate},
    ]
    curve = fit(
        nn.ModuleList([net, head]),
        batch_loss=lambda: loss(rows[next(batches)]),
        val_loss=lambda: loss(val_rows).item(),
        steps=config.steps,
        learning_rate=config.learning_rate,
        final_rate=0.005,
        report=report,
        optimizer=Soap(parameters, config.learning_rate),
    )
    _finish(net, x[rows], nodes[rows], weights[rows], target[rows])
    return net.eval(), curve


def _principal_components(weighted: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
    """Rotate (P, 3M) columns to uncorrelated ones over some rows, of mean power 1; the weak are dropped."""
    if weighted.shape[1] == 0:
        return weighted
    power, axes = torch.linalg.eigh((weighted[rows].T @ weighted[rows]).double() / len(rows))
    kept = power.cumsum(0) > DROPPED**2 * power.sum()
    return weighted @ axes[:, kept].flip(1).float() / float(power.mean()) ** 0.5


@torch.no_grad()
def _finish(
    net: GainsNet, points: torch.Tensor, nodes: torch.Tensor, weights: torch.Tensor, target: torch.Tensor
) -> None:
    """Round the net to what is stored, and solve for its output layer by least squares over all points."""
    for matrix in (net.grid.table, net.sines.weights[1]):
        matrix.copy_(int8.rounded(matrix))
    features = torch.cat([net.features(points, nodes, weights), torch.ones(len(points), 1)], 1).double()
    gram = features.T @ features
    gram += RIDGE * gram.diagonal().mean() * torch.eye(len(gram))
    right = features.T @ target.double()
    solution = torch.linalg.solve(gram, right)
    # The bias makes up for what rounding does to the mean.
    covariance = gram[:-1, :-1] - torch.outer(gram[:-1, -1], gram[-1, :-1]) / gram[-1, -1]
    net.output.weight.copy_(int8.rounded_with(solution[:-1].T, covariance))
    net.output.bias.copy_((target - features[:, :-1].float() @ net.output.weight.T).mean(0))
