"""Gels of many sensors at once, as tensors on any device.

The iteration is that of single presses, with the same steps and tolerances, so that the answers agree
to these tolerances. A row that has converged stays as it is. On a GPU all rows take a fixed number of
steps, so that nothing waits for the device; on a CPU, rows leave the batch as they converge.
"""

import math
from collections.abc import Callable

import numpy as np
import scipy  # scipy.fft loads at first use
import torch

from objectfolder.touch.camera import gel_depth, pixel_area
from objectfolder.touch.gel import (
    CONTACT_TOLERANCE,
    FIRST_STEP,
    MIN_GRID_SIDE,
    SPACING,
    STEP_BOUNDS,
    double,
    halve,
    layer_of,
    period,
    precondition,
    within_reach,
)
from objectfolder.touch.markers import Markers
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.tangential import gel_places

#: Steps on a GPU of a contact on each coarser grid, on the finest, and from a warm start: half as many again
#: as the most that any of 500 contacts of 11 objects took.
COARSE_STEPS, FINE_STEPS, WARM_STEPS = 10, 12, 14

CPU_STEPS = 400  #: at most of each on a CPU; typically tens suffice

_NEVER = -1.0  # m, height of what is out of reach: never met


class Waves:
    """Response of a layer to images (..., h, w) of a pitch, by Fourier transforms."""

    def __init__(self, shape: tuple[int, ...], pitch: float, profile: SensorProfile, device: torch.device):
        layer = layer_of(profile)
        self.shape, self.pitch, self.layer = shape, pitch, layer
        self.size = period(shape, round(SPACING * layer.thickness / pitch))
        along_rows, along_columns = (
            scipy.fft.fftfreq(self.size[0], pitch),
            scipy.fft.rfftfreq(self.size[1], pitch),
        )
        compliance = layer.compliance(2 * np.pi * np.hypot(along_rows[:, None], along_columns))
        self._compliance = torch.from_numpy(compliance.astype(np.float32)).to(device)

    def respond(self, pressure: torch.Tensor) -> torch.Tensor:
        """Return the displacement of the surface, metres, under a pressure, Pa, as `gel.respond`."""
        return self.filtered(pressure, lambda waves: waves * self._compliance)

    def filtered(
        self, images: torch.Tensor, answer: Callable[[torch.Tensor], torch.Tensor],
        size: tuple[int, ...] | None = None,
    ) -> torch.Tensor:  # fmt: skip
        """Return the inverse transform of what an answer makes of the transform."""
        size = size or self.size
        waves = answer(torch.fft.rfft2(images, size))
        return torch.fft.irfft2(waves, size)[..., : self.shape[0], : self.shape[1]]


class LeavingRows:
    """Rows of a batch that leave an iteration as they settle, if this costs no wait for a device."""

    def __init__(self, like: tuple[torch.Tensor, ...], early: bool):
        self._early = early
        if early:
            self._answers = tuple(torch.empty_like(values) for values in like)
            self._left = torch.arange(len(like[0]))

    def all_settled(self, settled: torch.Tensor) -> bool:
        """Return whether the iteration can end; False where nobody may look."""
        return self._early and bool(settled.all())

    def go_on(
        self, settled: torch.Tensor, answers: tuple[torch.Tensor, ...], every: tuple[torch.Tensor, ...]
    ) -> tuple[torch.Tensor, ...]:
        """Keep the answers of settled rows; return everything of the other rows."""
        if not self._early or not settled.any():
            return every
        for to, of in zip(self._answers, answers):
            to[self._left[settled]] = of[settled]
        kept = ~settled
        self._left = self._left[kept]
        return tuple(of[kept] for of in every)

    def joined(self, answers: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
        """Return the answers of all rows, in their order."""
        if not self._early:
            return answers
        for to, of in zip(self._answers, answers):
            to[self._left] = of
        return self._answers


class GelBatch:
    """Soft or rigid gels of B sensors of one profile; what does not change between batches is on the device.

    Images are (B, H, W) float32 tensors on the device. Markers are the default ones, at ``markers`` (M, 2),
    columns and rows.
    """

    def __init__(self, profile: SensorProfile, device: torch.device):
        self.profile, self.device = profile, device
        self.early = device.type == "cpu"  #: whether rows may leave the batch
        shape, pitch = (profile.height, profile.width), profile.pixel_pitch
        self.area, self._depth = self.tensor(pixel_area(profile)), self.tensor(gel_depth(profile))
        self._moments = self.tensor(_moments(profile))
        self.soft = profile.gel == "soft"
        if self.soft:
            self._grids = [Waves(shape, pitch, profile, device)]
            while min(self._grids[-1].shape) >= 2 * MIN_GRID_SIDE:
                finer = self._grids[-1]
                coarser: tuple[int, ...] = tuple((side + 1) // 2 for side in finer.shape)
                self._grids.append(Waves(coarser, 2 * finer.pitch, profile, device))
        self._prepare_markers()

    def tensor(self, values: np.ndarray) -> torch.Tensor:
        """Return values as float32 on the device."""
        return torch.from_numpy(np.array(values, np.float32)).to(self.device)

    def _prepare_markers(self) -> None:
        profile = self.profile
        places = Markers().places(profile)
        self.markers = torch.from_numpy(places).to(self.device)
        columns, rows = places.T
        limits = profile.width - 2, profile.height - 2
        first = [np.floor(v).clip(0, most).astype(np.int64) for v, most in zip((columns, rows), limits)]
        share = columns - first[0], rows - first[1]
        corners, weights = [], []
        for down in (0, 1):
            for across in (0, 1):
                corners.append((first[1] + down) * profile.width + first[0] + across)
                by = (share[1] if down else 1 - share[1]) * (share[0] if across else 1 - share[0])
                weights.append(by)
        self._corners = torch.from_numpy(np.stack(corners)).to(self.device)
        self._weights = self.tensor(np.stack(weights))
        centre = np.array([(profile.width - 1) / 2, (profile.height - 1) / 2])
        self._from_axis = self.tensor(places - centre)
        self._focal = profile.camera_to_gel / profile.pixel_pitch

    def press(
        self, height: torch.Tensor, start: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return what `gel.deform` does of heights: displacements, metres, and pressures, Pa; and residuals.

        A residual (B,) is the greatest gap under pressure or overlap without, relative to what is tolerated:
        at most 1 once converged. ``start`` is the pressure of similar contacts.
        """
        if not self.soft:
            none = torch.full_like(height, math.nan)
            return height.clamp(min=0), none, torch.zeros_like(height[:, 0, 0])
        reachable = within_reach(height, self.profile.elastomer_thickness)
        met = (height.amax((1, 2)) > 0)[:, None, None]
        if start is None:
            pressure, moved, residual = self._solve(height, reachable & met, 0)
        else:
            pressure = torch.where(met, start, 0.0) * reachable
            pressure, moved, residual = self._descend(pressure, height, reachable & met, 0, WARM_STEPS)
        touching = ((pressure > 0) | (moved < height)) & reachable & met
        return torch.where(touching, height, moved), pressure, residual

    def _solve(
        self, height: torch.Tensor, reachable: torch.Tensor, level: int
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return pressure, displacement and residual on a grid, from a solution on the next coarser one."""
        steps = COARSE_STEPS if level else FINE_STEPS
        if level + 1 == len(self._grids):
            return self._descend(torch.zeros_like(height), height, reachable, level, COARSE_STEPS)
        pressure, _, _ = self._solve(halve(height), halve(reachable) > 0, level + 1)
        pressure = double(pressure, height.shape[1:]) * reachable
        return self._descend(pressure, height, reachable, level, steps)

    def _descend(
        self, pressure: torch.Tensor, height: torch.Tensor, reachable: torch.Tensor, level: int, steps: int
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Take steps of `gel.indent` from a pressure; a converged row has steps of 0."""
        grid = self._grids[level]
        tolerance = unit = CONTACT_TOLERANCE * height.amax((1, 2)).clamp(min=0)
        step, moved = torch.full_like(tolerance, FIRST_STEP), grid.respond(pressure)
        height = torch.where(reachable, height, _NEVER)
        rows = LeavingRows((pressure, moved, tolerance), self.early)
        steps = CPU_STEPS if self.early else steps
        for taken in range(steps + 1):
            gap = moved - height
            touching = (pressure > 0) | (gap < 0)
            residual = torch.where(touching, gap, 0.0)
            error = torch.linalg.vector_norm(residual, math.inf, (1, 2))
            settled = error <= tolerance
            if taken == steps or rows.all_settled(settled):
                break
            step = torch.where(settled, 0.0, step)
            every = pressure, moved, height, step, tolerance, residual, touching
            pressure, moved, height, step, tolerance, residual, touching = rows.go_on(
                settled, (pressure, moved, error), every
            )
            after = precondition(residual, grid.pitch, grid.layer)
            after *= touching
            after *= -step[:, None, None]
            after += pressure
            before, pressure = pressure, after.clamp_(min=0)
            changed, before_moved, moved = pressure - before, moved, grid.respond(pressure)
            work = row_products(changed, moved - before_moved)
            optimal = (-step * row_products(changed, residual) / work).clamp(*STEP_BOUNDS)
            step = torch.where(work > 0, optimal, step)
        pressure, moved, error = rows.joined((pressure, moved, error))
        return pressure, moved, error / torch.where(unit > 0, unit, 1.0)

    def flow(self, sideways: torch.Tensor, displacement: torch.Tensor) -> torch.Tensor:
        """Return what `markers.marker_flow` does; (B, M, 2) pixels, of ``sideways`` (B, 2, H, W)."""
        images = torch.stack([sideways[:, 0], sideways[:, 1], displacement], 1).flatten(2)
        right, up, nearer = (images[:, :, self._corners] * self._weights).sum(2).unbind(1)
        depth = (self._depth.flatten()[self._corners] * self._weights).sum(0)
        moved = self._from_axis * depth[:, None] + self._focal * torch.stack([right, -up], 2)
        return moved / (depth - nearer)[..., None] - self._from_axis

    def wrench(self, pressure: torch.Tensor, traction: torch.Tensor | None) -> torch.Tensor:
        """Return forces, N, and torques about the apex, N m, on the gel; (B, 6), see `BatchedTouches`."""
        parts = [pressure] if traction is None else [pressure, *traction.unbind(1)]
        return sum((part.flatten(1) @ to for part, to in zip(parts, self._moments)), pressure.new_zeros(6))


def _moments(profile: SensorProfile) -> np.ndarray:
    """Return force and torque by unit stresses of pixels towards the camera, right and up; (3, H W, 6)."""
    right, up = gel_places(profile)
    lever = np.stack([profile.camera_to_gel - gel_depth(profile), right, up])  # from the apex
    force = np.eye(3)[:, :, None, None] * np.ones_like(right)
    torque = np.cross(lever[None], force, axis=1)
    found = np.concatenate([force, torque], 1) * pixel_area(profile)
    return found.reshape(3, 6, -1).swapaxes(1, 2)


def row_products(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the inner products (B,) of rows."""
    return torch.bmm(a.flatten(1)[:, None], b.flatten(1)[:, :, None])[:, 0, 0]
