"""VisionNet ``surface``: a stored surface, shaded.

A hash grid gives albedo, a normal offset and a highlight weight at a surface point; a point light is
shaded analytically with its shadow ray; a small MLP adds what bounces and what the model lacks. The
factors are learned together from images.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from objectfolder.mesh.grid import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.fit import CurvePoint, fit, minibatches
from objectfolder.nets.hashgrid import HashGrid
from objectfolder.vision.cameras import Intrinsics, camera_rays
from objectfolder.vision.color import on_white, shown_error
from objectfolder.vision.trace import SurfaceSamples, trace

DIELECTRIC_F0 = 0.04  # reflectance at normal incidence of the principled BSDF with specular 0.5


@dataclass(frozen=True)
class VisionConfig:
    """Shape of the net and of its training."""

    levels: int
    features: int
    table_bits: int
    coarsest: int
    finest: int
    width: int  #: of the MLPs
    steps: int
    batch: int
    learning_rate: float


class SurfaceNet(nn.Module):
    """Linear radiance of surface points under a point light.

    Parameters
    ----------
    levels, features, table_bits, coarsest, finest
        See `HashGrid`.
    width : int
        Hidden width of the MLPs.
    """

    def __init__(self, levels: int, features: int, table_bits: int, coarsest: int, finest: int, width: int):
        super().__init__()
        self.grid = HashGrid(levels, features, table_bits, coarsest, finest)
        self.config = {**self.grid.config, "width": width}
        self._coarse = min(6, levels) * features
        self.appearance = _mlp(self.grid.width + 3, width, 7, depth=1)
        self.indirect = _mlp(self._coarse + 43, width, 6, depth=2)
        self.log_roughness = nn.Parameter(torch.tensor(math.log(0.25)))  # alpha of the highlight

    def forward(
        self,
        samples: SurfaceSamples,
        light: torch.Tensor,
        corners: tuple[torch.Tensor, torch.Tensor] | None = None,
    ) -> torch.Tensor:
        """Radiance at samples.

        Parameters
        ----------
        samples : SurfaceSamples
        light : (S, 3) or (3,) tensor, unit frame
        corners : optional
            Precomputed ``grid.corners`` of the samples' points.

        Returns
        -------
        (S, 3) tensor, linear
        """
        p, n, view = samples.points, samples.normals, samples.directions
        lit = samples.lit[:, None].float()
        light = light.expand(len(p), 3)
        to_light = light - p
        squared = (to_light * to_light).sum(-1, keepdim=True)
        l = to_light / squared.sqrt()
        features = self.grid.lookup(*corners) if corners is not None else self.grid((p / BOUND + 1) / 2)
        a = self.appearance(torch.cat([features, p], 1))
        albedo = F.softplus(a[:, :3] - 1)
        n_shading = F.normalize(n + 0.5 * torch.tanh(a[:, 3:6]), dim=-1)
        diffuse = lit * (n_shading * l).sum(-1, keepdim=True).clamp(min=0) / squared
        highlight = ggx(n_shading, view, l, self.log_roughness.exp().clamp(0.01, 1)) / squared * lit
        b = self.indirect(
            torch.cat(
                [
                    features[:, : self._coarse],
                    torch.sin(4 * p),
                    torch.cos(4 * p),
                    torch.sin(8 * p),
                    torch.cos(8 * p),
                    light,
                    p,
                    _light_features(n_shading, view, l, squared, lit),
                    n,
                    torch.log1p(4 * highlight),
                    torch.log1p(4 * diffuse),
                    torch.log(squared),
                ],
                1,
            )
        )
        bounced = 0.5 * F.softplus(b[:, :3] - 4)
        specular = highlight * F.softplus(a[:, 6:7] + 0.5) * torch.exp(0.5 * torch.tanh(b[:, 4:5]))
        return (
            albedo * (diffuse * torch.exp(0.5 * torch.tanh(b[:, 3:4])) + bounced)
            + specular
            + 0.1 * F.softplus(b[:, 5:6] - 5)
        )

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors for storing: the table as int8 with one factor per level, the rest as float16."""
        state = {k: v.half().numpy() for k, v in self.state_dict().items() if k != "grid.table"}
        table, factors = self.grid.table.detach(), []
        quantised = torch.empty(table.shape, dtype=torch.int8)
        for start, stop in zip(self.grid.offsets[:-1], self.grid.offsets[1:]):
            factor = table[start:stop].abs().max().clamp(min=1e-12) / 127
            quantised[start:stop] = (table[start:stop] / factor).round().to(torch.int8)
            factors.append(factor.item())
        state["grid.table"] = quantised.numpy()
        state["grid.factors"] = np.array(factors, np.float32)
        return state, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "SurfaceNet":
        """Inverse of `to_tensors`, up to quantisation."""
        net = cls(**config)
        state = {k: torch.from_numpy(np.array(v)).float() for k, v in tensors.items()}
        factors = state.pop("grid.factors")
        sizes = torch.tensor(np.diff(net.grid.offsets))
        state["grid.table"] = state["grid.table"] * factors.repeat_interleave(sizes)[:, None]
        net.load_state_dict(state)
        return net.eval()


def ggx(n: torch.Tensor, view: torch.Tensor, l: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Pi times the GGX highlight of a dielectric times the cosine (Walter et al. 2007); (S, 1)."""
    half = F.normalize(l - view, dim=-1)
    nl = (n * l).sum(-1, keepdim=True).clamp(min=0)
    nv = -(n * view).sum(-1, keepdim=True).clamp(max=-0.02)
    nh = (n * half).sum(-1, keepdim=True).clamp(0, 1)
    vh = -(view * half).sum(-1, keepdim=True).clamp(-1, 0)
    a2 = alpha * alpha
    distribution = a2 / (math.pi * (nh * nh * (a2 - 1) + 1) ** 2)
    masking = 0.5 / (
        nl * (nv * nv * (1 - a2) + a2).sqrt() + nv * (nl * nl * (1 - a2) + a2).clamp(min=1e-12).sqrt() + 1e-4
    )
    fresnel = DIELECTRIC_F0 + (1 - DIELECTRIC_F0) * (1 - vh) ** 5
    return math.pi * distribution * masking * fresnel * nl


def _light_features(
    n: torch.Tensor, view: torch.Tensor, l: torch.Tensor, squared: torch.Tensor, lit: torch.Tensor
) -> torch.Tensor:
    """Angles and distances that bounced light depends on; (S, 19)."""
    nl = (n * l).sum(-1, keepdim=True)
    nh = (n * F.normalize(l - view, dim=-1)).sum(-1, keepdim=True).clamp(0, 1)
    nv = -(n * view).sum(-1, keepdim=True)
    received = nl.clamp(min=0) / squared
    columns = [
        n,
        view,
        l,
        nl,
        received,
        nh,
        nh**8,
        nh**32,
        nv,
        1 / squared,
        lit,
        lit * received,
        lit * nh**32,
    ]
    return torch.cat(columns, -1)


def _mlp(inputs: int, width: int, outputs: int, depth: int) -> nn.Sequential:
    sizes = [inputs] + [width] * depth
    hidden = [layer for a, b in itertools.pairwise(sizes) for layer in (nn.Linear(a, b), nn.ReLU())]
    return nn.Sequential(*hidden, nn.Linear(width, outputs))


@dataclass(frozen=True)
class _Pixels:
    """Fully covered pixels of a split, traced against the stored surface."""

    samples: SurfaceSamples
    light: torch.Tensor  # (S, 3)
    target: torch.Tensor  # (S, 3) sRGB
    corners: tuple[torch.Tensor, torch.Tensor]

    def loss(self, net: SurfaceNet, index: torch.Tensor | slice) -> torch.Tensor:
        s = self.samples
        part = SurfaceSamples(
            s.ray[index], s.points[index], s.normals[index], s.directions[index], s.lit[index]
        )
        radiance = net(part, self.light[index], (self.corners[0][index], self.corners[1][index]))
        return shown_error(radiance, self.target[index]).square().mean()


def train_surface(
    surface: Isosurface,
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    config: VisionConfig,
    generator: torch.Generator,
    report=lambda point: None,
) -> tuple[SurfaceNet, list[CurvePoint]]:
    """Fit a `SurfaceNet` to views.

    Parameters
    ----------
    surface : Isosurface
        The stored surface: training points must lie on what a query will see.
    train, val : dict
        ``rgba`` (N, H, W, 4), ``camera_to_world`` (N, 4, 4), ``light`` (N, 3), ``focal``.
    config : VisionConfig
    generator : torch.Generator
    report : callable
        Called with each `CurvePoint`; losses are mean squared errors in sRGB on fully covered pixels.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
        net = SurfaceNet(
            config.levels, config.features, config.table_bits, config.coarsest, config.finest, config.width
        )
    pixels, held_out = _gather(surface, net, train), _gather(surface, net, val)
    batches = iter(minibatches(len(pixels.target), config.batch, generator))
    chunks = [slice(i, i + 65536) for i in range(0, len(held_out.target), 65536)]

    def val_loss() -> float:
        sums = [held_out.loss(net, c).item() * len(held_out.target[c]) for c in chunks]
        return sum(sums) / len(held_out.target)

    curve = fit(
        net,
        batch_loss=lambda: pixels.loss(net, next(batches)),
        val_loss=val_loss,
        steps=config.steps,
        learning_rate=config.learning_rate,
        report=report,
    )
    return net.eval(), curve


def _gather(surface: Isosurface, net: SurfaceNet, views: dict[str, np.ndarray]) -> _Pixels:
    height, width = views["rgba"].shape[1:3]
    intrinsics = Intrinsics(width, height, float(views["focal"]))
    parts, lights, targets = [], [], []
    for rgba, pose, light in zip(views["rgba"], views["camera_to_world"], views["light"]):
        rows, columns = np.nonzero(rgba[..., 3] >= 0.999)
        pixels = np.stack([columns + 0.5, rows + 0.5], 1)
        samples = trace(surface, *camera_rays(pose, intrinsics, pixels), light)
        seen = samples.ray.numpy()
        parts.append(samples)
        lights.append(torch.from_numpy(np.tile(light.astype(np.float32), (len(seen), 1))))
        targets.append(on_white(torch.from_numpy(rgba[rows[seen], columns[seen]].astype(np.float32))))
    samples = SurfaceSamples(
        **{name: torch.cat([getattr(p, name) for p in parts]) for name in SurfaceSamples.__dataclass_fields__}
    )
    # Looked up in every epoch, so computed once; preallocated, because they are most of the memory.
    count, width = len(samples.points), 8 * len(net.grid.resolutions)
    corners = torch.empty(count, width, dtype=torch.int32), torch.empty(count, width, dtype=torch.float16)
    for start in range(0, count, 100_000):
        part = slice(start, start + 100_000)
        corners[0][part], corners[1][part] = net.grid.corners((samples.points[part] / BOUND + 1) / 2)
    return _Pixels(samples, torch.cat(lights), torch.cat(targets), corners)
