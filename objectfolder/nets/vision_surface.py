"""VisionNet ``surface``: a stored surface, shaded.

A hash grid gives base colour and shading normal at a surface point, learned from the mesh; the ground
truth's BSDF shades them under a point light with its shadow ray. What bounces is learned from views, on
top of the diffuse interreflection of the stored surface: a small grid and an MLP, which know where camera
and light are, what the surface gathers and what it mirrors.
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from objectfolder.mesh.grid import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.hashgrid import HashGrid
from objectfolder.vision.bsdf import fresnel, principled
from objectfolder.vision.color import srgb_to_linear
from objectfolder.vision.radiosity import Radiosity
from objectfolder.vision.trace import SurfaceSamples
from objectfolder.vision.view import Shader

#: Of the grid of what bounces.
TRANSPORT = {"levels": 2, "features": 4, "table_bits": 13, "coarsest": 8, "finest": 14}
GRIDS = ("grid", "transport")
NEAREST = 1e-3  # distance of a light, unit frame: one on the surface would be infinitely bright
FAMILIAR = 0.1  # training lights are further off
CHUNK = 50_000  # points that are looked up at once


class SurfaceNet(nn.Module):
    """Linear radiance of surface points under a point light.

    Parameters
    ----------
    levels, features, table_bits, coarsest, finest
        See `HashGrid`.
    width : int
        Hidden width of the MLPs.
    roughness, metallic : float
        Of the principled BSDF.
    """

    def __init__(
        self,
        levels: int,
        features: int,
        table_bits: int,
        coarsest: int,
        finest: int,
        width: int,
        roughness: float,
        metallic: float,
    ):
        super().__init__()
        self.grid = HashGrid(levels, features, table_bits, coarsest, finest)
        self.appearance = _mlp(self.grid.width + 3, width, 6, depth=1)
        self.transport = HashGrid(**TRANSPORT)
        self.bounced = _mlp(self.transport.width + 52, width, 12, depth=2)
        self.config = {**self.grid.config, "width": width, "roughness": roughness, "metallic": metallic}

    def looks(
        self, points: torch.Tensor, normals: torch.Tensor, features: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Base colours, sRGB and unclipped, and shading normals, not normalised; both (S, 3).

        Parameters
        ----------
        points, normals : (S, 3) tensors
            Of the stored surface, unit frame.
        features : (S, F) tensor
            Of ``grid`` there.
        """
        a = self.appearance(torch.cat([features, points], 1))
        return a[:, :3] + 0.5, normals + a[:, 3:]

    def direct(
        self, samples: SurfaceSamples, light: torch.Tensor, base_color: torch.Tensor, normals: torch.Tensor
    ) -> torch.Tensor:
        """Radiance straight from the light; (S, 3) as base colours (linear) and unit shading normals."""
        to_light = light - samples.points
        squared = (to_light * to_light).sum(-1, keepdim=True).clamp(min=NEAREST**2)
        reflected = principled(
            normals,
            samples.directions,
            F.normalize(to_light, dim=-1),
            base_color,
            self.config["roughness"],
            self.config["metallic"],
        )
        return reflected * (samples.lit[:, None] / squared)

    def bounce_inputs(
        self,
        baked: "Baked",
        samples: SurfaceSamples,
        light: torch.Tensor,
        base_color: torch.Tensor,
        normals: torch.Tensor,
        direct: torch.Tensor,
    ) -> "BounceInputs":
        """What is known of the light that has bounced, before anything is learned of it.

        Parameters
        ----------
        baked : Baked
        samples : SurfaceSamples
        light : (3,) tensor, unit frame
        base_color, normals, direct : (S, 3) tensors
            Linear base colours, unit shading normals, and the radiance that `direct` returns.
        """
        p, n, view = samples.points, normals, samples.directions
        to_light = light - p
        # No view has taught lights that are closer than this.
        squared = (to_light * to_light).sum(-1, keepdim=True).clamp(min=FAMILIAR**2)
        l = F.normalize(to_light, dim=-1)
        nl = (n * l).sum(-1, keepdim=True)
        nh = (n * F.normalize(l - view, dim=-1)).sum(-1, keepdim=True).clamp(0, 1)
        nv = -(n * view).sum(-1, keepdim=True)
        lit, received = samples.lit[:, None].float(), nl.clamp(min=0) / squared
        gathered, mirrored = baked.radiosity.around(samples, n, light.numpy())
        mirrored = mirrored * fresnel(nv, base_color, self.config["metallic"])
        columns = [
            p,
            torch.sin(4 * p),
            torch.cos(4 * p),
            torch.sin(8 * p),
            torch.cos(8 * p),
            light.expand(len(p), 3),
            samples.normals,
            n,
            view,
            l,
            view + 2 * nv * n,
            nl,
            nv,
            nh,
            nh**8,
            nh**32,
            received,
            lit,
            lit * received,
            1 / squared,
            torch.log(squared),
            torch.log1p(4 * direct),
            torch.log1p(4 * gathered),
            torch.log1p(16 * mirrored),
        ]
        return BounceInputs(torch.cat(columns, -1), gathered, mirrored)

    def indirect(self, inputs: "BounceInputs", transport: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Light that has bounced: what a white surface would reflect, and what any does; (S, 3) each.

        Parameters
        ----------
        inputs : BounceInputs
        transport : (S, T) tensor
            Of the grid ``transport``.
        """
        b = self.bounced(torch.cat([inputs.features, transport], 1)).split(3, 1)
        diffuse = inputs.gathered * F.softplus(b[2] + 0.5) + 0.5 * F.softplus(b[0] - 4)
        return diffuse, inputs.mirrored * F.softplus(b[3]) + 0.1 * F.softplus(b[1] - 5)

    def shader(self, surface: Isosurface) -> Shader:
        """Return what shades samples of one surface.

        Samples of one pixel share the light that bounces, which is smooth.
        """
        baked = self.bake(surface)

        @torch.no_grad()
        def shade(samples: SurfaceSamples, light: torch.Tensor, pixel: np.ndarray) -> torch.Tensor:
            base_color, normals = baked.look_of(samples)
            direct = self.direct(samples, light, base_color, normals)
            one, group = map(torch.from_numpy, np.unique(pixel, return_index=True, return_inverse=True)[1:])
            each = samples.select(one)
            inputs = self.bounce_inputs(baked, each, light, base_color[one], normals[one], direct[one])
            diffuse, glossy = self.indirect(inputs, each.interpolated(baked.transport))
            return direct + base_color * diffuse[group] + glossy[group]

        return shade

    @torch.no_grad()
    def bake(self, surface: Isosurface) -> "Baked":
        """Evaluate once what depends on the point alone, at the surface's vertices and patches."""
        points = torch.from_numpy(surface.vertices.astype(np.float32))
        looks, transport = [], []
        for p, n in zip(points.split(CHUNK), torch.from_numpy(surface.normals).split(CHUNK)):
            cube = in_cube(p)
            color, shading = self.looks(p, n, self.grid(cube))
            looks.append(torch.cat([srgb_to_linear(color.clamp(0, 1)), F.normalize(shading, dim=-1)], 1))
            transport.append(self.transport(cube))

        def reflectance(p: torch.Tensor, n: torch.Tensor) -> torch.Tensor:
            color, _ = self.looks(p, n, self.grid(in_cube(p)))
            return srgb_to_linear(color.clamp(0, 1)) * (1 - self.config["metallic"])

        return Baked(torch.cat(looks), torch.cat(transport), Radiosity(surface, reflectance))

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors for storing: see `HashGrid.packed`; the rest as float16."""
        state = {k: v.half().numpy() for k, v in self.state_dict().items() if not k.endswith(".table")}
        for grid in GRIDS:
            state |= {f"{grid}.{name}": value for name, value in getattr(self, grid).packed().items()}
        return state, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "SurfaceNet":
        """Inverse of `to_tensors`, up to quantisation."""
        net = cls(**config)
        packed = {f"{grid}.{name}" for grid in GRIDS for name in ("table", "factors")}
        state = {k: torch.from_numpy(np.array(v)).float() for k, v in tensors.items() if k not in packed}
        for grid in GRIDS:
            stored = tensors[f"{grid}.table"], tensors[f"{grid}.factors"]
            state[f"{grid}.table"] = getattr(net, grid).unpacked(*stored)
        net.load_state_dict(state)
        return net.eval()


@dataclass(frozen=True)
class Baked:
    """Attributes of a surface's vertices; they are interpolated over triangles smaller than a usual pixel."""

    look: torch.Tensor  #: (V, 6), base colour, linear, and unit shading normal
    transport: torch.Tensor  #: (V, T), features of the grid ``transport``
    radiosity: Radiosity

    def look_of(self, samples: SurfaceSamples) -> tuple[torch.Tensor, torch.Tensor]:
        """Base colours, linear, and unit shading normals; (S, 3) each."""
        values = samples.interpolated(self.look)
        return values[:, :3], F.normalize(values[:, 3:], dim=-1)


@dataclass(frozen=True)
class BounceInputs:
    """What light that has bounced is predicted from; tensors share their first dimension S."""

    features: torch.Tensor  #: (S, 52), positions, angles, distances and the light below
    gathered: torch.Tensor  #: (S, 3), what a white surface would reflect of diffuse light from the rest
    mirrored: torch.Tensor  #: (S, 3), what a smooth surface would reflect of it as a mirror

    def select(self, index: torch.Tensor) -> "BounceInputs":
        """Return those of some samples, in single precision."""
        return BounceInputs(self.features[index].float(), self.gathered[index], self.mirrored[index])


def in_cube(points: torch.Tensor) -> torch.Tensor:
    """Points (S, 3) of the unit frame in the cube [0, 1]^3 of a `HashGrid`."""
    return (points / BOUND + 1) / 2


def _mlp(inputs: int, width: int, outputs: int, depth: int) -> nn.Sequential:
    sizes = [inputs] + [width] * depth
    hidden = [layer for a, b in itertools.pairwise(sizes) for layer in (nn.Linear(a, b), nn.ReLU())]
    return nn.Sequential(*hidden, nn.Linear(width, outputs))
