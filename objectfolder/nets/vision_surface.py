"""VisionNet ``surface``: a stored surface, shaded.

A hash grid gives base colour and shading normal at a surface point, learned from the mesh; the ground
truth's BSDF shades them under a point light with its shadow ray. What bounces is learned from views: a
small grid and an MLP, which know where camera and light are.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
import trimesh
from scipy.ndimage import maximum_filter, minimum_filter
from torch import nn

from objectfolder.mesh import srgb
from objectfolder.mesh.grid import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.fit import CurvePoint, fit, minibatches
from objectfolder.nets.hashgrid import HashGrid
from objectfolder.vision.appearance import appearance_at
from objectfolder.vision.bsdf import principled
from objectfolder.vision.cameras import Intrinsics, camera_rays
from objectfolder.vision.color import srgb_slope, srgb_to_linear
from objectfolder.vision.scene import Scene
from objectfolder.vision.trace import SurfaceSamples, trace
from objectfolder.vision.view import Shader

TRANSPORT = {
    "levels": 3,
    "features": 4,
    "table_bits": 15,
    "coarsest": 8,
    "finest": 30,
}  #: grid of what bounces
GRIDS = ("grid", "transport")
NEAREST = 1e-3  # distance of a light, unit frame: one on the surface would be infinitely bright
FAMILIAR = 0.1
DARK = 0.002  # radiance that is hardly shown
DARK_SHARE = 0.2  # of such pixels that training takes, against others
CHUNK = 50_000  # points whose grid corners are computed at once


@dataclass(frozen=True)
class VisionConfig:
    """Shape of the net and of its training."""

    levels: int
    features: int
    table_bits: int
    coarsest: int
    finest: int
    width: int  #: of the MLPs
    points: int  #: of the surface, to learn base colour and normals from
    point_steps: int
    point_batch: int
    pixels: int  #: of all training views, to learn what bounces from
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
        self.bounced = _mlp(self.transport.width + 46, width, 6, depth=2)
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
            Of `grid` there.
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

    def indirect(self, features: torch.Tensor, transport: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Light that has bounced: what a white surface would reflect, and what any does; (S, 3) each.

        Parameters
        ----------
        features : (S, 46) tensor
            `light_features`.
        transport : (S, T) tensor
            Of the grid `transport`.
        """
        b = self.bounced(torch.cat([features, transport], 1))
        return 0.5 * F.softplus(b[:, :3] - 4), 0.1 * F.softplus(b[:, 3:] - 5)

    def shader(self, surface: Isosurface) -> Shader:
        """Return what shades samples of one surface, by attributes at its vertices.

        Everything that depends on the point alone is evaluated here, once, and interpolated over the
        triangles, which are smaller than a pixel of a usual view. Samples of one pixel share the light that
        bounces, which is smooth.
        """
        vertices = self.vertex_attributes(surface)
        look, transport = vertices[:, :6].contiguous(), vertices[:, 6:].contiguous()

        @torch.no_grad()
        def shade(samples: SurfaceSamples, light: torch.Tensor, pixel: np.ndarray) -> torch.Tensor:
            base_color, normals = _look(samples.interpolated(look))
            direct = self.direct(samples, light, base_color, normals)
            one, group = map(torch.from_numpy, np.unique(pixel, return_index=True, return_inverse=True)[1:])
            each = samples.select(one)
            features = light_features(each, light, normals[one], direct[one])
            diffuse, glossy = self.indirect(features, each.interpolated(transport))
            return direct + base_color * diffuse[group] + glossy[group]

        return shade

    @torch.no_grad()
    def vertex_attributes(self, surface: Isosurface) -> torch.Tensor:
        """(V, 6 + T): linear base colour, unit shading normal and transport features at vertices."""
        points = torch.from_numpy(surface.vertices.astype(np.float32))
        normals = torch.from_numpy(surface.normals)
        parts = []
        for p, n in zip(points.split(CHUNK), normals.split(CHUNK)):
            cube = _in_cube(p)
            color, shading = self.looks(p, n, self.grid(cube))
            linear = srgb_to_linear(color.clamp(0, 1))
            parts.append(torch.cat([linear, F.normalize(shading, dim=-1), self.transport(cube)], 1))
        return torch.cat(parts)

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


def light_features(
    samples: SurfaceSamples, light: torch.Tensor, normals: torch.Tensor, direct: torch.Tensor
) -> torch.Tensor:
    """Positions, angles and distances that bounced light depends on; (S, 46)."""
    p, n, view = samples.points, normals, samples.directions
    lit = samples.lit[:, None].float()
    light = light.expand(len(p), 3)
    to_light = light - p
    # No view has taught lights that are closer than this.
    squared = (to_light * to_light).sum(-1, keepdim=True).clamp(min=FAMILIAR**2)
    l = F.normalize(to_light, dim=-1)
    nl = (n * l).sum(-1, keepdim=True)
    nh = (n * F.normalize(l - view, dim=-1)).sum(-1, keepdim=True).clamp(0, 1)
    nv = -(n * view).sum(-1, keepdim=True)
    received = nl.clamp(min=0) / squared
    mirrored = view + 2 * nv * n
    columns = [
        p,
        torch.sin(4 * p),
        torch.cos(4 * p),
        torch.sin(8 * p),
        torch.cos(8 * p),
        light,
        samples.normals,
        n,
        view,
        l,
        mirrored,
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
    ]
    return torch.cat(columns, -1)


def _in_cube(points: torch.Tensor) -> torch.Tensor:
    """Unit frame to the cube [0, 1]^3 of a grid."""
    return (points / BOUND + 1) / 2


def _look(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Base colours and unit shading normals from interpolated attributes (S, 6)."""
    return values[:, :3], F.normalize(values[:, 3:], dim=-1)


def _mlp(inputs: int, width: int, outputs: int, depth: int) -> nn.Sequential:
    sizes = [inputs] + [width] * depth
    hidden = [layer for a, b in itertools.pairwise(sizes) for layer in (nn.Linear(a, b), nn.ReLU())]
    return nn.Sequential(*hidden, nn.Linear(width, outputs))


@dataclass(frozen=True)
class _Points:
    """Points of the stored surface with what the mesh looks like there."""

    points: torch.Tensor  # (S, 3)
    normals: torch.Tensor  # (S, 3), of the stored surface
    corners: tuple[torch.Tensor, torch.Tensor]
    color: torch.Tensor  # (S, 3), sRGB
    shading: torch.Tensor  # (S, 3), unit

    def __len__(self) -> int:
        return len(self.points)

    def loss(self, net: SurfaceNet, index: torch.Tensor) -> torch.Tensor:
        features = net.grid.lookup(self.corners[0][index], self.corners[1][index])
        color, shading = net.looks(self.points[index], self.normals[index], features)
        return F.mse_loss(color, self.color[index]) + F.mse_loss(shading, self.shading[index])


@dataclass(frozen=True)
class _Pixels:
    """Pixels of views within the object, away from shadow edges; all that does not learn is computed."""

    features: torch.Tensor  # (S, 46) float16
    base_color: torch.Tensor  # (S, 3) linear
    direct: torch.Tensor  # (S, 3) linear
    target: torch.Tensor  # (S, 3) linear, at most 1
    corners: tuple[torch.Tensor, torch.Tensor]

    def __len__(self) -> int:
        return len(self.target)

    def loss(self, net: SurfaceNet, index: torch.Tensor) -> torch.Tensor:
        transport = net.transport.lookup(self.corners[0][index], self.corners[1][index])
        diffuse, glossy = net.indirect(self.features[index].float(), transport)
        radiance = (self.direct[index] + self.base_color[index] * diffuse + glossy).clamp(max=1)
        # As it is shown, to first order: the mean of noisy samples is right before the gamma, not after it.
        error = (radiance - self.target[index]) * srgb_slope(radiance.detach())
        return error.square().mean()


def train_surface(
    surface: Isosurface,
    scene: Scene,
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    config: VisionConfig,
    generator: torch.Generator,
    report: Callable[[CurvePoint], None] = lambda point: None,
) -> tuple[SurfaceNet, list[CurvePoint]]:
    """Fit a `SurfaceNet` to a mesh's appearance, then to views of it.

    Parameters
    ----------
    surface : Isosurface
        The stored surface: training points must lie on what a query will see.
    scene : Scene
        The mesh that the views show.
    train, val : dict
        ``rgba`` (N, H, W, 4), ``camera_to_world`` (N, 4, 4), ``light`` (N, 3), ``focal``.
    config : VisionConfig
    generator : torch.Generator
    report : callable
        Called with each `CurvePoint` of the views; losses are mean squared errors in sRGB on pixels within
        the object.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
        net = SurfaceNet(
            config.levels,
            config.features,
            config.table_bits,
            config.coarsest,
            config.finest,
            config.width,
            scene.roughness,
            scene.metallic,
        )
    rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))

    def fitted(learn, check, steps: int, batch: int, shown=lambda point: None) -> list[CurvePoint]:
        batches = iter(minibatches(len(learn), batch, generator))
        chunks = torch.arange(len(check)).split(CHUNK)
        return fit(
            net,
            batch_loss=lambda: learn.loss(net, next(batches)),
            val_loss=lambda: sum(check.loss(net, c).item() * len(c) for c in chunks) / len(check),
            steps=steps,
            learning_rate=config.learning_rate,
            report=shown,
        )

    known, unknown = (_look_up(surface, scene, net, n, rng) for n in (config.points, config.points // 20))
    fitted(known, unknown, config.point_steps, config.point_batch)
    # What bounces is learned on top of what a query will see.
    net = SurfaceNet.from_tensors(*net.to_tensors())
    vertices = net.vertex_attributes(surface)
    pixels = _gather(surface, net, vertices, train, config.pixels, DARK_SHARE, rng)
    held_out = _gather(surface, net, vertices, val, config.pixels, 1, rng)
    curve = fitted(pixels, held_out, config.steps, config.batch, report)
    return net.eval(), curve


def _look_up(
    surface: Isosurface, scene: Scene, net: SurfaceNet, count: int, rng: np.random.Generator
) -> _Points:
    """Random points of the surface, and what the mesh looks like nearest to them."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=rng)
    color, looked_up = appearance_at(scene, points)
    p = torch.from_numpy(points.astype(np.float32))
    normals = surface.grid.normals(p)
    shading = torch.from_numpy(looked_up)
    # Meshes may have faces turned inside; renderers turn them to the eye, which is outside.
    shading = torch.where((shading * normals).sum(1, keepdim=True) < 0, -shading, shading)
    encoded = torch.from_numpy(srgb.encode(color).astype(np.float32))
    return _Points(p, normals, _corners(net.grid, p), encoded, shading)


def _gather(
    surface: Isosurface,
    net: SurfaceNet,
    vertices: torch.Tensor,
    views: dict[str, np.ndarray],
    count: int,
    dark_share: float,
    rng: np.random.Generator,
) -> _Pixels:
    """About ``count`` pixels of views, as many of each, or all; dark ones with a smaller chance."""
    height, width = views["rgba"].shape[1:3]
    intrinsics = Intrinsics(width, height, float(views["focal"]))
    share, parts, seen_points = -(-count // len(views["rgba"])), [], []
    for rgba, pose, light in zip(views["rgba"], views["camera_to_world"], views["light"]):
        rows, columns = np.nonzero(rgba[..., 3] >= 0.999)
        samples = trace(surface, *camera_rays(pose, intrinsics, np.stack([columns, rows], 1) + 0.5), light)
        row, column = rows[samples.ray], columns[samples.ray]
        state = np.zeros((height, width), np.int8)
        state[row, column] = 1 + samples.lit.numpy()
        chosen = np.flatnonzero((maximum_filter(state, 3) == minimum_filter(state, 3))[row, column])
        target = rgba[row[chosen], column[chosen], :3].astype(np.float32).clip(max=1)
        # There is more to learn where there is light.
        chance = np.where(target.max(1) > DARK, 1, dark_share)
        picked = rng.choice(len(chosen), min(share, len(chosen)), replace=False, p=chance / chance.sum())
        chosen, target = chosen[picked], torch.from_numpy(target[picked])
        samples = samples.select(torch.from_numpy(chosen))
        l = torch.from_numpy(np.asarray(light, np.float32))
        base_color, normals = _look(samples.interpolated(vertices[:, :6]))
        direct = net.direct(samples, l, base_color, normals)
        parts.append((light_features(samples, l, normals, direct).half(), base_color, direct, target))
        seen_points.append(samples.points)
    features, base_color, direct, target = (torch.cat(part) for part in zip(*parts))
    return _Pixels(features, base_color, direct, target, _corners(net.transport, torch.cat(seen_points)))


def _corners(grid: HashGrid, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Of points that are looked up in every epoch; preallocated, because they are most of the memory."""
    width = 8 * len(grid.resolutions)
    rows = torch.empty(len(points), width, dtype=torch.int32)
    weights = torch.empty(len(points), width, dtype=torch.float16)
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        rows[part], weights[part] = grid.corners(_in_cube(points[part]))
    return rows, weights
