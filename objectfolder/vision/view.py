"""Draw a stored surface: rays, shading, and extra samples where the picture has edges."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.vision.cameras import Intrinsics, camera_rays, covered_rectangle
from objectfolder.vision.picture import Picture
from objectfolder.vision.trace import SurfaceSamples, trace

CREASE = 0.35  # difference of neighbouring unit normals


def offsets(side: int) -> np.ndarray:
    """Regular sample positions within a pixel; (side^2, 2)."""
    axis = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)


SHADED = offsets(3)  #: samples of pixels with edges
LINES, HALVINGS = 4, 5  #: across a silhouette's pixel, and how often they are halved to find where it is cut

#: Samples, light (3,) and the pixel (S,) that each belongs to -> linear radiance (S, 3).
Shader = Callable[[SurfaceSamples, torch.Tensor, np.ndarray], torch.Tensor]


@torch.no_grad()
def draw(
    surface: Isosurface,
    shade: Shader,
    camera_to_world: np.ndarray,
    light: np.ndarray,
    intrinsics: Intrinsics,
    supersample: bool = True,
) -> Picture:
    """Render one view of a stored surface.

    One ray through every pixel that the object may cover; where silhouettes, shadow edges or creases
    cross a pixel, the samples `SHADED`; on silhouettes, more rays find how much of a pixel is covered.

    Parameters
    ----------
    surface : Isosurface
    shade : callable
        See `Shader`.
    camera_to_world : (4, 4) array
    light : (3,) array
    intrinsics : Intrinsics
    supersample : bool
        Without, every pixel is the ray through its centre: faster, and jagged at edges.

    Returns
    -------
    Picture
        Depth and normal are of the ray through the pixel's centre; where it misses and other samples hit, of
        the nearest of them. Normals are the stored surface's, without what the net adds for shading; a camera
        inside the object sees them from behind.
    """
    height, width = intrinsics.height, intrinsics.width
    rgba = np.zeros((height, width, 4), np.float32)
    depth = np.full((height, width), np.inf, np.float32)
    normals = np.zeros((height, width, 3), np.float32)
    corners = np.array(np.meshgrid(*surface.bounds.T)).reshape(3, -1).T
    left, top, right, bottom = covered_rectangle(corners, camera_to_world, intrinsics)
    if left < right and top < bottom:
        centre = intrinsics.cx - left, intrinsics.cy - top
        part = replace(intrinsics, width=right - left, height=bottom - top, center=centre)
        window = slice(top, bottom), slice(left, right)
        rgba[window], depth[window], normals[window] = _draw(
            surface, shade, camera_to_world, light, part, supersample
        )
    return Picture(rgba, depth, normals)


def _draw(
    surface: Isosurface,
    shade: Shader,
    camera_to_world: np.ndarray,
    light: np.ndarray,
    intrinsics: Intrinsics,
    supersample: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    height, width = intrinsics.height, intrinsics.width
    count = height * width
    everywhere = np.arange(count)
    centre = _cast(surface, camera_to_world, light, intrinsics, everywhere, np.full((1, 2), 0.5))
    seen = centre.ray.numpy()
    normals = np.zeros((count, 3), np.float32)
    normals[seen] = centre.normals.numpy()
    edge = np.zeros(count, bool)
    if supersample:
        state = np.zeros(count, np.int8)
        state[seen] = 1 + centre.lit.numpy()
        edge = _varies(state, height, width, 0) | _varies(normals, height, width, CREASE)
    edge_pixels = np.flatnonzero(edge)
    fine = _cast(surface, camera_to_world, light, intrinsics, edge_pixels, SHADED)
    inner = np.flatnonzero(~edge[seen])
    samples = centre.select(torch.from_numpy(inner)).joined(fine)
    pixel = np.concatenate([seen[inner], edge_pixels[fine.ray.numpy() // len(SHADED)]])
    radiance = np.zeros((0, 3), np.float32)
    if len(pixel):
        radiance = shade(samples, torch.from_numpy(np.asarray(light, np.float32)), pixel).numpy()
    hits = np.bincount(pixel, minlength=count)
    summed = np.stack([np.bincount(pixel, weights=c, minlength=count) for c in radiance.T], 1)
    color = summed / np.maximum(hits, 1)[:, None]
    alpha = np.where(edge, hits / len(SHADED), hits)
    if supersample:
        silhouette = np.flatnonzero(_varies(alpha, height, width, 0) & (hits > 0))
        padded = np.pad(alpha.reshape(height, width), 1, mode="edge")
        slopes = np.stack([padded[2:, 1:-1] - padded[:-2, 1:-1], padded[1:-1, 2:] - padded[1:-1, :-2]], -1)
        slopes = slopes.reshape(count, 2)[silhouette]
        alpha[silhouette] = _coverage(surface, camera_to_world, intrinsics, silhouette, slopes)
    rgba = np.concatenate([color * alpha[:, None], alpha[:, None]], 1).astype(np.float32)
    depth = np.full(count, np.inf, np.float32)
    depth[seen] = _depth(centre, camera_to_world)
    pixel, nearest = _nearest_misses(fine, edge_pixels, np.isinf(depth), camera_to_world)
    depth[pixel], normals[pixel] = _depth(nearest, camera_to_world), nearest.normals.numpy()
    empty = rgba[:, 3] == 0
    depth[empty], normals[empty] = np.inf, 0
    size = height, width
    return rgba.reshape(*size, 4), depth.reshape(size), normals.reshape(*size, 3)


def _depth(samples: SurfaceSamples, camera_to_world: np.ndarray) -> np.ndarray:
    """Distance along the optical axis; (S,)."""
    return (samples.points.numpy() - camera_to_world[:3, 3]) @ -camera_to_world[:3, 2]


def _nearest_misses(
    fine: SurfaceSamples, edge_pixels: np.ndarray, missed: np.ndarray, camera_to_world: np.ndarray
) -> tuple[np.ndarray, SurfaceSamples]:
    """Pixels whose centre missed although other samples hit, and the sample nearest to the camera in each."""
    pixel = edge_pixels[fine.ray.numpy() // len(SHADED)]
    index = np.flatnonzero(missed[pixel])
    index = index[np.argsort(_depth(fine, camera_to_world)[index], kind="stable")]
    found, first = np.unique(pixel[index], return_index=True)
    return found, fine.select(torch.from_numpy(index[first]))


def _pixel_rays(
    camera_to_world: np.ndarray, intrinsics: Intrinsics, pixels: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    corner = np.stack([pixels % intrinsics.width, pixels // intrinsics.width], 1)
    positions = (corner[:, None, :] + offsets).reshape(-1, 2)
    return camera_rays(camera_to_world, intrinsics, positions)


def _cast(
    surface: Isosurface,
    camera_to_world: np.ndarray,
    light: np.ndarray,
    intrinsics: Intrinsics,
    pixels: np.ndarray,
    offsets: np.ndarray,
) -> SurfaceSamples:
    return trace(surface, *_pixel_rays(camera_to_world, intrinsics, pixels, offsets), light)


def _coverage(
    surface: Isosurface,
    camera_to_world: np.ndarray,
    intrinsics: Intrinsics,
    pixels: np.ndarray,
    slopes: np.ndarray,
) -> np.ndarray:
    """Share of each pixel that the surface covers; (P,).

    Lines across the silhouette are halved until the cut is found.

    Parameters
    ----------
    slopes : (P, 2) array
        How coverage grows down the rows and along the columns.
    """
    upright = (np.abs(slopes[:, 0]) >= np.abs(slopes[:, 1]))[:, None]
    grows = np.where(upright, slopes[:, :1], slopes[:, 1:]) >= 0
    lines = np.broadcast_to((np.arange(LINES) + 0.5) / LINES, (len(pixels), LINES))
    low, high = np.zeros(lines.shape), np.ones(lines.shape)  # from the bare side to the covered one
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        along = np.where(grows, middle, 1 - middle)
        positions = np.stack([np.where(upright, lines, along), np.where(upright, along, lines)], 2)
        rays = _pixel_rays(camera_to_world, intrinsics, pixels, positions)
        met = (surface.caster.first_hit(*rays)[1] >= 0).reshape(lines.shape)
        low, high = np.where(met, low, middle), np.where(met, middle, high)
    # A line that is met everywhere, or nowhere, is taken for whole.
    cut = np.where(low == 0, 0, np.where(high == 1, 1, (low + high) / 2))
    return 1 - cut.mean(1)


def _varies(values: np.ndarray, height: int, width: int, tolerance: float) -> np.ndarray:
    """Pixels that differ by more than a tolerance from one of their eight neighbours; (H*W,) bool."""
    image = values.reshape(height, width, -1)
    varies = np.zeros((height, width), bool)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        # Each pixel against one neighbour; both are marked.
        here = slice(0, height - down), slice(max(-right, 0), width - max(right, 0))
        there = slice(down, height), slice(max(right, 0), width + min(right, 0))
        apart = (np.abs(image[here] - image[there]) > tolerance).any(-1)
        varies[here] |= apart
        varies[there] |= apart
    return varies.ravel()
