"""VisionNet of a released ObjectFolder 2.0 file with KiloOSF: a grid of small nets (Reiser et al. 2021)."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, Self

import numpy as np
import torch

from objectfolder.nets.positional import append_octaves
from objectfolder.nets.released_network import float_tensors
from objectfolder.vision.released_nerf import March, ReleasedVision

MARGIN = 0.001  #: points closer to the boundary of the grid count as outside
MAX_CELLS = 1 << 18
_CHUNK = 2048  # rays rendered at once


class ReleasedKilo(ReleasedVision):
    """Small nets for the cells of a box, and a finer occupancy grid.

    A net has hidden layers, then a density and a feature; the feature and the directions pass through one
    more layer to the colour. The first dimension of weights is the cell; they multiply row vectors from the
    right. Their names are ``points.N``, ``density``, ``feature``, ``direction`` and ``color``, each with
    ``.weight`` and ``.bias``.

    ``cells`` (K,) are the flat indices of the cells with a net, in row-major order, ascending; ``occupied``
    is the mask of occupied voxels; ``grid`` and ``voxels`` count both along x, y and z of the ``box``: its
    lowest and highest corner, unit frame. ``octaves`` are those of the encodings of point (-1 to 1 within its
    cell), view and light.
    """

    def __init__(
        self,
        weights: dict[str, torch.Tensor],
        cells: torch.Tensor,
        occupied: torch.Tensor,
        march: March,
        grid: Sequence[int],
        voxels: Sequence[int],
        box: list[list[float]],
        octaves: Sequence[int],
    ):
        super().__init__(march, _CHUNK)
        self.grid, self.voxels, self.octaves = tuple(grid), tuple(voxels), tuple(octaves)
        self.box = [list(map(float, corner)) for corner in box]
        self.weights, self.cells, self.voxel_mask = weights, cells, occupied
        self._check()
        self._low, self._high = torch.from_numpy(np.array(self.box, np.float32))
        self._cell, self._voxel = (
            (self._high - self._low) / torch.from_numpy(np.array(parts)) for parts in (self.grid, self.voxels)
        )
        self._row = cells.new_full((math.prod(self.grid),), -1)
        self._row[cells] = torch.arange(len(cells), device=cells.device)
        self._depth = sum(name.startswith("points.") and name.endswith(".weight") for name in weights)
        self.coarse = self.fine = self

    def to(self, device: str | torch.device) -> Self:
        """Move to a device and return self."""
        self.weights = {name: value.to(device) for name, value in self.weights.items()}
        for name in ("voxel_mask", "_low", "_high", "_cell", "_voxel", "_row"):
            setattr(self, name, getattr(self, name).to(device))
        return super().to(device)

    def occupied(self, points: torch.Tensor) -> torch.Tensor:
        """Return a mask of the (N, 3) points in occupied voxels of cells with a net; (N,) bool."""
        inside = ((points > self._low + MARGIN) & (points < self._high - MARGIN)).all(1)
        index = inside.nonzero()[:, 0]
        place = points[index]
        voxel = _index((place - self._low) / self._voxel, self.voxels)
        held = self.voxel_mask[voxel] & (self._row[self._cell_of(place)] >= 0)
        return inside.index_copy(0, index, held)

    def density(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Evaluate the density (N,) and last hidden layer (N, width) at (N, 3) occupied points."""
        density = points.new_empty(len(points))
        hidden = points.new_empty(len(points), self.weights["density.weight"].shape[1])
        for row, index, place in self._by_net(points):
            x = append_octaves(place, self.octaves[0], 1.0)
            for layer in range(self._depth):
                x = torch.relu(self._through(f"points.{layer}", row, x))
            density[index] = torch.relu(self._through("density", row, x))[:, 0]
            hidden[index] = x
        return density, hidden

    def color(
        self, points: torch.Tensor, hidden: torch.Tensor, view: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        """Evaluate encoded colours (N, 3)."""
        out = points.new_empty(len(points), 3)
        _, *octaves = self.octaves
        for row, index, _ in self._by_net(points):
            ways = [append_octaves(x[index], n, 1.0) for x, n in zip((view, light), octaves)]
            feature = self._through("feature", row, hidden[index])
            x = torch.relu(self._through("direction", row, torch.cat([feature, *ways], 1)))
            out[index] = 1.2 * torch.sigmoid(self._through("color", row, x)) - 0.1
        return out

    def _through(self, name: str, row: int, x: torch.Tensor) -> torch.Tensor:
        weight, bias = self.weights[f"{name}.weight"], self.weights[f"{name}.bias"]
        return torch.addmm(bias[row], x, weight[row])

    def _by_net(self, points: torch.Tensor) -> Iterator[tuple[int, torch.Tensor, torch.Tensor]]:
        """Yield each net's row, the indices of its points, and their positions in its cell, -1 to 1."""
        cell = self._cell_of(points)
        place = torch.stack(torch.unravel_index(cell, self.grid), 1) * self._cell
        local = 2 * (points - self._low - place) / self._cell - 1
        order = torch.argsort(cell, stable=True)
        found, counts = torch.unique_consecutive(cell[order], return_counts=True)
        for number, index in zip(found.tolist(), order.split(counts.tolist())):
            yield int(self._row[number]), index, local[index]

    def _cell_of(self, points: torch.Tensor) -> torch.Tensor:
        return _index((points - self._low) / self._cell, self.grid)

    def _check(self) -> None:
        low, high = np.array(self.box, np.float64).reshape(2, 3)
        if not (np.isfinite([low, high]).all() and (low < high).all()):
            raise ValueError(f"box {self.box}, expected finite corners, the lowest first")
        for name, sizes, limit in (("cells", self.grid, MAX_CELLS), ("voxels", self.voxels, 1 << 30)):
            if len(sizes) != 3 or min(sizes) < 1 or math.prod(sizes) > limit:
                raise ValueError(f"{name} {sizes}")
        count = len(self.cells)
        if count and (self.cells.min() < 0 or self.cells.max() >= math.prod(self.grid)):
            raise ValueError("cells outside the grid")
        if self.voxel_mask.numel() != math.prod(self.voxels):
            raise ValueError(f"{self.voxel_mask.numel()} voxels, expected {math.prod(self.voxels)}")
        width = self.weights["density.weight"].shape[1]
        point, view, light = (3 * (1 + 2 * n) for n in self.octaves)
        branch = self.weights["color.weight"].shape[1]
        shapes = {"density": (width, 1), "feature": (width, width), "color": (branch, 3)}
        shapes["direction"] = (width + view + light, branch)
        for layer in itertools.count():
            if f"points.{layer}.weight" not in self.weights:
                break
            shapes[f"points.{layer}"] = (width if layer else point, width)
        for name, size in shapes.items():
            found = self.weights[f"{name}.weight"].shape, self.weights[f"{name}.bias"].shape
            if tuple(map(tuple, found)) != ((count, *size), (count, size[1])):
                raise ValueError(f"{name} of shapes {found}, expected {count} of {size}")
        if "points.0.weight" not in self.weights:
            raise ValueError("no layers")

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors and configuration for storing."""
        tensors = {name: value.cpu().numpy() for name, value in self.weights.items()}
        tensors["cells"] = self.cells.numpy().astype(np.int32)
        tensors["occupied"] = np.packbits(self.voxel_mask.cpu().numpy())
        sizes = {name: list(getattr(self, name)) for name in ("grid", "voxels", "octaves")}
        return tensors, {**asdict(self.march), **sizes, "box": self.box}

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "ReleasedKilo":
        """Invert `to_tensors`."""
        config, tensors = dict(config), dict(tensors)
        grid, voxels, octaves = (tuple(map(int, config.pop(n))) for n in ("grid", "voxels", "octaves"))
        box = config.pop("box")
        cells = torch.from_numpy(np.array(tensors.pop("cells"), np.int64))
        packed, count = np.asarray(tensors.pop("occupied")), math.prod(voxels)
        if len(packed) != (count + 7) // 8:
            raise ValueError(f"{len(packed)} bytes of voxels {voxels}")
        occupied = torch.from_numpy(np.unpackbits(packed, count=count).astype(bool))
        return cls(float_tensors(tensors), cells, occupied, March(**config), grid, voxels, box, octaves)


def _index(place: torch.Tensor, sizes: tuple[int, ...]) -> torch.Tensor:
    """Return the row-major index of the cell of (N, 3) positions, in units of cells; (N,)."""
    cell = torch.minimum(place.long().clamp(min=0), torch.tensor(sizes, device=place.device) - 1)
    return (cell[:, 0] * sizes[1] + cell[:, 1]) * sizes[2] + cell[:, 2]
