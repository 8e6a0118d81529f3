"""VisionNets of released ObjectFolder files: ray marching, and the kind with one large net.

The kind with many small nets is in `objectfolder.vision.released_kilo`.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Protocol, Self

import numpy as np
import torch
from torch import Tensor

from objectfolder.mesh import srgb
from objectfolder.mesh.grid import ascent
from objectfolder.nets.released_network import float_tensors, stored_tensors
from objectfolder.nets.storage import UNFILLED, fill
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.osf_net import ScatteringFunction
from objectfolder.vision.picture import Picture

MAX_SAMPLES = 4096  # per ray
_INVISIBLE = 1e-8  # samples of lower weight get no colour
_DEVICE_CHUNK = 2048  # rays rendered at once on devices other than the CPU
_NORMAL_STEP = 0.01  # unit frame; finite-difference step of the density gradient


@dataclass(frozen=True)
class March:
    """Sample positions of the original along a ray.

    Distances are along the optical axis, as in the original, whose ray directions have unit component there.
    """

    near: float
    far: float
    samples: int
    more: int  #: samples of the second pass, where the first found density; 0 for a single pass
    inverse: bool  #: whether the samples are evenly spaced in inverse distance
    pixel: float = 0.0  #: position of the ray in its pixel: 0 is the corner, 0.5 the centre

    def __post_init__(self) -> None:
        if not (0 <= self.near < self.far < math.inf and (self.near > 0 or not self.inverse)):
            raise ValueError(
                f"near {self.near}, far {self.far}, expected 0 <= near < far < inf, near > 0 if inverse"
            )
        if not (2 <= self.samples <= MAX_SAMPLES and 0 <= self.more <= MAX_SAMPLES):
            raise ValueError(f"{self.samples} and {self.more} samples, expected 2 and 0 to {MAX_SAMPLES}")
        if (self.more and self.samples < 4) or not 0 <= self.pixel <= 1:
            raise ValueError(f"{self.samples} samples to refine, rays at {self.pixel}")

    def distances(self) -> Tensor:
        """Return the distances of the first pass; (samples,)."""
        t = _even(self.samples)
        if self.inverse:
            return 1 / (1 / self.near * (1 - t) + 1 / self.far * t)
        return self.near * (1 - t) + self.far * t

    def refined(self, distance: Tensor, weights: Tensor) -> Tensor:
        """Add samples to distances (N, S) by importance sampling of their weights (N, S); ascending.

        A sample's weight is spread between the midpoints to its neighbours; the first and the last sample are
        ignored.
        """
        ends = (distance[:, 1:] + distance[:, :-1]) / 2
        share = weights[:, 1:-1] + 1e-5
        share = share / share.sum(1, keepdim=True)
        cumulative = torch.cat([torch.zeros_like(share[:, :1]), share.cumsum(1)], 1)
        target = _even(self.more).to(share).expand(len(share), -1).contiguous()
        above = torch.searchsorted(cumulative, target, right=True)
        below, above = (above - 1).clamp(min=0), above.clamp(max=cumulative.shape[1] - 1)
        (c0, c1), (t0, t1) = ([x.gather(1, i) for i in (below, above)] for x in (cumulative, ends))
        width = torch.where(c1 - c0 < 1e-5, 1.0, c1 - c0)
        return torch.cat([distance, t0 + (target - c0) / width * (t1 - t0)], 1).sort(1).values


class Field(Protocol):
    """Density and colour that a ray marches through."""

    def occupied(self, points: Tensor) -> Tensor:
        """Return a mask of the (N, 3) points that may have density; (N,) bool."""

    def density(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the density (N,), at least 0, and hidden layer (N, W) for `color`, at (N, 3) points."""

    def color(self, points: Tensor, hidden: Tensor, view: Tensor, light: Tensor) -> Tensor:
        """Evaluate encoded colours (N, 3) for unit directions from the camera and light positions (N, 3)."""


class Network:
    """A `Field` of one net for all points; outside of a cube of half side ``crop`` the density is zero."""

    def __init__(self, net: ScatteringFunction, crop: float | None):
        self.net = net
        self.crop = math.inf if crop is None else crop

    def occupied(self, points: Tensor) -> Tensor:
        """Return a mask of the points inside the crop cube; (N,) bool."""
        return (points.abs() <= self.crop).all(1)

    def density(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the density and the hidden layer."""
        return self.net(points)

    def color(self, points: Tensor, hidden: Tensor, view: Tensor, light: Tensor) -> Tensor:
        """Evaluate encoded colours."""
        return self.net.scattered(hidden, light, view)


class ReleasedVision:
    """Renderer of pictures like those of the released code.

    The released code blends encoded colours on white. Linear colours of a picture are therefore chosen to
    give the same colours on white; they are negative where a pixel is dark and partly covered. On a CPU,
    ``chunk`` rays are rendered at once.
    """

    coarse: Field  #: places the samples of `fine`
    fine: Field

    def __init__(self, march: March, chunk: int):
        self.march = march
        self.chunk = chunk
        self.device = torch.device("cpu")

    def to(self, device: str | torch.device) -> Self:
        """Move to a device and return self."""
        self.device = torch.device(device)
        return self

    @torch.no_grad()
    def picture(self, camera_to_world: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> Picture:
        """Render one view.

        The light (3,), unit frame, is passed to the net unchanged; it was trained with lights on the unit
        sphere. Depth is the weighted mean along the ray; the normal is the direction of decreasing density
        there, zero where the density is constant.
        """
        origin, directions = (x.to(self.device) for x in _rays(camera_to_world, intrinsics, self.march.pixel))
        towards = torch.from_numpy(np.asarray(light, np.float32)).to(self.device)
        rgba = directions.new_zeros(len(directions), 4)
        depth = directions.new_full((len(directions),), math.inf)
        normals = torch.zeros_like(directions)
        chunk = self.chunk if self.device.type == "cpu" else _DEVICE_CHUNK
        for index in torch.arange(len(directions), device=self.device).split(chunk):
            ways = directions[index]
            shown, alpha, distance = self._look(origin, ways, towards)
            rgb = srgb.decode((shown + 1 - alpha[:, None]).clamp(0, 1))
            alpha = alpha.clamp(max=1)
            rgba[index] = torch.cat([rgb - (1 - alpha[:, None]), alpha[:, None]], 1)
            met = alpha > 0
            mean = (distance / alpha)[met]
            depth[index[met]] = mean
            points = origin + mean[:, None] * ways[met]
            normals[index[met]] = -ascent(_everywhere(self.fine), points, _NORMAL_STEP)
        rgba[depth == math.inf] = 0
        size = intrinsics.height, intrinsics.width
        return Picture(*(x.view(*size, *x.shape[1:]).cpu().numpy() for x in (rgba, depth, normals)))

    def _look(self, origin: Tensor, ways: Tensor, light: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return blended colour (N, 3), alpha (N,) and mean distance times alpha (N,)."""
        length = torch.linalg.vector_norm(ways, dim=1, keepdim=True)
        distance = self.march.distances().to(ways).expand(len(ways), -1)
        if self.march.more:
            density = _everywhere(self.coarse)(_points(origin, ways, distance))
            distance = self.march.refined(distance, _weights(density.view_as(distance), distance, length))
        points = _points(origin, ways, distance)
        held = self.fine.occupied(points).nonzero()[:, 0]
        found, hidden = self.fine.density(points[held])
        density = points.new_zeros(len(points)).index_copy(0, held, found)
        weights = _weights(density.view_as(distance), distance, length)
        seen = (weights.flatten()[held] > _INVISIBLE).nonzero()[:, 0]
        at = held[seen]
        row = at // distance.shape[1]
        view = (ways / length)[row]
        color = self.fine.color(points[at], hidden[seen], view, light.expand(len(at), 3))
        colors = points.new_zeros(len(points), 3).index_copy(0, at, color).view(*weights.shape, 3)
        shown = torch.einsum("ns,nsc->nc", weights, colors)
        return shown, weights.sum(1), (weights * distance).sum(1)


class ReleasedNerf(ReleasedVision):
    """VisionNet of ObjectFolder 1.0, or of 2.0 without KiloOSF: one or two nets of point, view and light.

    ``nets`` are ``coarse`` and ``fine``, or ``fine`` alone. Outside of a cube of half the side ``crop`` the
    density is taken as zero; without one there is no limit, as in the original.
    """

    def __init__(self, nets: dict[str, ScatteringFunction], march: March, crop: float | None = None):
        super().__init__(march, chunk=max(1, 6144 // (march.samples + march.more)))
        if not (crop is None or 0 < crop < math.inf) or ("coarse" in nets) != (march.more > 0):
            raise ValueError(f"crop {crop}; nets {', '.join(nets)} for {march.more} samples of a second pass")
        self.nets = nets
        self.crop = crop
        self.fine = Network(nets["fine"], crop)
        self.coarse = Network(nets.get("coarse", nets["fine"]), crop)

    def to(self, device: str | torch.device) -> Self:
        """Move to a device and return self."""
        for net in self.nets.values():
            net.to(device)
        return super().to(device)

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors and configuration for storing."""
        tensors: dict[str, np.ndarray] = {}
        for name, net in self.nets.items():
            tensors |= stored_tensors(net, f"{name}.")
        point_octaves, direction_octaves = self.nets["fine"].octaves
        octaves = {"point_octaves": point_octaves, "direction_octaves": direction_octaves}
        return tensors, {**asdict(self.march), **octaves, "crop": self.crop}

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "ReleasedNerf":
        """Invert `to_tensors`."""
        config = dict(config)
        octaves = int(config.pop("point_octaves")), int(config.pop("direction_octaves"))
        crop = config.pop("crop")
        state = float_tensors(tensors)
        nets = {}
        for name in sorted({key.split(".")[0] for key in state}):
            part = {k.removeprefix(f"{name}."): v for k, v in state.items() if k.startswith(f"{name}.")}
            nets[name] = build_scattering(part, *octaves)
        return cls(nets, March(**config), crop)


def build_scattering(
    state: dict[str, Tensor], point_octaves: int, direction_octaves: int
) -> ScatteringFunction:
    """Build the `ScatteringFunction` described by tensors.

    Raises ValueError, KeyError or RuntimeError if the tensors describe none.
    """

    def shape(part: str) -> tuple[int, int]:
        start = f"{part}.hidden."
        depth = sum(name.startswith(start) and name.endswith(".weight") for name in state)
        return len(state[f"{start}0.weight"]), depth

    if not (0 <= point_octaves <= 64 and 0 <= direction_octaves <= 64):
        raise ValueError(f"{point_octaves} and {direction_octaves} octaves")
    with UNFILLED:
        net = ScatteringFunction(*shape("trunk"), *shape("branch"), point_octaves, direction_octaves)
    return fill(net, state).requires_grad_(False)


def _rays(camera_to_world: np.ndarray, intrinsics: Intrinsics, place: float) -> tuple[Tensor, Tensor]:
    """Return the origin (3,), and directions (H W, 3) with unit component along the optical axis."""
    rows, columns = np.mgrid[: intrinsics.height, : intrinsics.width] + place
    x, y = (columns - intrinsics.cx) / intrinsics.fx, (intrinsics.cy - rows) / intrinsics.fy
    local = np.stack([x, y, -np.ones_like(x)], -1).reshape(-1, 3)
    directions = (local @ np.asarray(camera_to_world)[:3, :3].T).astype(np.float32)
    return torch.from_numpy(camera_to_world[:3, 3].astype(np.float32)), torch.from_numpy(directions)


def _even(count: int) -> Tensor:
    """Return evenly spaced numbers from 0 to 1; (count,) float32, on the CPU."""
    return torch.linspace(0.0, 1.0, count, dtype=torch.float32, device="cpu")


def _points(origin: Tensor, ways: Tensor, distance: Tensor) -> Tensor:
    """Return the points at (N, S) distances along (N, 3) directions; (N S, 3)."""
    return (origin + ways[:, None] * distance[..., None]).flatten(0, 1)


def _everywhere(field: Field) -> Callable[[Tensor], Tensor]:
    """Return a function for the density (N,) at (N, 3) points; zero outside occupied space."""

    def density(points: Tensor) -> Tensor:
        held = field.occupied(points).nonzero()[:, 0]
        return points.new_zeros(len(points)).index_copy(0, held, field.density(points[held])[0])

    return density


def _weights(density: Tensor, distance: Tensor, length: Tensor) -> Tensor:
    """Compute sample weights (N, S); an interval ends at the next sample, and the last one is infinite."""
    steps = torch.cat([distance.diff(), torch.full_like(distance[:, :1], 1e10)], 1)
    alpha = 1 - torch.exp(-density * steps * length)
    through = torch.cumprod(1 - alpha + 1e-10, 1)
    return alpha * torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], 1)
