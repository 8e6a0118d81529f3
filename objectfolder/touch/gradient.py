"""Touch that carries gradients to the sensor's pose and depth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.stored.gradient_module import AnswerModule, first_order, follow_surface
from objectfolder.stored.surface import TOLERANCE
from objectfolder.touch.active_set import ACCURACY, settle, supporting_pressure
from objectfolder.touch.camera import gel_depth, pixel_area, ray_directions
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals, heightmaps, lean_normals, sensor_frames
from objectfolder.touch.gel import GAP, deform, layer_of, respond
from objectfolder.touch.geometric_net import GeometricTouch
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.query import ContactPoses
from objectfolder.touch.senses import GeometricSense

_SINGLE = 1e-5  # accuracy of gradients in single precision
_BEFORE = 1e-5  # m before a known hit, where rays start that look for its triangle


@dataclass(frozen=True)
class Felt:
    """What a sensor feels in N contacts, with gradients."""

    images: torch.Tensor  #: (N, H, W, 3) RGB, grey levels 0 to 255, not rounded
    height: torch.Tensor  #: (N, H, W) m, of the object past the undeformed gel; negative is a gap
    displacement: torch.Tensor  #: (N, H, W) m, of the gel towards the camera; negative bulges
    pressure: torch.Tensor  #: (N, H, W) Pa; NaN for a rigid gel
    force: torch.Tensor  #: (N,) N, along the optical axis; NaN for a rigid gel


class Touch(AnswerModule):
    """Press of a tactile sensor, as `ObjectFile.press`, with gradients.

    Gradients reach points, depth, angle, tilt and azimuth. The contact normal turns as the point moves. A
    pixel's ray meets a triangle of the stored surface, and by the implicit function theorem its hit moves as
    the triangle's plane does: exact for a rigid gel. A soft gel is differentiated on the pixels that touch;
    see `SoftGel`.

    No gradients come from what jumps: pixels that pass from one wall to another or reach the limits of the
    gel, the rim of a rigid imprint, how far an obstructed sensor stops short, and points that are projected
    to another wall.

    In double precision, a soft gel is solved to rounding. Raises ObjectFolderError if the net is of another
    kind than ``geometric``, or its renderer another than ``gel``.
    """

    def __init__(self, sense: Any, dtype: torch.dtype):
        super().__init__()
        if not isinstance(sense, GeometricSense) or sense.net.renderer != "gel":
            raise ObjectFolderError(
                "gradients of touch need a touch net of kind geometric and renderer gel; build the object "
                "with train_touch.net: geometric and render_touch.renderer: gel"
            )
        self._sense, self._dtype = sense, dtype
        self._optics: dict[SensorProfile, TensorOptics] = {}

    def forward(
        self,
        points: torch.Tensor,
        depth: Any = 0.001,
        angle: Any = 0.0,
        tilt: Any = 0.0,
        azimuth: Any = 0.0,
        tolerance: float = TOLERANCE,
        sensor: str | Path | SensorProfile | None = None,
    ) -> Felt:
        """Press the sensor; parameters, which may be tensors, and errors are those of `ObjectFile.press`."""
        contacts = ContactPoses.checked(points, depth, angle, tilt, azimuth, tolerance)
        net = self._sense.net if sensor is None else self._sense.net.with_sensor(load_profile(sensor))
        snapped = self._sense.snap(contacts, net)
        count, scale = len(snapped), net.scale
        given = torch.as_tensor(points).double().expand(snapped.shape) / scale
        pose = (first_order(torch.as_tensor(v, dtype=torch.float64)) for v in (angle, tilt, azimuth, depth))
        turned, leaning, towards, pressed = (v.expand(count) for v in pose)
        places = follow_surface(given, snapped / scale, net.surface)
        outward = contact_normals(net.surface.grid.smooth_distance, places, NORMAL_RADIUS)
        axis = lean_normals(outward, turned, leaning, towards)
        pressed = (pressed + net.depth_offset).clamp(0, net.profile.max_indentation)
        height = seated_heights(places * scale, axis, turned, pressed, net).to(self._dtype)
        if net.profile.gel == "rigid":
            displacement, pressure = height.clamp(min=0), torch.full_like(height, torch.nan)
        else:
            displacement, pressure = SoftGel.apply(height, net.profile)
        area = torch.from_numpy(pixel_area(net.profile).copy()).to(self._dtype)
        force = (pressure * area).sum((1, 2))
        return Felt(self._optics_of(net).images(displacement), height, displacement, pressure, force)

    def _optics_of(self, net: GeometricTouch) -> "TensorOptics":
        if net.profile not in self._optics:
            optics = TensorOptics(net.profile, self._dtype)
            optics.background = net.background.cpu()
            self._optics[net.profile] = optics
        return self._optics[net.profile]


def seated_heights(
    points: torch.Tensor, axes: torch.Tensor, angles: torch.Tensor, depths: torch.Tensor, net: GeometricTouch
) -> torch.Tensor:
    """Return the heights of `objectfolder.touch.contact.heightmaps`, with gradients; (N, H, W) float64.

    Contact points (N, 3), metres, and the sensors' unit outward axes are float64 in the object frame; angles
    are radians, depths metres.
    """
    profile, surface = net.profile, net.surface
    where, axis, turned, pressed = (v.detach().numpy() for v in (points, axes, angles, depths))
    height, _, retreat = heightmaps(surface.caster, where, axis, turned, pressed, profile, net.scale)
    frames, gel = sensor_frames(axes, angles), torch.from_numpy(gel_depth(profile)).ravel()
    rays = torch.from_numpy(ray_directions(profile)).reshape(-1, 3)
    cameras = points + axes * (profile.camera_to_gel - depths + torch.from_numpy(retreat))[:, None]
    found = []
    for flat, camera, frame in zip(torch.from_numpy(height).flatten(1).double(), cameras, frames):
        known = (flat > -GAP * profile.elastomer_thickness) & (flat < profile.max_indentation)
        inside = known.nonzero()[:, 0]
        ways = rays[inside] @ frame.T
        given = camera.detach(), ways.detach(), (gel - flat)[inside]
        corner, normal, met = hit_planes(surface, net.scale, *given)
        # Of the point camera + t ways on the plane; its gradient is that of the implicit function.
        t = ((corner - camera) * normal).sum(1) / torch.where(met, (ways * normal).sum(1), 1)
        seen = torch.where(met, gel[inside] - t, flat[inside])
        found.append(flat.index_copy(0, inside, seen))
    return torch.stack(found).view(height.shape) if found else torch.from_numpy(height).double()


def hit_planes(
    surface: Isosurface, scale: float, camera: torch.Tensor, ways: torch.Tensor, depth: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return a corner, metres, and the normal of the triangles that rays meet, and whether they were found.

    Rays start at the camera (3,), metres, along ``ways`` (M, 3), and meet the surface, whose unit is
    ``scale`` metres, at ``depth`` (M,) times these. Returns corners and normals, (M, 3) float64, and a mask
    (M,).
    """
    start = (camera + (depth - _BEFORE)[:, None] * ways) / scale
    reach = np.full(len(ways), 2 * _BEFORE, np.float32)
    _, face = surface.caster.first_hit(start.numpy(), (ways / scale).numpy(), reach)
    a, b, c = (torch.from_numpy(v) * scale for v in surface.vertices[surface.faces[face]].swapaxes(0, 1))
    normal = torch.linalg.cross(b - a, c - a)
    return a, normal, torch.from_numpy(face >= 0) & ((ways * normal).sum(1) != 0)


class SoftGel(torch.autograd.Function):
    """Press a rigid object into a soft gel; `objectfolder.touch.gel.deform` with gradients.

    Where they touch, the displacement is the height and the pressure solves C p = h on the touching pixels,
    C being the layer's symmetric response; elsewhere the displacement is C p. The touching pixels change
    where the gap or the pressure is 0, which alters no first derivative. So gradients (a, b) of displacement
    and pressure are, on the touching pixels, those of the heights

        a + C^-1 (C a' + b),

    where a' is a outside of them.
    """

    @staticmethod
    def forward(ctx: Any, height: torch.Tensor, profile: SensorProfile) -> tuple[torch.Tensor, torch.Tensor]:
        """Return displacement, metres, and pressure, Pa, of heights (N, H, W), metres.

        In double precision the contact is solved to rounding, in single as `deform` does.
        """
        values = height.detach().numpy()
        displacement, pressure = deform(values, profile)
        if height.dtype == torch.float64:
            displacement, pressure = displacement.astype(np.float64), pressure.astype(np.float64)
            gel = profile.pixel_pitch, layer_of(profile)
            for i in np.flatnonzero(pressure.any((1, 2))):
                displacement[i], pressure[i] = settle(values[i], pressure[i], *gel)
        ctx.profile = profile
        # Pixels that were laid onto the object without a pressure belong to it, too.
        ctx.touching = (displacement == values) & pressure.any((1, 2), keepdims=True)
        return torch.from_numpy(displacement), torch.from_numpy(pressure)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Any) -> tuple[torch.Tensor, None]:
        """Return the gradients of heights (N, H, W)."""
        of_moved, of_pressure = (g.numpy().astype(np.float64) for g in gradients)
        pitch, layer = ctx.profile.pixel_pitch, layer_of(ctx.profile)
        accuracy = ACCURACY if gradients[0].dtype == torch.float64 else _SINGLE
        result = np.where(ctx.touching, of_moved, 0)
        for i in np.flatnonzero(ctx.touching.any((1, 2))):
            free = respond(np.where(ctx.touching[i], 0, of_moved[i]), pitch, layer)
            result[i] += supporting_pressure(free + of_pressure[i], ctx.touching[i], pitch, layer, accuracy)
        return torch.from_numpy(result).to(gradients[0].dtype), None


class TensorOptics(Optics):
    """Optics of the gel that compute with tensors, through which gradients flow."""

    def __init__(self, profile: SensorProfile, dtype: torch.dtype):
        self._dtype = dtype
        super().__init__(profile)

    def images(self, displacement: torch.Tensor) -> torch.Tensor:
        """Return images of displacements (N, H, W), metres; (N, H, W, 3), grey levels, not rounded."""
        return (self._change(displacement) + self._planes).clamp(0, 255).permute(0, 2, 3, 1)

    def _array(self, values: torch.Tensor) -> torch.Tensor:
        return values.to(self._dtype)

    def _window(self, displacement: torch.Tensor) -> tuple[slice, slice]:
        return slice(0, displacement.shape[1]), slice(0, displacement.shape[2])
