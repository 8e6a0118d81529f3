"""Heightmaps of many contacts with many objects at once: by NVIDIA Warp on its devices, by Embree on a CPU.

Warp's rays meet the same triangles as Embree's. Its back end for CPUs takes two to three times as long as
Embree, so it is used there by tests only.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from importlib.util import find_spec
from typing import Protocol

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import install_command
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.contact import FREE_OVERLAP, PROBES, framed_heightmaps
from objectfolder.touch.gel import GAP
from objectfolder.touch.profiles import SensorProfile

EXTRA = "batch"  #: of the package, which brings Warp


class HeightCaster(Protocol):
    """What finds objects in front of gels."""

    def cast_heights(
        self, which: torch.Tensor, points: torch.Tensor, frames: torch.Tensor, depths: torch.Tensor,
        scales: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
        """Return heights (B, H, W) float32 and obstructed parts (B,), as `heightmaps`.

        ``which`` (B,) numbers the surfaces; points (B, 3), frames (B, 3, 3), depths (B,) and scales (B,) are
        those of `framed_heightmaps`, float64 tensors on the device.
        """


class EmbreeHeights:
    """Heightmaps by Embree, one contact after another."""

    def __init__(self, surfaces: Sequence[Isosurface], profile: SensorProfile):
        self._surfaces, self._profile = surfaces, profile

    def cast_heights(
        self, which: torch.Tensor, points: torch.Tensor, frames: torch.Tensor, depths: torch.Tensor,
        scales: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
        """Return heights and obstructed parts; see `HeightCaster`."""
        profile, count = self._profile, len(which)
        height = np.empty((count, profile.height, profile.width), np.float32)
        obstructed = np.empty(count)
        where, axes, pressed = (v.numpy() for v in (points, frames, depths))
        groups = torch.stack([which.double(), scales], 1).unique(dim=0, return_inverse=True)
        for number, (one, scale) in enumerate(groups[0].tolist()):
            rows = np.flatnonzero((groups[1] == number).numpy())
            contact = where[rows], axes[rows], pressed[rows]
            caster = self._surfaces[int(one)].caster
            height[rows], obstructed[rows], _ = framed_heightmaps(caster, *contact, profile, scale)
        return torch.from_numpy(height), torch.from_numpy(obstructed)


class WarpHeights:
    """Heightmaps by NVIDIA Warp: the triangles of all surfaces are on the device, in one hierarchy each.

    Raises ObjectFolderError as `require_warp`.
    """

    def __init__(self, surfaces: Sequence[Isosurface], profile: SensorProfile, device: torch.device):
        require_warp(device)
        import warp

        from objectfolder.touch import warp_kernels

        warp.init()
        device = torch.empty(0, device=device).device  # "cuda" with its number, which Warp asks for
        self._kernels, self._device = warp_kernels, device
        self._on = warp.device_from_torch(device)
        self._meshes = [  # kept alive: kernels get their numbers
            warp.Mesh(
                warp.array(surface.vertices.astype(np.float32), dtype=warp.vec3, device=self._on),
                warp.array(surface.faces.astype(np.int32).ravel(), dtype=int, device=self._on),
            )
            for surface in surfaces
        ]
        self._numbers = warp.array([mesh.id for mesh in self._meshes], dtype=warp.uint64, device=self._on)
        self._profile, self._shape = profile, (profile.height, profile.width)
        gel, thickness = gel_depth(profile).ravel().astype(np.float32), profile.elastomer_thickness
        self._gap = float(np.float32(GAP * thickness))
        tensors = [
            torch.from_numpy(v).to(device)
            for v in (
                ray_directions(profile).reshape(-1, 3).astype(np.float32),
                gel - np.float32(thickness),
                gel + np.float32(self._gap),
                PROBES.astype(np.float32),
            )
        ]
        self._rays, self._base, self._limit, self._probes = tensors
        self._gel = torch.from_numpy(gel).to(device).view(self._shape)

    def cast_heights(
        self, which: torch.Tensor, points: torch.Tensor, frames: torch.Tensor, depths: torch.Tensor,
        scales: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
        """Return heights and obstructed parts; see `HeightCaster`."""
        profile, outward = self._profile, -frames[:, :, 0]
        away = (profile.camera_to_gel - depths)[:, None]
        cameras = ((points + outward * away) / scales[:, None]).float()
        pose = which.int(), frames.float(), scales.float()
        every = torch.ones_like(pose[0])
        distance = torch.empty((len(which), len(self._base)), dtype=torch.float32, device=self._device)
        blocked, overlap = self._cast(cameras, pose, every, distance)
        short = (overlap > 0) & (overlap < profile.camera_to_gel)
        retreat = torch.where(short, overlap, 0.0)
        cameras = cameras + (outward * (retreat / scales)[:, None]).float()
        _, left = self._cast(cameras, pose, short.int(), distance)
        overlap = torch.where(short, left, overlap)
        free = overlap <= FREE_OVERLAP * profile.elastomer_thickness
        height = (self._gel - distance.view(-1, *self._shape)).clamp(-self._gap, profile.max_indentation)
        height = torch.where(free[:, None, None], height, -self._gap)
        return height, blocked.double() / len(self._base)

    def _cast(
        self, cameras: torch.Tensor, pose: tuple[torch.Tensor, ...], chosen: torch.Tensor,
        distance: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
        """Fill in distances of the chosen rows; return numbers of blocked pixels, and overlaps, metres."""
        import warp

        which, frames, scales = pose
        count = len(which)
        enclosed = torch.zeros_like(which)
        blocked, overlap = torch.zeros_like(which), torch.zeros_like(scales)
        seen = [
            warp.from_torch(v.contiguous(), kind)
            for v, kind in (
                (which, None), (cameras, warp.vec3), (frames, warp.mat33), (scales, None), (chosen, None)
            )
        ]  # fmt: skip
        inside, number, reach, out = (warp.from_torch(v) for v in (enclosed, blocked, overlap, distance))
        rays, probes = (warp.from_torch(v, warp.vec3) for v in (self._rays, self._probes))
        base, limit = warp.from_torch(self._base), warp.from_torch(self._limit)
        with self._stream():
            index, camera, frame, scale, on = seen
            near = [self._numbers, index, camera, on, probes, inside]
            warp.launch(self._kernels.find_enclosed, dim=count, inputs=near, device=self._on)
            far = [self._numbers, index, camera, frame, scale, on, inside, rays, base, limit]
            outputs = [out, number, reach]
            size = count, len(self._base)
            warp.launch(self._kernels.find_first_surface, size, inputs=far, outputs=outputs, device=self._on)
        return blocked, overlap

    def _stream(self) -> AbstractContextManager[object]:
        """Return a context in which Warp works on torch's current stream."""
        import warp

        if self._device.type != "cuda":
            return nullcontext()
        stream = warp.stream_from_torch(torch.cuda.current_stream(self._device))
        return warp.ScopedStream(stream, sync_enter=False, sync_exit=False)


def require_warp(device: torch.device) -> None:
    """Raise ObjectFolderError if Warp is not installed, or has no rays for a device."""
    if device.type not in ("cpu", "cuda"):
        raise ObjectFolderError(
            f"device is {str(device)!r}: NVIDIA Warp casts rays on CUDA devices; take one, or device='cpu'"
        )
    if find_spec("warp") is None:
        raise ObjectFolderError(
            f"batches of touches on a GPU need NVIDIA Warp; for it: {install_command(EXTRA)}"
        )
