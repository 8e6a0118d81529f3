"""Rendering of a stored surface, supersampled at edges of the image."""

from collections.abc import Callable

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.vision.cameras import Intrinsics, PixelRays, covered_rectangle
from objectfolder.vision.picture import Picture
from objectfolder.vision.trace import SurfaceSamples, trace

CREASE = 0.35  # difference of neighbouring unit normals
SIDE = 3  # edge pixels have SIDE x SIDE samples, one of them at the centre
EXTRA_SAMPLES = SIDE**2 - 1
AXIS = (np.arange(SIDE, dtype=np.float32) + 0.5) / SIDE
_SAMPLES = np.stack(np.meshgrid(AXIS, AXIS)).reshape(2, -1)
AROUND = np.delete(_SAMPLES, EXTRA_SAMPLES // 2, axis=1)  # x, y off the centre
HALVINGS = 4  # bisections of the interval between two samples that contains a silhouette
END = np.float32(1 / 64)  # pixels; a line that is hit this near to its end is covered up to the end
TILE = 2**18  # pixels drawn at once, to bound the memory of a large image
SQUARE_SIDE = 4
SQUARE = SQUARE_SIDE**2  # pixels of a square that may share light
STRIP = 8  # rows whose rays are cast column by column
MARGIN = SQUARE_SIDE + 1  # pixels around a tile that its own pixels depend on

#: Samples, light (3,) or (4,) and pixel (S,) of each sample -> linear radiance (S, 3). ``pixel // SQUARE``
#: numbers squares of pixels.
Shader = Callable[[SurfaceSamples, torch.Tensor, np.ndarray], torch.Tensor]
#: Colour (3, N), hit or coverage (N,), depth (N,) and normal (3, N) of N rays.
Images = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@torch.inference_mode()
def draw(
    surface: Isosurface,
    shade: Shader,
    camera_to_world: np.ndarray,
    light: np.ndarray,
    intrinsics: Intrinsics,
    supersample: bool = True,
) -> Picture:
    """Render one view of a stored surface.

    Casts one ray through every pixel that the object may cover, and a square of samples through pixels that
    silhouettes, shadow edges or creases cross, unless ``supersample`` is false: faster, with aliased edges.
    On silhouettes, more rays measure the coverage of the pixel. Large images are drawn a few rows at a time.
    Lights (3,) or (4,) are those of `objectfolder.vision.lighting.toward`.

    Depth and normal are those of the ray through the pixel's centre; where it misses, of the nearest sample
    that hits. Normals are those of the stored surface, not the net's shading normals; a camera inside the
    object sees their back.
    """
    height, width = intrinsics.height, intrinsics.width
    rgba = np.zeros((height, width, 4), np.float32)
    depth = np.full((height, width), np.inf, np.float32)
    normals = np.zeros((height, width, 3), np.float32)
    corners = np.array(np.meshgrid(*surface.bounds.T)).reshape(3, -1).T
    left, top, right, bottom = covered_rectangle(corners, camera_to_world, intrinsics)
    rows, columns = max(TILE // max(right - left, 1), 1), slice(left, right)
    for start in range(top, bottom if left < right else top, rows):
        stop = min(start + rows, bottom)
        first, last = max(start - MARGIN, top), min(stop + MARGIN, bottom)
        rays = PixelRays(camera_to_world, intrinsics, left, first, right, last)
        inner = slice(start - first, stop - first)
        for whole, part in zip((rgba, depth, normals), _draw(surface, shade, rays, light, supersample)):
            whole[start:stop, columns] = part[inner]
    return Picture(rgba, depth, normals)


def _draw(
    surface: Isosurface, shade: Shader, rays: PixelRays, light: np.ndarray, supersample: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return linear premultiplied RGBA, depth and normals of a part of an image."""
    height, width = rays.shape
    light = np.asarray(light, np.float32)
    order = rays.in_strips(STRIP)
    centre = trace(surface, rays.origin, rays.centres().T.take(order, 1).T, light)
    seen = order.take(centre.ray.numpy())
    images = color, alpha, depth, normals = _images(height * width)
    alpha[seen], depth[seen] = 1, centre.distance.numpy()
    _put(normals, seen, centre.normals.numpy().T)
    samples, edges, finer = centre, np.zeros(0, np.int64), 0
    if supersample:
        state = np.zeros(height * width, np.float32)
        state[seen] = 10 * (1 + centre.lit.numpy())  # differs by more than normals can
        edges = order[_varies(np.concatenate([normals, state[None]]), rays.shape, CREASE)[order]]
    pixel = seen
    if len(edges):
        around = rays.through(np.repeat(edges, EXTRA_SAMPLES), *np.tile(AROUND, len(edges)))
        fine = trace(surface, rays.origin, around, light)
        ray = fine.ray.numpy()
        samples, finer = fine.join(centre), len(ray)
        pixel = np.concatenate([edges[ray // EXTRA_SAMPLES], seen])
    if not len(pixel):
        return _shaped(images, rays.shape)
    radiance = shade(samples, torch.from_numpy(light), rays.by_squares(pixel, SQUARE_SIDE)).numpy().T
    _put(color, seen, radiance[:, finer:])
    if len(edges):
        found = _images(len(edges) * EXTRA_SAMPLES)
        found[1][ray], found[2][ray] = 1, fine.distance.numpy()
        _put(found[0], ray, radiance[:, :finer])
        _put(found[3], ray, fine.normals.numpy().T)
        _refine(surface, rays, edges, images, found)
    return _shaped(images, rays.shape)


def _put(image: np.ndarray, index: np.ndarray, values: np.ndarray) -> None:
    """Set pixels (K,) of an image (C, N) to values (C, K); several times faster than in one assignment."""
    for channel, of_channel in zip(image, values):
        channel[index] = of_channel


def _images(count: int) -> Images:
    """Return colour, coverage, depth and normal of rays that miss."""
    zeros, infinite = np.zeros((7, count), np.float32), np.full(count, np.inf, np.float32)
    return zeros[:3], zeros[3], infinite, zeros[4:]


def _shaped(images: Images, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reshape to linear premultiplied RGBA (H, W, 4), depth (H, W) and normals (H, W, 3)."""
    color, alpha, depth, normals = images
    rgba = np.concatenate([color * alpha, alpha[None]])
    return rgba.T.reshape(*shape, 4), depth.reshape(shape), normals.T.reshape(*shape, 3)


def _refine(surface: Isosurface, rays: PixelRays, edges: np.ndarray, images: Images, found: Images) -> None:
    """Update images in place with the additional samples ``found`` of edge pixels (E,)."""
    color, alpha, depth, normals = images
    hit = np.insert(found[1].reshape(-1, EXTRA_SAMPLES), EXTRA_SAMPLES // 2, alpha[edges], axis=1) > 0
    hits = hit.sum(1, dtype=np.float32)
    summed = color[:, edges] + found[0].reshape(3, -1, EXTRA_SAMPLES).sum(2)
    color[:, edges] = summed / np.maximum(hits, 1)
    alpha[edges] = hits / SIDE**2
    silhouette = np.flatnonzero(_varies(alpha[None], rays.shape, 0)[edges] & (hits > 0))
    pixels = edges[silhouette]
    lines = hit[silhouette].reshape(-1, SIDE, SIDE)
    alpha[pixels] = _coverage(surface, rays, pixels, lines, _slopes(alpha.reshape(rays.shape), pixels))
    # Where the centre misses, take the nearest of the others.
    missed = np.flatnonzero(np.isinf(depth[edges]))
    nearest = EXTRA_SAMPLES * missed + found[2].reshape(-1, EXTRA_SAMPLES)[missed].argmin(1)
    depth[edges[missed]], normals[:, edges[missed]] = found[2][nearest], found[3][:, nearest]
    empty = edges[alpha[edges] == 0]
    depth[empty], normals[:, empty] = np.inf, 0


def _slopes(image: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return differences of an image down the rows and along the columns at some pixels; (P,) each."""
    padded = np.pad(image, 1, mode="edge")
    row, column = np.divmod(pixels, image.shape[1])
    down = padded[row + 2, column + 1] - padded[row, column + 1]
    return down, padded[row + 1, column + 2] - padded[row + 1, column]


def _coverage(
    surface: Isosurface,
    rays: PixelRays,
    pixels: np.ndarray,
    hit: np.ndarray,
    slopes: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Return the coverage of each pixel by the surface; (P,).

    Each pixel's samples, hit or not (P, SIDE, SIDE), form lines across the silhouette. A line is covered from
    one cut to another or to its end. Each cut lies between a sample that hits and one that misses, or the end
    of the line; bisection finds it. Slopes (P,) are those of the coverage down the rows and along the
    columns.
    """
    down, along = slopes
    upright = np.abs(down) >= np.abs(along)
    grows = np.where(upright, down, along) >= 0
    # Lines (P, SIDE) of samples, each from the bare side to the covered one.
    hit = np.where(upright[:, None, None], hit.transpose(0, 2, 1), hit)
    hit = np.where(grows[:, None, None], hit, hit[:, :, ::-1]).reshape(-1, SIDE)
    pixel, upright, grows = (np.repeat(of_pixel, SIDE) for of_pixel in (pixels, upright, grows))
    across = np.tile(AXIS, len(pixels))

    def met(line: np.ndarray, position: np.ndarray) -> np.ndarray:
        forward = np.where(grows[line], position, 1 - position)
        x, y = np.where(upright[line], (across[line], forward), (forward, across[line]))
        return surface.caster.occluded(rays.origin, rays.through(pixel[line], x, y))

    first, last = hit.argmax(1), SIDE - 1 - hit[:, ::-1].argmax(1)
    some = np.logical_or.reduce(hit, axis=1)
    begin, end = np.zeros(len(hit), np.float32), some.astype(np.float32)
    # The line's ends: the bare one, if the sample next to it hits; the covered one, if no sample does.
    ends = np.flatnonzero(~some | (first == 0))
    reached = met(ends, np.where(some[ends], END, 1 - END))
    end[ends[reached]] = 1
    whole = np.zeros(len(hit), bool)
    whole[ends] = some[ends] == reached
    bare, far = np.flatnonzero(~whole), np.flatnonzero(some & (last < SIDE - 1))
    # Line of each cut, and the nearest positions on it that hit and that miss.
    line = np.concatenate([bare, far])
    hits = np.concatenate([np.where(some[bare], AXIS[first[bare]], 1 - END), AXIS[last[far]]])
    below = np.where(first[bare] > 0, AXIS[first[bare] - 1], END)
    misses = np.concatenate([np.where(some[bare], below, AXIS[-1]), AXIS[(last[far] + 1) % SIDE]])
    for _ in range(HALVINGS):
        middle = (hits + misses) / 2
        reached = met(line, middle)
        hits, misses = np.where(reached, middle, hits), np.where(reached, misses, middle)
    cut = (hits + misses) / 2
    begin[bare], end[far] = cut[: len(bare)], cut[len(bare) :]
    return (end - begin).reshape(-1, SIDE).mean(1)


def _varies(values: np.ndarray, shape: tuple[int, int], tolerance: float) -> np.ndarray:
    """Return which pixels of (K, H*W) values differ from one of eight neighbours by more than a tolerance."""
    height, width = shape
    varies = np.zeros(shape, bool)
    for image in values.reshape(-1, height, width):
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            # Each pixel against one neighbour; both are marked.
            here = slice(0, height - down), slice(max(-right, 0), width - max(right, 0))
            there = slice(down, height), slice(max(right, 0), width + min(right, 0))
            apart = np.abs(image[here] - image[there]) > tolerance
            varies[here] |= apart
            varies[there] |= apart
    return varies.ravel()
