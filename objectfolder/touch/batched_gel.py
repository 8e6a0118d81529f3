"""Gels of many sensors at once, as tensors on any device: `gel`, `tangential` and `dragged` for a batch.

The iterations are theirs, with the same steps and tolerances, so that the answers agree with those of single
presses to these tolerances. A row that has converged stays as it is. On a GPU all rows take a fixed number of
steps, so that nothing waits for the device; on a CPU, rows leave the batch as they converge.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.fft loads at first use
import torch
from torch.nn.functional import grid_sample

from objectfolder.touch.camera import gel_depth, pixel_area
from objectfolder.touch.dragged import ROUNDS, rest_surface
from objectfolder.touch.gel import (
    CONTACT_TOLERANCE,
    FIRST_STEP,
    GAP,
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
from objectfolder.touch.tangential import (
    MAX_GRID_SIDE,
    SLIP_TOLERANCE,
    coarse_grid,
    gel_places,
    unit_waves,
    wave_compliances,
    wave_spreading,
)

#: Steps on a GPU of a contact on each coarser grid, on the finest, from a warm start, and of a slip: half as
#: many again as the most that any of 500 contacts of 11 objects took.
COARSE_STEPS, FINE_STEPS, WARM_STEPS, SLIP_STEPS = 10, 12, 14, 48

CPU_STEPS = 400  #: at most of each on a CPU; typically tens suffice
_CPU_ROWS = 16  # that are solved together on a CPU, to stay in its caches

_NEVER = -1.0  # m, height of what is out of reach: never met

_FULL_SLIP = 0.999  # part of the friction from which a pixel counts as slipping, as in `shear_contacts`


@dataclass(frozen=True)
class Slips:
    """What friction does to B gels; vectors are along image right and image up."""

    sideways: torch.Tensor  #: (B, 2, H, W) m, displacement of the surface, by pressure and friction
    dragged: torch.Tensor  #: (B, 2, H, W) m, the part of it that is by friction
    traction: torch.Tensor  #: (B, 2, H, W) Pa, of the object on the gel
    slipping: torch.Tensor  #: (B,) part of the contact that slips
    residual: torch.Tensor  #: (B,) last step, relative to where one counts as converged: at most 1


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


class _Leaving:
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
        self._early = device.type == "cpu"  # whether rows may leave the batch
        shape, pitch = (profile.height, profile.width), profile.pixel_pitch
        self.area, self._depth = self._tensor(pixel_area(profile)), self._tensor(gel_depth(profile))
        self._moments = self._tensor(_moments(profile))
        self.soft = profile.gel == "soft"
        if self.soft:
            self._grids = [Waves(shape, pitch, profile, device)]
            while min(self._grids[-1].shape) >= 2 * MIN_GRID_SIDE:
                finer = self._grids[-1]
                coarser: tuple[int, ...] = tuple((side + 1) // 2 for side in finer.shape)
                self._grids.append(Waves(coarser, 2 * finer.pitch, profile, device))
            self._prepare_slips(shape, pitch)
        self._prepare_markers()

    def _tensor(self, values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.array(values, np.float32)).to(self.device)

    def _prepare_slips(self, shape: tuple[int, ...], pitch: float) -> None:
        layer, self._halved = layer_of(self.profile), []
        while min(shape) >= MAX_GRID_SIDE:
            self._halved.append(shape)
            shape, pitch = tuple((side + 1) // 2 for side in shape), 2 * pitch
        self._slip = Waves(shape, pitch, self.profile, self.device)
        whole = self._slip.size
        fast = (scipy.fft.next_fast_len(2 * part - 1, real=True) for part in shape)
        rows, columns = self._slip_size = tuple(map(min, whole, fast))
        self._slip_compliances = [
            self._tensor(v) for v in wave_compliances(rows, columns, whole, pitch, layer)
        ]
        right, up = (self._tensor(v) for v in unit_waves(*whole, pitch))
        spread = torch.from_numpy(wave_spreading(*whole, pitch, layer)).to(self.device)
        self._spreading = torch.stack([right * spread, up * spread])
        image = self.profile.height, self.profile.width
        across, upwards = coarse_grid(shape, pitch, image, self.profile.pixel_pitch)
        self._turning = self._tensor(np.stack(np.broadcast_arrays(-upwards, across)))
        sag, axes = rest_surface(self.profile)
        self._sag, self._axes = self._tensor(sag), self._tensor(axes)
        rows_columns = np.indices(shape, np.float32) - (np.array(shape)[:, None, None] - 1) / 2
        self._coarse_axes = self._tensor(rows_columns)

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
        self._weights = self._tensor(np.stack(weights))
        centre = np.array([(profile.width - 1) / 2, (profile.height - 1) / 2])
        self._from_axis = self._tensor(places - centre)
        self._focal = profile.camera_to_gel / profile.pixel_pitch

    # contact

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
        parts = [
            self._indent(part, None if start is None else start[rows])
            for rows, part in zip(self._parts(len(height)), height.split(self._rows(len(height))))
        ]
        displacement, pressure, residual = (torch.cat(of) for of in zip(*parts))
        return displacement, pressure, residual

    def _rows(self, count: int) -> int:
        return _CPU_ROWS if self._early else max(count, 1)

    def _parts(self, count: int) -> list[slice]:
        size = self._rows(count)
        return [slice(first, first + size) for first in range(0, max(count, 1), size)]

    def _indent(
        self, height: torch.Tensor, start: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
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
        rows = _Leaving((pressure, moved, tolerance), self._early)
        steps = CPU_STEPS if self._early else steps
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
            work = _products(changed, moved - before_moved)
            optimal = (-step * _products(changed, residual) / work).clamp(*STEP_BOUNDS)
            step = torch.where(work > 0, optimal, step)
        pressure, moved, error = rows.joined((pressure, moved, error))
        return pressure, moved, error / torch.where(unit > 0, unit, 1.0)

    # friction

    def slip(
        self, pressure: torch.Tensor, shear: torch.Tensor, twist: torch.Tensor, friction: torch.Tensor
    ) -> Slips:
        """Return what `tangential.shear_contacts` does; shears (B, 2), twists and frictions (B,)."""
        parts = [
            self._slip_part(pressure[rows], shear[rows], twist[rows], friction[rows])
            for rows in self._parts(len(pressure))
        ]
        found = (torch.cat([getattr(part, name) for part in parts]) for name in Slips.__dataclass_fields__)
        return Slips(*found)

    def _slip_part(
        self, pressure: torch.Tensor, shear: torch.Tensor, twist: torch.Tensor, friction: torch.Tensor
    ) -> Slips:
        image = pressure
        for _ in self._halved:
            image = halve(image)
        half = (twist / 2)[:, None, None, None]
        turned = 2 * torch.sin(half) * self._turning
        motion = shear[:, :, None, None] + turned
        bound = friction[:, None, None] * image
        found, residual = self._slide(image, motion, bound)
        followed = self._follow(found)
        inwards = (torch.cos(half) - 1) * turned + torch.sin(half) * torch.stack(
            [-turned[:, 1], turned[:, 0]], 1
        )
        share = (followed * motion).sum(1, keepdim=True) / (motion**2).sum(1, keepdim=True).clamp(min=1e-20)
        followed = followed + share.clamp(0, 1) * inwards
        sideways = followed + self._spread(image)
        in_contact = image > 0
        slips = in_contact & (torch.hypot(*found.unbind(1)) >= _FULL_SLIP * bound)
        slips = slips & (torch.hypot(*motion.unbind(1)).amax((1, 2)) > 0)[:, None, None]
        slipping = slips.sum((1, 2)) / in_contact.sum((1, 2)).clamp(min=1)
        fine = [self._refined(of) for of in (sideways, followed, found)]
        pressed = self._refined(image)
        fine[2] = fine[2] * (pressure / torch.where(pressed > 0, pressed, 1.0))[:, None]
        return Slips(*fine, slipping, residual)

    def spread(self, pressure: torch.Tensor) -> torch.Tensor:
        """Return how far presses alone move the surface sideways, (B, 2, H, W), metres; 0 of a rigid gel."""
        if not self.soft:
            return torch.zeros_like(pressure[:, None]).repeat(1, 2, 1, 1)
        image = pressure
        for _ in self._halved:
            image = halve(image)
        return self._refined(self._spread(image))

    def _spread(self, image: torch.Tensor) -> torch.Tensor:
        return self._slip.filtered(image[:, None], lambda waves: waves * self._spreading)

    def _follow(self, traction: torch.Tensor) -> torch.Tensor:
        right, mixed, up = self._slip_compliances

        def answer(waves: torch.Tensor) -> torch.Tensor:
            a, b = waves.unbind(1)
            return torch.stack([right * a + mixed * b, mixed * a + up * b], 1)

        return self._slip.filtered(traction, answer, self._slip_size)

    def _refined(self, image: torch.Tensor) -> torch.Tensor:
        for shape in reversed(self._halved):
            image = double(image, shape)
        return image

    def _slide(
        self, pressure: torch.Tensor, motion: torch.Tensor, bound: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return tractions, as `tangential.slide`, and their residuals."""
        inside = ((pressure > 0) & (bound > 0))[:, None]
        wanted = motion * inside
        goal = SLIP_TOLERANCE * motion.abs().amax((1, 2, 3))
        work = (wanted * self._follow(wanted)).sum((1, 2, 3))
        step = torch.where(work > 0, (wanted**2).sum((1, 2, 3)) / torch.where(work > 0, work, 1.0), 0.0)
        least = step / 50
        found, residual = torch.zeros_like(wanted), -wanted
        error = torch.zeros_like(step)
        rows = _Leaving((found, error), self._early)
        for _ in range(CPU_STEPS if self._early else SLIP_STEPS):
            after = _bounded(found - step[:, None, None, None] * residual, bound)
            changed, limit = after - found, goal * step
            error = torch.linalg.vector_norm(changed, math.inf, (1, 2, 3)) / torch.where(
                limit > 0, limit, 1.0
            )
            settled = error <= 1
            if rows.all_settled(settled):
                break
            every = found, residual, after, changed, step, least, bound, wanted, inside, goal, error, settled
            found, residual, after, changed, step, least, bound, wanted, inside, goal, error, settled = (
                rows.go_on(settled, (found, error), every)
            )
            gradient = (self._follow(after) - wanted) * inside
            curvature, squares = _products(changed, gradient - residual), _products(changed, changed)
            better = torch.maximum(squares / torch.where(curvature > 0, curvature, 1.0), least)
            step = torch.where((curvature > 0) & ~settled, better, step)
            moving = ~settled[:, None, None, None]
            found = torch.where(moving, after, found)
            residual = torch.where(moving, gradient, residual)
        found, error = rows.joined((found, error))
        return found, error

    # motion

    def drag(
        self, height: torch.Tensor, pressure: torch.Tensor, dragged: torch.Tensor, shear: torch.Tensor,
        twist: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # fmt: skip
        """Return what `dragged.dragged_contacts` does; ``dragged`` is (B, 2, H, W)."""
        parts = [
            self._drag_part(height[rows], pressure[rows], dragged[rows], shear[rows], twist[rows])
            for rows in self._parts(len(height))
        ]
        moved, seen, pressed = (torch.cat(of) for of in zip(*parts))
        return moved, seen, pressed

    def _drag_part(
        self, height: torch.Tensor, pressure: torch.Tensor, dragged: torch.Tensor, shear: torch.Tensor,
        twist: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # fmt: skip
        shift, step = self._in_pixels(dragged), self._in_pixels(shear[:, :, None, None])
        moved = self._met(height, _turned_back(self._axes - step, twist))
        met = self._met(height, _turned_back(self._axes + shift - step, twist))
        at_points, pressed, _ = self._indent(met, pressure)
        source = self._axes - self._carried(shift)
        seen = _at(at_points - self._sag, source) + self._sag
        return moved, seen.clamp(max=self.profile.max_indentation), _nearest(pressed, source)

    def _in_pixels(self, motion: torch.Tensor) -> torch.Tensor:
        """Return motions (B, 2, ...), right and up, along rows and columns, pixels."""
        return torch.stack([-motion[:, 1], motion[:, 0]], 1) / self.profile.pixel_pitch

    def _met(self, height: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        met = (_at(height - self._sag, places) + self._sag).clamp(max=self.profile.max_indentation)
        thickness = self.profile.elastomer_thickness
        lowest = -GAP * thickness
        gone = ~within_reach(_nearest(height, places), thickness) | (met < lowest)
        return torch.where(gone, lowest, met)

    def _carried(self, shift: torch.Tensor) -> torch.Tensor:
        coarse = shift
        for _ in self._halved:
            coarse = halve(coarse)
        carried, step = coarse, 2 ** len(self._halved)
        for _ in range(ROUNDS):
            carried = _at(coarse, self._coarse_axes - carried / step)
        return self._refined(carried)

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
        return sum(
            (part.flatten(1) @ to for part, to in zip(parts, self._moments)), torch.zeros(6).to(pressure)
        )


def _moments(profile: SensorProfile) -> np.ndarray:
    """Return force and torque by unit stresses of pixels towards the camera, right and up; (3, H W, 6)."""
    right, up = gel_places(profile)
    lever = np.stack([profile.camera_to_gel - gel_depth(profile), right, up])  # from the apex
    force = np.eye(3)[:, :, None, None] * np.ones_like(right)
    torque = np.cross(lever[None], force, axis=1)
    found = np.concatenate([force, torque], 1) * pixel_area(profile)
    return found.reshape(3, 6, -1).swapaxes(1, 2)


def _products(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the inner products (B,) of rows."""
    return torch.bmm(a.flatten(1)[:, None], b.flatten(1)[:, :, None])[:, 0, 0]


def _bounded(traction: torch.Tensor, bound: torch.Tensor) -> torch.Tensor:
    length = (traction[:, 0] ** 2 + traction[:, 1] ** 2).sqrt()
    return traction * (bound / torch.maximum(length, bound.clamp(min=1e-12)))[:, None]


def _turned_back(places: torch.Tensor, twist: torch.Tensor) -> torch.Tensor:
    """Turn rows and columns (B, 2, H, W) from the centre clockwise in the image."""
    cos, sin = torch.cos(twist)[:, None, None], torch.sin(twist)[:, None, None]
    rows, columns = places.unbind(1)
    return torch.stack([cos * rows + sin * columns, cos * columns - sin * rows], 1)


def _at(images: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
    """Interpolate images (B, ..., H, W) at rows and columns (B, 2, H, W) from the centre, pixels."""
    height, width = images.shape[-2:]
    of = images.reshape(len(images), -1, height, width).double()
    rows, columns = places.double().unbind(1)
    at = torch.stack([columns * (2 / (width - 1)), rows * (2 / (height - 1))], -1)
    found = grid_sample(of, at.expand(len(images), -1, -1, -1), padding_mode="border", align_corners=True)
    return found.float().reshape(images.shape)


def _nearest(images: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
    """Return the pixels (B, H, W) nearest to rows and columns (B, 2, H, W) from the centre."""
    height, width = images.shape[-2:]
    rows, columns = places.unbind(1)
    row = (rows + (height - 1) / 2).round().long().clamp(0, height - 1)
    column = (columns + (width - 1) / 2).round().long().clamp(0, width - 1)
    return images.flatten(1).gather(1, (row * width + column).flatten(1)).view(images.shape)
