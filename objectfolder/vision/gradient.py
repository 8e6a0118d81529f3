"""Shading that carries gradients to camera and light, inside the silhouette."""

import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.stored.gradient_module import AnswerModule, first_order
from objectfolder.vision.cameras import Intrinsics, PixelRays, covered_rectangle, up_directions
from objectfolder.vision.query import LitCameras
from objectfolder.vision.senses import SurfaceSense
from objectfolder.vision.trace import SurfaceSamples, is_lit, weighted_rows
from objectfolder.vision.vectors import column_major, dot, normalize_rows
from objectfolder.vision.view import SQUARE_SIDE, STRIP

_BYTES_PER_PIXEL = 64  # outside of the silhouette; more inside, for the net's gradients


@dataclass(frozen=True)
class Seen:
    """Views with gradients."""

    images: Tensor  #: (N, H, W, 3) sRGB on white, in [0, 1]
    radiance: Tensor  #: (N, H, W, 3) linear; 0 outside of the silhouette
    inside: Tensor  #: (N, H, W) bool, whether the ray through the pixel's centre meets the object


class View(AnswerModule):
    """Rendering, as `ObjectFile.view` of one light with one ray per pixel, with gradients.

    Gradients reach cameras and lights, inside the silhouette: through the hit, which moves on the plane of
    its triangle, its colour and normals, and the light that it receives directly and from the object.

    No gradients come from what jumps: the silhouette and the edges of shadows; which triangle a ray meets;
    the patch of the surface whose diffuse light counts at a point, and what its mirror image shows.

    Raises ObjectFolderError if the net is of another kind than ``surface``.
    """

    def __init__(self, sense: Any, dtype: torch.dtype):
        super().__init__()
        if not isinstance(sense, SurfaceSense):
            raise ObjectFolderError(
                "gradients of views need a vision net of kind surface; build the object with "
                "train_vision.net: surface"
            )
        self._surface, self._dtype = sense.surface, dtype
        self.net = copy.deepcopy(sense.net).cpu().to(dtype).requires_grad_(False)
        baked = sense.baked
        self._baked = replace(baked, look=baked.look.to(dtype), transport=baked.transport.to(dtype))

    def forward(
        self,
        camera: Tensor,
        light: Tensor,
        resolution: int | None = None,
        intrinsics: Intrinsics | None = None,
    ) -> Seen:
        """Render under a point light; parameters, which may be tensors, and errors of `ObjectFile.view`."""
        seen_by = Intrinsics.given(intrinsics, resolution)
        count = len(LitCameras.checked(camera, light, (), seen_by, _BYTES_PER_PIXEL))
        places = first_order(torch.as_tensor(camera).double())
        posed = places.shape[-2:] == (4, 4)
        frames = places.reshape(-1, 4, 4) if posed else look_at_origin(places.reshape(-1, 3))
        frames = frames.expand(count, 4, 4)
        lights = first_order(torch.as_tensor(light).to(self._dtype)).reshape(-1, 3).expand(count, 3)
        pictures = [self._picture(frame, of, seen_by) for frame, of in zip(frames, lights)]
        radiance, inside = (torch.stack(of) for of in zip(*pictures)) if pictures else self._nothing(seen_by)
        shown = srgb.encode(radiance.clamp(0, 1))
        return Seen(torch.where(inside[..., None], shown, 1), radiance, inside)

    def _picture(self, frame: Tensor, light: Tensor, seen_by: Intrinsics) -> tuple[Tensor, Tensor]:
        """Return linear radiance (H, W, 3) and which pixels see the object (H, W)."""
        radiance = torch.zeros(seen_by.height * seen_by.width, 3, dtype=self._dtype)
        inside = torch.zeros(seen_by.height * seen_by.width, dtype=torch.bool)
        corners = np.array(np.meshgrid(*self._surface.bounds.T)).reshape(3, -1).T
        pose = frame.detach().numpy()
        left, top, right, bottom = covered_rectangle(corners, pose, seen_by)
        rays = PixelRays(pose, seen_by, left, top, max(right, left), max(bottom, top))
        order = rays.in_strips(STRIP)  # as queries do: the first pixels of squares lead
        hit, _, face, _ = self._surface.caster.intersect(rays.origin, rays.centres()[order])
        part, shape = order[hit], (seen_by.height, seen_by.width)
        if not len(part):
            return radiance.view(*shape, 3), inside.view(shape)
        row, column = np.divmod(part, right - left)
        row, column = row + top, column + left
        ways = centre_directions(seen_by, row, column)
        samples = intersect_planes(self._surface, frame, ways, face, light.detach(), self._dtype)
        color = self.net.radiance(self._baked, samples, light, rays.by_squares(part, SQUARE_SIDE))
        place = torch.from_numpy(row * seen_by.width + column)
        radiance = radiance.index_copy(0, place, color)
        return radiance.view(*shape, 3), inside.index_fill(0, place, True).view(shape)

    def _nothing(self, seen_by: Intrinsics) -> tuple[Tensor, Tensor]:
        empty = torch.zeros(0, seen_by.height, seen_by.width, 3, dtype=self._dtype)
        return empty, empty[..., 0].bool()


def intersect_planes(
    surface: Isosurface, frame: Tensor, ways: Tensor, face: np.ndarray, light: Tensor, dtype: torch.dtype
) -> SurfaceSamples:
    """Return the points in which rays meet the planes of known triangles, with gradients.

    ``frame`` (4, 4) is camera to world, ``ways`` (S, 3) are the directions of the rays in the camera's frame,
    ``face`` (S,) the triangles; ``dtype`` is that of the answer.
    """
    origin, away = frame[:3, 3], ways @ frame[:3, :3].T
    a, b, c = (torch.from_numpy(v) for v in surface.vertices[surface.faces[face]].swapaxes(0, 1))
    area = torch.linalg.cross(b - a, c - a)
    distance = dot(a - origin, area) / dot(away, area)
    points = origin + distance * away
    square = dot(area, area)
    second = dot(torch.linalg.cross(points - a, c - a), area) / square
    third = dot(torch.linalg.cross(b - a, points - a), area) / square
    weights = torch.cat([1 - second - third, second, third], 1).to(dtype)
    corners = torch.from_numpy(surface.corners(face))
    normals = normalize_rows(column_major(weighted_rows(surface.shading.tensor.to(dtype), corners, weights)))
    points = points.to(dtype)
    lit = is_lit(surface, points.detach().float(), normals.detach().float(), light.float())
    views, row = normalize_rows(away.to(dtype)), torch.arange(len(face))
    return SurfaceSamples(row, points, normals, views, distance[:, 0], lit, corners, weights)


def centre_directions(seen_by: Intrinsics, row: np.ndarray, column: np.ndarray) -> Tensor:
    """Return directions (S, 3) through the centres of pixels, in the camera's frame, of depth 1; float64."""
    x = (column + 0.5 - seen_by.cx) / seen_by.fx
    y = (seen_by.cy - row - 0.5) / seen_by.fy
    return torch.from_numpy(np.stack([x, y, -np.ones_like(x)], 1))


def look_at_origin(positions: Tensor) -> Tensor:
    """Return `objectfolder.vision.cameras.look_at` of the origin, with gradients; (N, 4, 4)."""
    backward = normalize_rows(positions)
    up = torch.from_numpy(up_directions(backward.detach().numpy()))
    right = normalize_rows(torch.linalg.cross(up, backward))
    rows = torch.stack([right, torch.linalg.cross(backward, right), backward, positions], 2)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0]).to(rows).expand(len(rows), 1, 4)
    return torch.cat([rows, last], 1)
