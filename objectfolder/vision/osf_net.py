"""VisionNet ``osf``: the paper's object-centric scattering function (supplementary E; Guo et al. 2020).

A volume density in the unit cube, and the fraction of incident light that each point scatters towards the
camera. Everything, including geometry and shadows, is learned from the views alone.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from objectfolder.mesh.grid import ascent
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.nets.positional import HiddenLinear, SkipNetwork, append_octaves
from objectfolder.nets.storage import OCTAVES, PAPERS, UNFILLED, NetKind, fill, halve_weights, whole
from objectfolder.vision.cameras import Intrinsics, camera_rays
from objectfolder.vision.picture import Picture
from objectfolder.vision.volume import Rays, resample, sample_strata, visibility

_CHUNK = 32  # rays rendered at once: their activations stay in the cache
_NORMAL_STEP = 0.01  # unit frame; finite-difference step of the density gradient
_NEAREST = 0.01  # unit frame; lower limit of the distance to a light


class ScatteringFunction(nn.Module):
    """Density of a point, and the fraction of incoming light it scatters in a direction.

    The paper's density network has eight layers of 256 channels, its scattering network (``branch``) four of
    128. Each coordinate x is encoded as x and sin and cos of 2^k x, for k below the number of octaves.
    """

    def __init__(
        self,
        width: int,
        depth: int,
        branch_width: int,
        branch_depth: int,
        point_octaves: int,
        direction_octaves: int,
    ):
        super().__init__()
        self.octaves = (point_octaves, direction_octaves)
        self.trunk = SkipNetwork(3 * (1 + 2 * point_octaves), width, depth)
        self.density = nn.Linear(width, 1)
        self.bottleneck = HiddenLinear(width, width)
        self.branch = SkipNetwork(width + 6 * (1 + 2 * direction_octaves), branch_width, branch_depth)
        self.fraction = nn.Linear(branch_width, 3)
        # Start dense everywhere: where the density is zero, its ReLU passes no gradient.
        nn.init.constant_(self.density.bias, 1.0)

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the density (N,), and the hidden layer (N, width) for `scattered`, at (N, 3) points."""
        hidden = self.trunk(append_octaves(points, self.octaves[0], 1.0))
        return torch.relu(self.density(hidden))[:, 0], hidden

    def scattered(self, hidden: Tensor, incoming: Tensor, outgoing: Tensor) -> Tensor:
        """Evaluate the fraction of light scattered between unit directions that leave the point; (N, 3).

        The sigmoid is scaled so that it can reach black and white.
        """
        directions = [append_octaves(d, self.octaves[1], 1.0) for d in (outgoing, incoming)]
        x = self.branch(torch.cat([self.bottleneck(hidden), *directions], 1))
        return 1.2 * torch.sigmoid(self.fraction(x)) - 0.1


class OsfNet(nn.Module):
    """Pictures of an object under a point light; a coarse net places the samples of the fine net.

    Samples per ray are 64 and 128 in the paper; the fine net is evaluated at both. ``hull``, with so many
    cells along each axis, is None for none: the density is zero in its other cells, where nothing is
    computed. For the shape see `ScatteringFunction`.

    Colours are linear until displayed, and light falls off with the squared distance, as in the views. The
    authors' published code fits encoded colours without falloff, and its sample intervals end at the next
    sample instead of midway.
    """

    hull: Tensor | None

    def __init__(self, coarse_samples: int, fine_samples: int, hull_cells: int = 0, **shape: int):
        super().__init__()
        self.config = {"coarse_samples": coarse_samples, "fine_samples": fine_samples, **shape}
        if hull_cells:
            self.config["hull_cells"] = hull_cells
        self.samples = (coarse_samples, fine_samples)
        self.register_buffer("hull", torch.ones((hull_cells,) * 3, dtype=torch.bool) if hull_cells else None)
        self.coarse = ScatteringFunction(**shape)
        self.fine = ScatteringFunction(**shape)

    @property
    def kind(self) -> str:
        """Kind in an Object File."""
        return "osf" if self.hull is None else "osf_hull"

    def forward(
        self, rays: Rays, light: Tensor, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        """Render rays through the cube on white with the coarse and the fine net; (N, 3) each, linear.

        The light is (N, 3), unit frame. A generator jitters the samples, as in training.
        """
        distance, coarse = self._sample(rays, generator, light)
        fine, alpha, _ = self._look(rays, distance, light)
        return coarse, fine + 1 - alpha[:, None]

    def _sample(
        self, rays: Rays, generator: torch.Generator | None, light: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return distances for the fine net (N, S), ascending, and what the coarse one sees, if lit."""
        distance = sample_strata(rays.near, rays.far, self.samples[0], generator)
        weights, radiance = self._march(self.coarse, rays, distance, light)
        seen = radiance + 1 - weights.sum(1, keepdim=True)
        more = resample(rays.intervals(distance), weights.detach(), self.samples[1], generator)
        return torch.cat([distance, more], 1).sort(1).values, seen

    def _look(self, rays: Rays, distance: Tensor, light: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return radiance (N, 3), alpha (N,) and mean distance times alpha (N,) of the fine net."""
        weights, radiance = self._march(self.fine, rays, distance, light)
        return radiance, weights.sum(1), (weights * distance).sum(1)

    def _march(
        self, field: ScatteringFunction, rays: Rays, distance: Tensor, light: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Return the weights of samples at distances (N, S), and the radiance (N, 3), 0 without a light.

        A point light, (N, 3) or (3,), is scattered with inverse-square falloff.
        """
        density, computed, hidden = self._evaluated(field, rays.points(distance).flatten(0, 1))
        weights = visibility(density.view_as(distance), rays.intervals(distance).diff())
        if light is None:
            return weights, weights.new_zeros(len(weights), 3)
        # Samples of zero weight affect neither the colour nor a gradient: skip them.
        chosen = weights.flatten()[computed].nonzero()[:, 0]
        seen = computed[chosen]
        row = seen // distance.shape[1]
        points = rays.origins[row] + distance.flatten()[seen, None] * rays.directions[row]
        to_light = light.expand(len(distance), 3)[row] - points
        squared = to_light.square().sum(1, keepdim=True).clamp(min=_NEAREST**2)
        fraction = field.scattered(hidden[chosen], to_light / squared.sqrt(), -rays.directions[row])
        colors = fraction.new_zeros(weights.numel(), 3).index_copy(0, seen, fraction / squared)
        return weights, torch.einsum("ns,nsc->nc", weights, colors.view(*weights.shape, 3))

    def _evaluated(self, field: ScatteringFunction, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the density (N,) at points, which ones (K,) are in the hull, and their hidden layer."""
        computed = self._within(points)
        density, hidden = field(points[computed])
        return density.new_zeros(len(points)).index_copy(0, computed, density), computed, hidden

    def _density(self, points: Tensor) -> Tensor:
        """Return the density of the fine net; (N, 3) to (N,)."""
        return self._evaluated(self.fine, points)[0]

    def _within(self, points: Tensor) -> Tensor:
        """Return which (N, 3) points are in cells of the hull; (K,), ascending."""
        if self.hull is None:
            return torch.arange(len(points), device=points.device)
        cells = len(self.hull)
        place = ((points + BOUND) * (cells / (2 * BOUND))).long().clamp(0, cells - 1)
        return self.hull[place[:, 0], place[:, 1], place[:, 2]].nonzero()[:, 0]

    @torch.no_grad()
    def picture(self, camera_to_world: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> Picture:
        """Render one view from a pose (4, 4) and a light (3,), with one ray through the centre of each pixel.

        Depth is the weighted mean along the ray. The normal is the direction of decreasing density there;
        zero where the density is constant.
        """
        device = self.fine.density.weight.device
        found = camera_rays(camera_to_world, intrinsics, pixel_centres(intrinsics))
        origins, directions = (torch.from_numpy(x).to(device) for x in found)
        rays = Rays.through_cube(origins, directions, BOUND)
        rgba = origins.new_zeros(len(origins), 4)
        depth = origins.new_full((len(origins),), math.inf)
        normals = torch.zeros_like(origins)
        forward = torch.from_numpy(-camera_to_world[:3, 2].astype(np.float32)).to(device)
        towards = torch.from_numpy(np.asarray(light, np.float32)).to(device)
        for index in (rays.far > rays.near).nonzero()[:, 0].split(_CHUNK):
            part = rays[index]
            radiance, alpha, distance = self._look(part, self._sample(part, None)[0], towards)
            rgba[index] = torch.cat([radiance, alpha[:, None].clamp(max=1)], 1)
            met = alpha > 0
            part, distance = part[met], (distance / alpha)[met]
            depth[index[met]] = distance * (part.directions @ forward)
            points = part.points(distance[:, None])[:, 0]
            normals[index[met]] = -ascent(self._density, points, _NORMAL_STEP)
        size = intrinsics.height, intrinsics.width
        return Picture(*(x.view(*size, *x.shape[1:]).cpu().numpy() for x in (rgba, depth, normals)))

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors (weights as float16) and configuration."""
        tensors = halve_weights(self)
        if self.hull is not None:
            tensors["hull"] = np.packbits(tensors["hull"])
        return tensors, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "OsfNet":
        """Invert `to_tensors`."""
        with UNFILLED:
            net = cls(**config)
        state = {name: torch.from_numpy(np.array(value)) for name, value in tensors.items()}
        if net.hull is not None:
            cells = net.hull.numel()
            if tensors["hull"].shape != (-(-cells // 8),):
                raise ValueError(f"hull has shape {tensors['hull'].shape}, expected bits of {cells} cells")
            bits = np.unpackbits(tensors["hull"], count=cells).astype(bool)
            state["hull"] = torch.from_numpy(bits).view_as(net.hull)
        return fill(net, state)


def pixel_centres(intrinsics: Intrinsics) -> np.ndarray:
    """Return the image positions of the pixel centres, row by row; (H W, 2)."""
    rows, columns = np.mgrid[: intrinsics.height, : intrinsics.width]
    return np.stack([columns.ravel(), rows.ravel()], 1) + 0.5


_FIELDS = {
    **PAPERS,
    "branch_width": PAPERS["width"],
    "branch_depth": PAPERS["depth"],
    "direction_octaves": OCTAVES,
    "coarse_samples": whole(2, 4096, "of a ray"),
    "fine_samples": whole(1, 4096, "of a ray"),
}
_HULL = {"hull_cells": whole(1, 256, "a side of the cube")}
KINDS = {
    "osf": NetKind(OsfNet, "pictures", _FIELDS, slow=True),
    "osf_hull": NetKind(OsfNet, "pictures", _FIELDS | _HULL, slow=True),
}
