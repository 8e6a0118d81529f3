"""Presses of many sensors on many objects at once, on one device."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.touch.batched_gel import GelBatch
from objectfolder.touch.batched_rays import EmbreeHeights, HeightCaster, WarpHeights
from objectfolder.touch.batched_slip import SlipBatch
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.simulate import Touches, measured_contacts

_CPU_ROWS = 16  # that are pressed together on a CPU, to stay in its caches
_GPU_ROWS = 256  # whose answers are copied to the host together


@dataclass(frozen=True)
class BatchedTouches:
    """What B sensors feel: tensors on the device of the sensors, float32 if not stated otherwise.

    ``images``, ``height``, ``displacement`` and ``pressure`` are those after the object's motion, as the
    camera sees them; all others belong to the press, or to the motion. Vectors are along image right and
    image up.
    """

    images: torch.Tensor  #: (B, H, W, 3) uint8, RGB
    height: torch.Tensor  #: (B, H, W) m, of the object past the undeformed gel; negative is a gap
    displacement: torch.Tensor  #: (B, H, W) m, of the gel towards the camera; negative bulges
    pressure: torch.Tensor  #: (B, H, W) Pa; NaN for a rigid gel
    #: (B, 6) N and N m, of the object on the gel: force towards the camera, right and up, then the torque
    #: about these axes through the gel's apex; NaN for a rigid gel
    wrench: torch.Tensor
    area: torch.Tensor  #: (B,) m², in contact
    obstructed: torch.Tensor  #: (B,) part of the pixels that the object blocks; see `heightmaps`
    marker_flow: torch.Tensor  #: (B, M, 2) pixels, columns and rows
    slipping: torch.Tensor  #: (B,) part of the contact that slips
    #: (B, 2) how far contact and friction are from converged, in units of their tolerances: at most 1
    residual: torch.Tensor
    pressed: torch.Tensor  #: (B, H, W) Pa, pressure of the press: the start of the next press of the same row


class BatchedPress:
    """Sensors of one profile on a device, which press some surfaces.

    The background (H, W, 3) uint8 is the image of the untouched sensor; default: that of the profile. Raises
    ObjectFolderError if the device is no CPU and Warp is not installed.
    """

    def __init__(
        self, surfaces: Sequence[Isosurface], profile: SensorProfile, device: torch.device,
        background: torch.Tensor | None = None,
    ):  # fmt: skip
        self.profile, self.device = profile, device
        self.heights: HeightCaster = (
            EmbreeHeights(surfaces, profile)
            if device.type == "cpu"
            else WarpHeights(surfaces, profile, device)
        )
        self.gel, self.optics = GelBatch(profile, device), Optics(profile, device)
        self.friction = SlipBatch(self.gel) if self.gel.soft else None
        if background is not None:
            self.optics.background = background

    def touches(
        self, points: np.ndarray, frames: np.ndarray, depths: np.ndarray, scale: float
    ) -> Iterator[Touches]:
        """Yield what contacts with the first surface feel, in batches.

        Contact points (N, 3), m, object frame; the sensors' `sensor_frames`; depths (N,), m; and the longest
        side of the object, m.
        """
        for start in range(0, len(points), _GPU_ROWS):
            part = slice(start, start + _GPU_ROWS)
            where, axes, deep = (torch.from_numpy(v[part]).to(self.device) for v in (points, frames, depths))
            which = torch.zeros(len(where), dtype=torch.int64, device=self.device)
            found = self.press(which, where, axes, deep, torch.full_like(deep, scale))
            height, moved, pressure, images = (
                of.cpu().numpy() for of in (found.height, found.displacement, found.pressure, found.images)
            )
            obstructed = found.obstructed.double().cpu().numpy()
            contacts = measured_contacts(height, moved, pressure, obstructed, self.profile)
            yield Touches(**vars(contacts), images=images, profile=self.profile)

    def press(
        self, which: torch.Tensor, points: torch.Tensor, frames: torch.Tensor, depths: torch.Tensor,
        scales: torch.Tensor, motion: tuple[torch.Tensor, torch.Tensor, torch.Tensor] | None = None,
        start: torch.Tensor | None = None,
    ) -> BatchedTouches:  # fmt: skip
        """Press, then move the objects by a shear (B, 2), a twist (B,) under a friction (B,), if given.

        Other parameters are those of `HeightCaster.cast_heights`; start is that of `GelBatch.press`. Nothing
        is checked, and on a GPU nothing waits for the device.
        """
        given = [which, points, frames, depths, scales, *(motion or (None,) * 3), start]
        size = _CPU_ROWS if self.device.type == "cpu" else max(len(which), 1)
        first = range(0, max(len(which), 1), size)
        groups = [[None if of is None else of[k : k + size] for of in given] for k in first]
        parts = [self._press_group(*group) for group in groups]  # type: ignore[arg-type]
        if len(parts) == 1:
            return parts[0]
        names = [field.name for field in fields(BatchedTouches)]
        return BatchedTouches(**{name: torch.cat([getattr(of, name) for of in parts]) for name in names})

    def _press_group(
        self, which: torch.Tensor, points: torch.Tensor, frames: torch.Tensor, depths: torch.Tensor,
        scales: torch.Tensor, shear: torch.Tensor | None, twist: torch.Tensor | None,
        friction: torch.Tensor | None, start: torch.Tensor | None,
    ) -> BatchedTouches:  # fmt: skip
        height, obstructed = self.heights.cast_heights(which, points, frames, depths, scales)
        displacement, pressure, residual = self.gel.press(height, start)
        mask = pressure > 0 if self.gel.soft else height > 0
        sideways = self.friction.spread(pressure) if self.friction else height.new_zeros(len(height), 2, 1, 1)
        still = torch.zeros_like(residual)
        found = BatchedTouches(
            images=torch.empty(0),
            height=height,
            displacement=displacement,
            pressure=pressure,
            wrench=self.gel.wrench(pressure, None),
            area=(mask * self.gel.area).sum((1, 2)),
            obstructed=obstructed.float(),
            marker_flow=self.gel.flow(sideways.expand(-1, -1, *height.shape[1:]), displacement),
            slipping=still,
            residual=torch.stack([residual, still], 1),
            pressed=pressure,
        )
        if shear is not None and twist is not None and friction is not None:
            found = self._moved(found, shear, twist, friction)
        return replace(found, images=self.optics.render(found.displacement))

    def _moved(
        self, press: BatchedTouches, shear: torch.Tensor, twist: torch.Tensor, friction: torch.Tensor
    ) -> BatchedTouches:
        """Return touches, without images, after a motion of the pressed objects."""
        assert self.friction is not None
        slips = self.friction.slip(press.pressure, shear, twist, friction)
        after = self.friction.drag(press.height, press.pressure, slips.dragged, shear, twist)
        touched = (press.pressure > 0).flatten(1).any(1)
        moving = (touched & (shear.any(1) | (twist != 0)))[:, None, None]
        before = press.height, press.displacement, press.pressure
        height, displacement, pressure = (torch.where(moving, a, b) for a, b in zip(after, before))
        return replace(
            press,
            height=height,
            displacement=displacement,
            pressure=pressure,
            wrench=self.gel.wrench(press.pressure, slips.traction),
            marker_flow=self.gel.flow(slips.sideways, press.displacement),
            slipping=slips.slipping,
            residual=torch.stack([press.residual[:, 0], slips.residual], 1),
        )
