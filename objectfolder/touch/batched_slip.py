"""Friction on many gels at once, as tensors on any device."""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.fft loads at first use
import torch
from torch.nn.functional import grid_sample

from objectfolder.touch.batched_gel import CPU_STEPS, GelBatch, LeavingRows, Waves, row_products
from objectfolder.touch.dragged import ROUNDS, rest_surface
from objectfolder.touch.gel import GAP, double, halve, layer_of, within_reach
from objectfolder.touch.tangential import (
    MAX_GRID_SIDE,
    SLIP_TOLERANCE,
    coarse_grid,
    unit_waves,
    wave_compliances,
    wave_spreading,
)

SLIP_STEPS = 48  #: on a GPU; half as many again as the most that 500 contacts of 11 objects took
_FULL_SLIP = 0.999  # part of the friction from which a pixel counts as slipping, as in `shear_contacts`


@dataclass(frozen=True)
class Slips:
    """What friction does to B gels; vectors are along image right and image up."""

    sideways: torch.Tensor  #: (B, 2, H, W) m, displacement of the surface, by pressure and friction
    dragged: torch.Tensor  #: (B, 2, H, W) m, the part of it that is by friction
    traction: torch.Tensor  #: (B, 2, H, W) Pa, of the object on the gel
    slipping: torch.Tensor  #: (B,) part of the contact that slips
    residual: torch.Tensor  #: (B,) last step, relative to where one counts as converged: at most 1


class SlipBatch:
    """Friction on the soft gels of a batch, whose images are (B, H, W) float32 on its device."""

    def __init__(self, gel: GelBatch):
        self._gel, self.profile = gel, gel.profile
        self._halved: list[tuple[int, ...]] = []
        layer, pitch = layer_of(self.profile), self.profile.pixel_pitch
        shape: tuple[int, ...] = (self.profile.height, self.profile.width)
        while min(shape) >= MAX_GRID_SIDE:
            self._halved.append(shape)
            shape, pitch = tuple((side + 1) // 2 for side in shape), 2 * pitch
        self._slip = Waves(shape, pitch, self.profile, gel.device)
        whole = self._slip.size
        fast = (scipy.fft.next_fast_len(2 * part - 1, real=True) for part in shape)
        rows, columns = self._slip_size = tuple(map(min, whole, fast))
        self._slip_compliances = [gel.tensor(v) for v in wave_compliances(rows, columns, whole, pitch, layer)]
        right, up = (gel.tensor(v) for v in unit_waves(*whole, pitch))
        spread = torch.from_numpy(wave_spreading(*whole, pitch, layer)).to(gel.device)
        self._spreading = torch.stack([right * spread, up * spread])
        image = self.profile.height, self.profile.width
        across, upwards = coarse_grid(shape, pitch, image, self.profile.pixel_pitch)
        self._turning = gel.tensor(np.stack(np.broadcast_arrays(-upwards, across)))
        sag, axes = rest_surface(self.profile)
        self._sag, self._axes = gel.tensor(sag), gel.tensor(axes)
        rows_columns = np.indices(shape, np.float32) - (np.array(shape)[:, None, None] - 1) / 2
        self._coarse_axes = gel.tensor(rows_columns)

    def slip(
        self, pressure: torch.Tensor, shear: torch.Tensor, twist: torch.Tensor, friction: torch.Tensor
    ) -> Slips:
        """Return what `tangential.shear_contacts` does; shears (B, 2), twists and frictions (B,)."""
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
        pressed = self._refined(image)
        traction = self._refined(found) * (pressure / torch.where(pressed > 0, pressed, 1.0))[:, None]
        return Slips(self._refined(sideways), self._refined(followed), traction, slipping, residual)

    def spread(self, pressure: torch.Tensor) -> torch.Tensor:
        """Return how far presses alone move the surface sideways, (B, 2, H, W), metres."""
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
        rows = LeavingRows((found, error), self._gel.early)
        for _ in range(CPU_STEPS if self._gel.early else SLIP_STEPS):
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
            curvature, squares = row_products(changed, gradient - residual), row_products(changed, changed)
            better = torch.maximum(squares / torch.where(curvature > 0, curvature, 1.0), least)
            step = torch.where((curvature > 0) & ~settled, better, step)
            moving = ~settled[:, None, None, None]
            found = torch.where(moving, after, found)
            residual = torch.where(moving, gradient, residual)
        found, error = rows.joined((found, error))
        return found, error

    def drag(
        self, height: torch.Tensor, pressure: torch.Tensor, dragged: torch.Tensor, shear: torch.Tensor,
        twist: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # fmt: skip
        """Return what `dragged.dragged_contacts` does; ``dragged`` is (B, 2, H, W)."""
        shift, step = self._in_pixels(dragged), self._in_pixels(shear[:, :, None, None])
        moved = self._met(height, _turned_back(self._axes - step, twist))
        met = self._met(height, _turned_back(self._axes + shift - step, twist))
        at_points, pressed, _ = self._gel.press(met, pressure)
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
