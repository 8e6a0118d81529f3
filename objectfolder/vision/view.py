"""Draw a stored surface: rays, shading, and extra samples where the picture has edges."""

from collections.abc import Callable

import numpy as np
import torch
from scipy.ndimage import maximum_filter, minimum_filter

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.vision.cameras import Intrinsics, camera_rays, covered_rectangle
from objectfolder.vision.picture import Picture
from objectfolder.vision.trace import SurfaceSamples, trace

SHADE_SIDE = 2  # shading samples per side of an edge pixel
COVER_SIDE = 8  # coverage samples per side of a silhouette pixel

Shader = Callable[[SurfaceSamples, torch.Tensor], torch.Tensor]


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
    cross a pixel, `SHADE_SIDE`^2 shading samples, and on silhouettes `COVER_SIDE`^2 coverage rays.

    Parameters
    ----------
    surface : Isosurface
    shade : callable
        Samples and light (3,) -> linear radiance (S, 3).
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
    candidate = _covered_box(surface, camera_to_world, intrinsics)
    light_tensor = torch.from_numpy(np.asarray(light, np.float32))
    centre = _cast(surface, camera_to_world, light, intrinsics, candidate, np.full((1, 2), 0.5))
    seen = candidate[centre.ray.numpy()]
    normals = np.zeros((height * width, 3), np.float32)
    normals[seen] = centre.normals.numpy()
    edge = np.zeros(height * width, bool)
    if supersample:
        state = np.zeros(height * width, np.int8)
        state[seen] = 1 + centre.lit.numpy()
        edge = _varies(state, height, width, 0) | _varies(normals, height, width, 0.35)
    edge_pixels = candidate[edge[candidate]]
    inner = np.flatnonzero(~edge[seen])
    fine = _cast(surface, camera_to_world, light, intrinsics, edge_pixels, _offsets(SHADE_SIDE))
    samples = _concatenate(_select(centre, inner), fine)
    pixel = np.concatenate([seen[inner], edge_pixels[fine.ray.numpy() // SHADE_SIDE**2]])
    radiance = shade(samples, light_tensor).numpy() if len(pixel) else np.zeros((0, 3), np.float32)
    hits = np.bincount(pixel, minlength=height * width)
    color = (
        np.stack([np.bincount(pixel, weights=radiance[:, c], minlength=height * width) for c in range(3)], 1)
        / np.maximum(hits, 1)[:, None]
    )
    alpha = np.where(edge, hits / SHADE_SIDE**2, hits)
    if supersample:
        silhouette = np.flatnonzero(_varies(alpha, height, width, 0))
        alpha[silhouette] = _coverage(surface, camera_to_world, intrinsics, silhouette)
    # A pixel that coverage rays alone have found takes no colour: it is nearly white anyway.
    alpha = np.where(hits > 0, alpha, 0)[:, None]
    rgba = np.concatenate([color * alpha, alpha], 1).astype(np.float32)
    depth = np.full(height * width, np.inf, np.float32)
    depth[seen] = _depth(centre, camera_to_world)
    pixel, nearest = _nearest_misses(fine, edge_pixels, np.isinf(depth), camera_to_world)
    depth[pixel], normals[pixel] = _depth(nearest, camera_to_world), nearest.normals.numpy()
    empty = rgba[:, 3] == 0
    depth[empty], normals[empty] = np.inf, 0
    size = height, width
    return Picture(rgba.reshape(*size, 4), depth.reshape(size), normals.reshape(*size, 3))


def _depth(samples: SurfaceSamples, camera_to_world: np.ndarray) -> np.ndarray:
    """Distance along the optical axis; (S,)."""
    return (samples.points.numpy() - camera_to_world[:3, 3]) @ -camera_to_world[:3, 2]


def _nearest_misses(
    fine: SurfaceSamples, edge_pixels: np.ndarray, missed: np.ndarray, camera_to_world: np.ndarray
) -> tuple[np.ndarray, SurfaceSamples]:
    """Pixels whose centre missed although other samples hit, and the sample nearest to the camera in each."""
    pixel = edge_pixels[fine.ray.numpy() // SHADE_SIDE**2]
    index = np.flatnonzero(missed[pixel])
    index = index[np.argsort(_depth(fine, camera_to_world)[index], kind="stable")]
    found, first = np.unique(pixel[index], return_index=True)
    return found, _select(fine, index[first])


def _covered_box(surface: Isosurface, camera_to_world: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Flat indices of the pixels that the object's bounding box may cover."""
    corners = np.array(np.meshgrid(*surface.bounds.T)).reshape(3, -1).T
    left, top, right, bottom = covered_rectangle(corners, camera_to_world, intrinsics)
    rows, columns = np.meshgrid(np.arange(top, bottom), np.arange(left, right), indexing="ij")
    return (rows * intrinsics.width + columns).ravel()


def _offsets(side: int) -> np.ndarray:
    """Regular sample positions within a pixel; (side^2, 2)."""
    axis = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)


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
    surface: Isosurface, camera_to_world: np.ndarray, intrinsics: Intrinsics, pixels: np.ndarray
) -> np.ndarray:
    """Share of each pixel that the surface covers; (P,)."""
    rays = _pixel_rays(camera_to_world, intrinsics, pixels, _offsets(COVER_SIDE))
    return (surface.caster.first_hit(*rays)[1] >= 0).reshape(len(pixels), COVER_SIDE**2).mean(1)


def _varies(values: np.ndarray, height: int, width: int, tolerance: float) -> np.ndarray:
    """Pixels whose 3x3 neighbourhood differs by more than a tolerance; (H*W,) bool."""
    image = values.reshape(height, width, -1)
    window = (3, 3, 1)
    spread = maximum_filter(image, window) - minimum_filter(image, window)
    return (spread > tolerance).any(-1).ravel()


def _select(samples: SurfaceSamples, index: np.ndarray) -> SurfaceSamples:
    rows = torch.from_numpy(index)
    return SurfaceSamples(*(getattr(samples, name)[rows] for name in SurfaceSamples.__dataclass_fields__))


def _concatenate(a: SurfaceSamples, b: SurfaceSamples) -> SurfaceSamples:
    fields = SurfaceSamples.__dataclass_fields__
    return SurfaceSamples(*(torch.cat([getattr(a, name), getattr(b, name)]) for name in fields))
