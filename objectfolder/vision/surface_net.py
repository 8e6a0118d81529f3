"""VisionNet ``surface``: a stored surface, shaded.

A hash grid trained on the mesh gives the base colour and shading normal of a surface point; the ground
truth's BSDF shades them under a point light with a shadow ray. Indirect light is learned from views, on top
of the stored surface's diffuse interreflection, by a small grid and an MLP whose inputs include the camera,
the light, and the gathered and mirrored radiance.
"""

import copy
import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from objectfolder.mesh import srgb
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.hashgrid import HashGrid
from objectfolder.nets.storage import UNFILLED, NetKind, fill, real, whole
from objectfolder.vision.bsdf import fresnel, principled
from objectfolder.vision.lighting import toward
from objectfolder.vision.radiosity import Radiosity
from objectfolder.vision.trace import SurfaceSamples
from objectfolder.vision.vectors import column_major, concatenate, dot, normalize_rows, take_rows
from objectfolder.vision.view import SQUARE, Shader

#: Hash grid for indirect light.
TRANSPORT = {"levels": 2, "features": 4, "table_bits": 13, "coarsest": 8, "finest": 14}
GRIDS = ("grid", "transport")
_APART = ("width", "roughness", "metallic")  # settings of a net beside those of its first grid
NEAREST = 1e-3  # lower limit of the distance to a light, unit frame: avoids infinite radiance
FAMILIAR = 0.1  # lower limit for indirect light, unit frame: training lights are farther away
CHUNK = 50_000  # points shaded at once
ALIKE = 0.97  # least cosine between the normals of samples that share the net's correction
BAKED = 2**14  # vertices evaluated at once
#: Of `find_gains`: light that the radiances lack, diffuse and glossy, and their factors; all by colour.
GAIN_BIAS, GAIN_SCALE = (-4.0, -5.0, 0.5, 0.0), (0.5, 0.1, 1.0, 1.0)


class SurfaceNet(nn.Module):
    """Linear radiance of surface points under a point light.

    The grid holds features of base colour and normal; ``width`` is that of the MLPs' hidden layers. Roughness
    and metallic are parameters of the principled BSDF.
    """

    def __init__(self, grid: HashGrid, width: int, roughness: float, metallic: float):
        super().__init__()
        self.grid = grid
        self.appearance = _mlp(self.grid.width + 3, width, 6, depth=1)
        self.transport = HashGrid(**TRANSPORT)
        self.bounced = _mlp(self.transport.width + 52, width, 12, depth=2)
        self.config = {**self.grid.config, "width": width, "roughness": roughness, "metallic": metallic}

    def albedo_and_normal(self, points: Tensor, normals: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate base colours, sRGB and unclipped, and shading normals, not normalised; both (S, 3).

        Points and normals (S, 3) are those of the stored surface, unit frame; features (S, F) those of
        ``grid``.
        """
        a = self.appearance(torch.cat([features, points], 1))
        return a[:, :3] + 0.5, normals + a[:, 3:]

    def base_colors(self, points: Tensor) -> Tensor:
        """Evaluate base colours (S, 3), sRGB and unclipped, at points near the surface, unit frame."""
        color, _ = self.albedo_and_normal(points, torch.zeros_like(points), self.grid(in_cube(points)))
        return color

    def direct(self, samples: SurfaceSamples, light: Tensor, base_color: Tensor, normals: Tensor) -> Tensor:
        """Compute direct radiance, (S, 3), from base colours (linear) and unit shading normals."""
        lit = samples.lit.nonzero()[:, 0]
        to_light = toward(light, take_rows(samples.points, lit))
        squared = dot(to_light, to_light)
        normal, view, color = (take_rows(v, lit) for v in (normals, samples.directions, base_color))
        look = self.config["roughness"], self.config["metallic"]
        reflected = principled(normal, view, normalize_rows(to_light), color, *look)
        radiance = base_color.new_zeros(base_color.shape[::-1])
        return radiance.index_copy_(1, lit, (reflected / squared.clamp(min=NEAREST**2)).mT).mT

    def mirrored(
        self, baked: "Baked", samples: SurfaceSamples, light: Tensor, base_color: Tensor, normals: Tensor
    ) -> Tensor:
        """Return the radiance ``mirrored`` of `BounceInputs`; parameters as there."""
        index, shown = baked.radiosity.mirror(samples, normals, light)
        color, mirror, view = (take_rows(v, index) for v in (base_color, normals, samples.directions))
        reflected = shown * fresnel(-dot(mirror, view), color, self.config["metallic"])
        return normals.new_zeros(normals.shape[::-1]).index_copy_(1, index, reflected.mT).mT

    def bounce_inputs(
        self,
        samples: SurfaceSamples,
        light: Tensor,
        normals: Tensor,
        direct: Tensor,
        gathered: Tensor,
        mirrored: Tensor,
    ) -> "BounceInputs":
        """Compute the inputs of `indirect`.

        The light is a point light (3,), unit frame, or a distant one (4,), see
        `objectfolder.vision.lighting.toward`. Unit shading normals and the radiance that `direct` returns are
        (S, 3); for ``gathered`` and ``mirrored`` see `BounceInputs`.
        """
        p, n, view = samples.points, normals, samples.directions
        to_light = toward(light, p)
        # Training views have no closer lights.
        squared = dot(to_light, to_light).clamp(min=FAMILIAR**2)
        l = normalize_rows(to_light)
        nl, nv = dot(n, l), -dot(n, view)
        away = view + 2 * nv * n
        nh = dot(n, normalize_rows(l - view)).clamp(0, 1)
        nh8 = nh.square().square().square()
        sine, cosine = torch.sin(4 * p), torch.cos(4 * p)
        lit, received = samples.lit[:, None].float(), nl.clamp(min=0) / squared
        place = light[:3].expand(len(p), 3)  # of distant ones as if on the unit sphere, as in training
        doubled = 2 * sine * cosine, 1 - 2 * sine * sine  # sine and cosine of the double angle
        radiances = (torch.log1p(by * of) for by, of in ((4, direct), (4, gathered), (16, mirrored)))
        features = [
            *(p, sine, cosine, *doubled, place, samples.normals, n, view, l, away),
            *(nl, nv, nh, nh8, nh8.square().square()),
            *(received, lit, lit * received, 1 / squared, torch.log(squared), *radiances),
        ]
        return BounceInputs(concatenate(features, 1), gathered, mirrored)

    def indirect(self, inputs: "BounceInputs", transport: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate indirect light: diffuse, for a white surface, and glossy radiance; (S, 3) each.

        ``transport`` (S, T) are features of the grid of that name.
        """
        return apply_gains(find_gains(self.corrections(inputs, transport)), inputs.gathered, inputs.mirrored)

    def corrections(self, inputs: "BounceInputs", transport: Tensor) -> Tensor:
        """Evaluate the net of indirect light, (S, 12); parameters are those of `indirect`."""
        return column_major(self.bounced(concatenate([inputs.features, transport], 1)))

    def shader(
        self, surface: Isosurface, device: torch.device | str = "cpu", baked: "Baked | None" = None
    ) -> Shader:
        """Return a function that shades samples of one surface.

        Indirect light is smooth: samples of one pixel share it, and those of a square of pixels share the
        net's correction, if they face nearly the same way and are all lit or all in shadow. Shading is on the
        device; rays are cast and the surface is baked on the CPU, unless it is already ``baked``.
        """
        net = copy.deepcopy(self).cpu()
        baked = (net.bake(surface) if baked is None else baked).to(device)
        net.to(device)

        @torch.inference_mode()
        def shade(samples: SurfaceSamples, light: Tensor, pixel: np.ndarray) -> Tensor:
            return net.radiance(baked, samples, light, pixel, device).cpu()

        return shade

    def radiance(
        self,
        baked: "Baked",
        samples: SurfaceSamples,
        light: Tensor,
        pixel: np.ndarray,
        device: torch.device | str = "cpu",
    ) -> Tensor:
        """Return the linear radiance of samples, (S, 3), on a device; see `shader`.

        Gradients flow from points, weights, normals and directions of the samples, and from the light (3,) or
        (4,). What mirrored rays see, and which patch is nearest, is constant. The baked surface is on the
        device, as the net. For ``pixel`` (S,) see `objectfolder.vision.view.Shader`.
        """
        shared = _shared(pixel, samples.lit, samples.normals.detach())
        one, group, few, share = (torch.from_numpy(index).to(device) for index in shared)
        samples, light = samples.to(device), light.to(device)
        base_color, normals = baked.look_of(samples)
        direct = self.direct(samples, light, base_color, normals)
        each, looks = samples, [base_color, normals, direct]
        several = len(one) < len(pixel)  # samples in some pixels
        if several:
            each, looks = samples.select(one), [take_rows(v, one) for v in looks]
        gathered = baked.radiosity.gather(each, light)
        radiances = gathered, self.mirrored(baked, each, light, *looks[:2])
        corrections = []
        for part in few.split(CHUNK):
            some = each.select(part)
            values = (take_rows(v, part) for v in (*looks[1:], *radiances))
            inputs = self.bounce_inputs(some, light, *values)
            corrections.append(self.corrections(inputs, column_major(some.interpolate(baked.transport))))
        indirect = apply_gains(take_rows(find_gains(concatenate(corrections)), share), *radiances)
        diffuse, glossy = (take_rows(v, group) for v in indirect) if several else indirect
        return direct + base_color * diffuse + glossy

    @torch.no_grad()
    def bake(self, surface: Isosurface) -> "Baked":
        """Precompute all quantities that depend on the point alone, at the surface's vertices and patches."""
        points = torch.from_numpy(surface.shading.vertices.astype(np.float32))
        looks, transport = [], []
        for p, n in zip(points.split(BAKED), surface.shading.tensor.split(BAKED)):
            cube = in_cube(p)
            color, shading = self.albedo_and_normal(p, n, self.grid(cube))
            looks.append(torch.cat([srgb.decode(color.clamp(0, 1)), F.normalize(shading, dim=-1)], 1))
            transport.append(self.transport(cube))

        def reflectance(p: Tensor, n: Tensor) -> Tensor:
            color, _ = self.albedo_and_normal(p, n, self.grid(in_cube(p)))
            return srgb.decode(color.clamp(0, 1)) * (1 - self.config["metallic"])

        return Baked(torch.cat(looks), torch.cat(transport), Radiosity(surface, reflectance))

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors, grids as by `HashGrid.packed` and the rest as float16, and configuration."""
        state = {k: v.half().numpy() for k, v in self.state_dict().items() if not k.endswith(".table")}
        for grid in GRIDS:
            state |= {f"{grid}.{name}": value for name, value in getattr(self, grid).packed().items()}
        return state, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "SurfaceNet":
        """Invert `to_tensors`, up to quantisation."""
        of_grid = {name: value for name, value in config.items() if name not in _APART}
        with UNFILLED:
            net = cls(HashGrid(**of_grid), **{name: config[name] for name in _APART})
        packed = {f"{grid}.{name}" for grid in GRIDS for name in ("table", "factors")}
        state = {k: torch.from_numpy(np.array(v)).float() for k, v in tensors.items() if k not in packed}
        for grid in GRIDS:
            stored = tensors[f"{grid}.table"], tensors[f"{grid}.factors"]
            state[f"{grid}.table"] = getattr(net, grid).unpacked(*stored)
        return fill(net, state)


@dataclass(frozen=True)
class Baked:
    """Attributes of a surface's vertices, interpolated over triangles usually smaller than a pixel."""

    look: Tensor  #: (V, 6), base colour (linear) and unit shading normal
    transport: Tensor  #: (V, T), features of the grid ``transport``
    radiosity: Radiosity

    def to(self, device: torch.device | str) -> "Baked":
        """Return a copy on a device, except the radiosity, which stays on the CPU."""
        return replace(self, look=self.look.to(device), transport=self.transport.to(device))

    def look_of(self, samples: SurfaceSamples) -> tuple[Tensor, Tensor]:
        """Interpolate base colours (linear) and unit shading normals; (S, 3) each."""
        values = column_major(samples.interpolate(self.look))
        return values[:, :3], normalize_rows(values[:, 3:])


@dataclass(frozen=True)
class BounceInputs:
    """Inputs from which indirect light is predicted; tensors share their first dimension S."""

    features: Tensor  #: (S, 52), positions, angles, distances and the radiances below
    gathered: Tensor  #: (S, 3), diffuse interreflection by a white surface
    mirrored: Tensor  #: (S, 3), diffuse light of the surroundings, mirrored by a smooth surface

    def select(self, index: Tensor) -> "BounceInputs":
        """Return the inputs of some samples, in single precision."""
        features, *radiances = (take_rows(v, index) for v in (self.features, self.gathered, self.mirrored))
        return BounceInputs(features.float(), *radiances)


def find_gains(corrections: Tensor) -> Tensor:
    """Return what `apply_gains` applies to the radiances, (S, 12), from the net's output (S, 12)."""
    bias, scale = (corrections.new_tensor(v).repeat_interleave(3) for v in (GAIN_BIAS, GAIN_SCALE))
    return F.softplus(corrections + bias) * scale


def apply_gains(factors: Tensor, gathered: Tensor, mirrored: Tensor) -> tuple[Tensor, Tensor]:
    """Return indirect light, as `SurfaceNet.indirect`, from `find_gains` (S, 12) and radiances (S, 3)."""
    more_diffuse, more_glossy, diffuse, glossy = factors.split(3, 1)
    return gathered * diffuse + more_diffuse, mirrored * glossy + more_glossy


def _shared(
    pixel: np.ndarray, lit: Tensor, normals: Tensor
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Choose the samples whose indirect light serves others.

    Returns index arrays: ``one`` (O,), the first of the samples of each pixel that are all lit or all in
    shadow; ``group`` (S,), the place in ``one`` of each sample; ``few`` (P,), the first of ``one`` in each
    square of pixels that are all lit or all in shadow, and those that face another way than it; ``share``
    (O,), the place in ``few`` of each of ``one``.
    """
    state, facing = lit.numpy(), normals.numpy().T
    one, group = _firsts(2 * pixel + state)
    square, leader = _firsts(2 * (pixel.take(one) // SQUARE) + state.take(one))
    leader = square.take(leader)
    if len(one) < len(pixel):
        facing = facing.take(one, 1)
    cosine = np.einsum("ks,ks->s", facing, facing.take(leader, 1))
    alone = cosine < ALIKE
    evaluated = alone.copy()
    evaluated[square] = True
    number = np.cumsum(evaluated) - 1
    return one, group, np.flatnonzero(evaluated), number.take(np.where(alone, np.arange(len(one)), leader))


def _firsts(groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first row of each group, in order of rows, and each row's index into them."""
    rows = np.arange(len(groups))
    first = np.empty(groups.max() + 1, np.int64)
    first[groups[::-1]] = rows[::-1]
    leader = first.take(groups)
    leads = leader == rows
    return np.flatnonzero(leads), (leads.cumsum() - 1).take(leader)


def in_cube(points: Tensor) -> Tensor:
    """Map points (S, 3) from the unit frame to the cube [0, 1]^3 of a `HashGrid`."""
    return (points / BOUND + 1) / 2


def _mlp(inputs: int, width: int, outputs: int, depth: int) -> nn.Sequential:
    hidden: list[nn.Module] = []
    for a, b in itertools.pairwise([inputs] + [width] * depth):
        hidden += [nn.Linear(a, b), nn.ReLU(inplace=True)]
    return nn.Sequential(*hidden, nn.Linear(width, outputs))


KINDS = {
    "surface": NetKind(
        SurfaceNet,
        "surface",
        {
            "levels": whole(1, 16, "of the hash grid `grid`"),
            "features": whole(1, 8, "of a level"),
            "table_bits": whole(1, 19, "a level has at most 2^table_bits entries"),
            "coarsest": whole(1, 4096, "cells a side"),
            "finest": whole(1, 8192, "cells a side"),
            "width": whole(1, 1024, "of the hidden layers"),
            "roughness": real(0, 1),
            "metallic": real(0, 1),
        },
    )
}
