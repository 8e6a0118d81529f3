"""AudioNet ``gains``: frequencies and dampings are stored, a small net maps position to mode shapes.

The spectrogram that the paper's net memorises is linear in the modal gains, so the gains are all there
is to learn: M numbers per force axis instead of 257 x 201.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.nets.fit import CurvePoint, fit, minibatches
from objectfolder.nets.siren import Siren
from objectfolder.nets.soap import Soap

ENERGY_SHARE = 0.8  # of the energy-weighted error in the loss; the rest weighs by gain
RIDGE = 1e-6  # of the output layer's least squares, relative to a feature's power
BLOCK = 1024  # queries run in blocks of this many rows, so that a row's bits do not depend on its batch


@dataclass(frozen=True)
class AudioConfig:
    """Shape of the net and of its training."""

    width: int
    depth: int
    features: int  #: of which the outputs are linear: their rank bounds what M modes can share
    frequency: float  #: of the sines
    steps: int
    batch: int
    learning_rate: float


class GainsNet(nn.Module):
    """Mode shapes at points of the surface.

    Parameters
    ----------
    damped_frequency : (M,) tensor, rad/s
    damping : (M,) tensor, 1/s
    amplitude : (M,) tensor
        Root mean square of each mode shape, kg^-1/2; the net predicts shapes relative to it.
    width, depth : int
        Hidden layers.
    features : int
        Width of one more, the last.
    frequency
        See `Siren`.
    """

    damped_frequency: torch.Tensor
    damping: torch.Tensor
    amplitude: torch.Tensor

    def __init__(
        self,
        damped_frequency: torch.Tensor,
        damping: torch.Tensor,
        amplitude: torch.Tensor,
        width: int,
        depth: int,
        features: int,
        frequency: float,
    ):
        super().__init__()
        self.config = {"width": width, "depth": depth, "features": features, "frequency": frequency}
        self.register_buffer("damped_frequency", damped_frequency.double())
        self.register_buffer("damping", damping.double())
        self.register_buffer("amplitude", amplitude.float())
        self.siren = Siren(3, 3 * len(damping), [width] * depth + [features], frequency)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """Mode shapes over amplitude at (N, 3) points of the unit frame; (N, 3, M)."""
        return self.siren(2 * points).view(len(points), 3, len(self.damping))

    @torch.no_grad()
    def shapes(self, points: torch.Tensor) -> torch.Tensor:
        """Mode shapes at (N, 3) points of the unit frame, kg^-1/2; (N, 3, M)."""
        out = []
        for block in points.float().split(BLOCK):
            padded = torch.zeros(BLOCK, 3)
            padded[: len(block)] = block
            out.append(self(padded)[: len(block)])
        empty = torch.zeros(0, 3, len(self.damping))
        return (torch.cat(out) if out else empty) * self.amplitude

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors (weights as float16) and configuration, for storing."""
        tensors = {
            name: (value.half() if name.startswith("siren.") else value).numpy()
            for name, value in self.state_dict().items()
        }
        return tensors, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "GainsNet":
        """Inverse of `to_tensors`."""
        state = {name: torch.from_numpy(np.array(value)) for name, value in tensors.items()}
        net = cls(state["damped_frequency"], state["damping"], state["amplitude"], **config)
        net.load_state_dict({name: value.to(net.state_dict()[name].dtype) for name, value in state.items()})
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
    config: AudioConfig,
    generator: torch.Generator,
    report=lambda point: None,
) -> tuple[GainsNet, list[CurvePoint]]:
    """Fit a `GainsNet` to mode shapes at surface points.

    Parameters
    ----------
    points : (P, 3) array, unit frame
    shapes : (P, 3, M) array, kg^-1/2
    damped_frequency, damping : (M,) arrays
    train, val : int arrays
        Rows of the two splits.
    config : AudioConfig
    generator : torch.Generator
        Seeds initialisation and batches.
    report : callable
        Called with each `CurvePoint`; its losses are relative squared errors of the gains.

    Notes
    -----
    The loss is a mean of the two relative squared errors that `gain_errors` gives, of energy and of gain.
    Weighing by energy alone leaves weak modes 50 % wrong. At the end the linear output layer is solved for
    exactly, which is every mode's own optimum whatever its weight.
    """
    shape = torch.from_numpy(np.asarray(shapes, np.float32))
    amplitude = shape[train].square().mean((0, 1)).sqrt().clamp(min=1e-12)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
        net = GainsNet(
            torch.from_numpy(damped_frequency),
            torch.from_numpy(damping),
            amplitude,
            config.width,
            config.depth,
            config.features,
            config.frequency,
        )
    if len(damping) == 0:
        return net.eval(), []
    x = torch.from_numpy(np.asarray(points, np.float32))
    target = shape / amplitude
    energy = amplitude.square() * torch.from_numpy(energy_weights(damped_frequency, damping)).float()
    gain = (amplitude / torch.from_numpy(damped_frequency).float()).square()
    weight = ENERGY_SHARE * energy / energy.sum() + (1 - ENERGY_SHARE) * gain / gain.sum()
    weight = (weight * len(damping)).sqrt()[None, None]
    rows, val_rows = torch.from_numpy(train), torch.from_numpy(val)
    batches = iter(minibatches(len(train), config.batch, generator))

    def loss(index: torch.Tensor) -> torch.Tensor:
        return ((net(x[index]) - target[index]) * weight).square().mean()

    curve = fit(
        net,
        batch_loss=lambda: loss(rows[next(batches)]),
        val_loss=lambda: loss(val_rows).item(),
        steps=config.steps,
        learning_rate=config.learning_rate,
        final_rate=0.005,
        report=report,
        optimizer=Soap(net.parameters(), config.learning_rate),
    )
    _solve_output(net.siren, x[rows], target[rows])
    return net.eval(), curve


@torch.no_grad()
def _solve_output(siren: Siren, points: torch.Tensor, target: torch.Tensor) -> None:
    """Least squares for the output layer, all points at once; (P, 3), (P, 3, M)."""
    features = siren.features(2 * points)
    features = torch.cat([features, torch.ones(len(points), 1)], 1).double()
    gram = features.T @ features
    gram += RIDGE * gram.diagonal().mean() * torch.eye(len(gram))
    solution = torch.linalg.solve(gram, features.T @ target.flatten(1).double()).float()
    siren.output.weight.copy_(solution[:-1].T)
    siren.output.bias.copy_(solution[-1])
