"""Framing: centre objects in views and normalize their size, since photographs do not tell distance."""

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image

from objectfolder.vision.color import on_white

SHARE = 0.8  #: length of an object's longer side relative to the frame; encoders crop to 7/8
OBJECT = 0.5  #: alpha above which a pixel belongs to the object
WHITE = 250  #: level, of 255, above which all channels are background


def frame_views(views: np.ndarray) -> np.ndarray:
    """Centre the objects in views, (B, S, S, 3) uint8 sRGB, on white, and scale them to `SHARE`, bilinearly.

    Empty views stay white.
    """
    side = views.shape[1]
    seen = np.any(views <= WHITE, axis=-1)
    boxes = [_extent(np.any(seen, axis=axis)) for axis in (1, 2)]  # of columns, of rows
    middle = np.stack([(low + high) / side - 1 for low, high in boxes], -1)
    length = np.maximum(*(high - low for low, high in boxes))
    scale = np.where(length > 0, length, side) / (SHARE * side)
    affine = np.zeros((len(views), 2, 3), np.float32)
    affine[:, 0, 0] = affine[:, 1, 1] = scale
    affine[:, :, 2] = middle
    dark = 255 - torch.from_numpy(views).movedim(-1, 1).float()  # padding with 0 is white
    grid = F.affine_grid(torch.from_numpy(affine), list(dark.shape), align_corners=False)
    moved = F.grid_sample(dark, grid, mode="bilinear", align_corners=False)
    return (255 - moved).round().byte().movedim(1, -1).numpy()


def _extent(marked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and one past the last mark of each row (B, S); 0 and S without marks."""
    return marked.argmax(1), marked.shape[1] - marked[:, ::-1].argmax(1)


def frame_cutout(rgba: np.ndarray, side: int) -> np.ndarray:
    """Frame a cut-out object on white, with the same size as in `frame_views`; (side, side, 3) uint8, sRGB.

    The picture (H, W, 4) is float32, linear, premultiplied, and not empty.
    """
    solid = rgba[..., 3] > OBJECT
    (top, bottom), (left, right) = (
        (found[0], found[-1] + 1) for found in (np.flatnonzero(solid.any(axis)) for axis in (1, 0))
    )
    half = max(bottom - top, right - left) / SHARE / 2
    row, column = (top + bottom) / 2, (left + right) / 2
    return composite(_window(rgba, row - half, column - half, 2 * half, side))


def composite(rgba: np.ndarray) -> np.ndarray:
    """Composite linear premultiplied RGBA (..., 4) on white; (..., 3) uint8, sRGB."""
    return np.round(on_white(torch.from_numpy(rgba)).numpy() * 255).astype(np.uint8)


def resize_picture(rgba: np.ndarray, side: int) -> np.ndarray:
    """Resample a whole square linear RGBA image; (side, side, 4) float32."""
    return _window(rgba, 0.0, 0.0, float(len(rgba)), side)


def _window(rgba: np.ndarray, top: float, left: float, length: float, side: int) -> np.ndarray:
    """Resample a square window, transparent beyond the image; (side, side, 4) float32."""
    first = np.floor([top, left]).astype(int)
    size = int(np.ceil(length)) + 1
    part = np.zeros((size, size, 4), np.float32)
    low = np.maximum(first, 0)
    high = np.minimum(first + size, rgba.shape[:2])
    a, b = low - first, high - first
    part[a[0] : b[0], a[1] : b[1]] = rgba[low[0] : high[0], low[1] : high[1]]
    y, x = top - first[0], left - first[1]
    box = (x, y, x + length, y + length)
    channels = [
        np.asarray(Image.fromarray(part[..., i]).resize((side, side), Image.Resampling.BILINEAR, box))
        for i in range(4)
    ]
    return np.stack(channels, -1)
