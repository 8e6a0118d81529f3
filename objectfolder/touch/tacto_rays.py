"""TACTO's images without OpenGL, by ray casting: the object is drawn in front of the gel."""

import numpy as np
import torch

from objectfolder.mesh.normals import area_vectors, unit_vectors
from objectfolder.mesh.raycast import RayCaster
from objectfolder.touch.arrays import blur
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.shading import shade, unit_components

#: m from the pinhole; nothing nearer is drawn.
NEAR_PLANE = 0.001

# Samples within a pixel, from its top left corner: the usual rotated grid of OpenGL drivers.
_SAMPLES = np.array([[0.375, 0.125], [0.875, 0.375], [0.125, 0.625], [0.625, 0.875]])

# A ray continues this far behind a back face, so as not to hit the face again.
_SKIP = 1e-6  # m

# Back faces that a ray passes through; pixels behind more of them show the gel.
_BACK_FACES = 4


class TactoRays:
    """Ray-cast renderer of TACTO's images (Wang et al. 2022).

    The gel is rigid; wherever the object is nearer to the camera than the gel, down to `NEAR_PLANE`, the
    object is drawn. Only faces towards the camera are visible. One ray through the centre of a pixel, shaded
    with the interpolated normal; at the outline of the contact four, as in OpenGL's multisampling.

    Vertices (V, 3), object frame, in units of ``scale`` metres, and faces (F, 3), anticlockwise from outside,
    are those of a closed surface without duplicate vertices; their unit normals (V, 3) are by default those
    of `smooth_normals`, as in TACTO. The ``background`` is (H, W, 3) uint8.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        profile: SensorProfile,
        scale: float = 1.0,
        normals: np.ndarray | None = None,
    ):
        self.profile = profile
        vertices = np.asarray(vertices, np.float64) * scale
        faces = np.asarray(faces, np.int64)
        normals = smooth_normals(vertices, faces) if normals is None else normals
        self._normals = normals[faces].astype(np.float32)  # at the faces' corners
        self._flat = area_vectors(vertices, faces).astype(np.float32)
        self._caster = RayCaster(vertices, faces)
        self._rays = ray_directions(profile).reshape(-1, 3).astype(np.float32)
        self._gel = gel_depth(profile).ravel().astype(np.float32)
        self._pitch = np.array(profile.half_extent)[::-1] * 2 / (profile.width, profile.height)
        optics = Optics(profile)
        self.background = optics.background.numpy()
        self._empty = to_bytes(optics.untouched).reshape(-1, 3)

    def render(
        self, points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Press the sensor on the object, without noise; images (N, H, W, 3) uint8, contacts (N, H, W) bool.

        Points (N, 3), metres, unit outward normals (N, 3), object frame, angles (N,), radians, and depths
        (N,), metres, are those of `objectfolder.touch.contact.heightmaps`; they touch where the centre of a
        pixel shows the object.
        """
        height, width = self.profile.height, self.profile.width
        cameras, frames = sensor_poses(points, normals, angles, depths, self.profile)
        images = np.empty((len(frames), height, width, 3), np.uint8)
        contact = np.zeros((len(frames), height, width), bool)
        for i, (camera, frame) in enumerate(zip(cameras, frames)):
            hit, drawn = self._draw(camera, frame, self._rays, self._gel)
            picture = self._empty.copy()
            picture[hit] = drawn
            contact[i].flat[hit] = True
            outline = np.flatnonzero(_outline(contact[i]))
            if outline.size:
                picture[outline] = self._multisample(camera, frame, outline)
            shape = height, width, 3
            images[i] = compose(
                picture.reshape(shape), self._empty.reshape(shape), self.background, self.profile
            )
        return images, contact

    def _multisample(self, camera: np.ndarray, frame: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Return the mean colours (P, 3) over the samples within some pixels."""
        offset = (0.5 - _SAMPLES) * self._pitch
        rays = np.repeat(self._rays[pixels], len(offset), axis=0)
        rays[:, 1:] += np.tile(offset, (len(pixels), 1)).astype(np.float32)
        colors = np.repeat(self._empty[pixels], len(offset), axis=0)
        hit, drawn = self._draw(camera, frame, rays, np.repeat(self._gel[pixels], len(offset)))
        colors[hit] = drawn
        return colors.reshape(len(pixels), len(offset), 3).mean(axis=1).round()

    def _draw(
        self, camera: np.ndarray, frame: np.ndarray, rays: np.ndarray, gel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the rays that hit the object and its colours there, (H, 3), whole numbers from 0 to 255."""
        hit, depth, face, weights = self._first_front(camera, rays @ frame.T.astype(np.float32), gel)
        if not hit.size:
            return hit, np.empty((0, 3), np.float32)
        normal = np.einsum("nk,nkj->nj", weights, self._normals[face]) @ frame.astype(np.float32)
        point = depth[:, None] * rays[hit]
        return hit, to_bytes(shade(_columns(point), unit_components(_columns(normal)), self.profile))

    def _first_front(
        self, camera: np.ndarray, directions: np.ndarray, gel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the first front faces before the gel: ray, depth, face, barycentric weights."""
        live, along, start = np.arange(len(directions)), directions, np.float32(NEAR_PLANE)
        camera, found = camera.astype(np.float32), []
        for _ in range(_BACK_FACES):
            origins = camera + np.reshape(start, (-1, 1)) * along
            ray, further, face, weights = self._caster.intersect(origins, along, np.maximum(gel - start, 0))
            depth, along = (start[ray] if start.ndim else start) + further, along[ray]
            front = np.einsum("ij,ij->i", self._flat[face], along) < 0
            found.append((live[ray[front]], depth[front], face[front], weights[front]))
            behind = ~front
            if not behind.any():
                break
            live, gel = live[ray[behind]], gel[ray[behind]]
            along, start = along[behind], depth[behind] + np.float32(_SKIP)
        hit, depth, face, weights = found[0] if len(found) == 1 else map(np.concatenate, zip(*found))
        return hit, depth, face, weights


def sensor_poses(
    points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray, profile: SensorProfile
) -> tuple[np.ndarray, np.ndarray]:
    """Return pinholes (N, 3) and axes (N, 3, 3; columns x, y, z) of pressed sensors, object frame."""
    normals = np.asarray(normals, np.float64).reshape(-1, 3)
    depths = np.broadcast_to(np.asarray(depths, np.float64), len(normals))
    cameras = np.asarray(points, np.float64) + normals * (profile.camera_to_gel - depths)[:, None]
    return cameras, sensor_frames(normals, angles)


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit vertex normals (V, 3): means over the faces, weighted by angle, as in trimesh."""
    corners = np.asarray(vertices, np.float64)[faces]
    along = unit_vectors(np.roll(corners, -1, axis=1) - corners)
    angles = np.arccos(-(along * np.roll(along, 1, axis=1)).sum(2).clip(-1, 1))
    weighted = angles[..., None] * unit_vectors(area_vectors(vertices, faces))[:, None]
    flat = np.asarray(faces).ravel()
    total = [np.bincount(flat, column, len(vertices)) for column in weighted.reshape(-1, 3).T]
    return unit_vectors(np.stack(total, axis=1))


def compose(
    rendered: np.ndarray, empty: np.ndarray, background: np.ndarray, profile: SensorProfile
) -> np.ndarray:
    """Compose TACTO's image (H, W, 3) uint8, truncated as there, from renderings with and without the object.

    All (H, W, 3), 0 to 255; gain and blur are the profile's.
    """
    change = torch.from_numpy((rendered.astype(np.float32) - empty) * profile.gain).permute(2, 0, 1)[None]
    blurred = blur(change, profile.image_smoothing / profile.pixel_pitch)[0].permute(1, 2, 0).numpy()
    return (background + blurred).clip(0, 255).astype(np.uint8)


def to_bytes(display: torch.Tensor) -> np.ndarray:
    """Convert display values (3, ...) as OpenGL stores them: (..., 3) float32, whole numbers up to 255."""
    return (255 * display).round().movedim(0, -1).numpy()


def _columns(vectors: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    x, y, z = torch.from_numpy(np.ascontiguousarray(vectors.T))
    return x, y, z


def _outline(contact: np.ndarray) -> np.ndarray:
    """Return the mask of pixels with one of four neighbours across the contact's edge; (H, W)."""
    edge = np.zeros_like(contact)
    for axis in (0, 1):
        differ = np.diff(contact, axis=axis)
        for place in (0, differ.shape[axis]):
            edge |= np.insert(differ, place, False, axis=axis)
    return edge
