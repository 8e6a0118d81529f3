"""Texels: colours of parts and images, scaled, repeated and sampled."""

import numpy as np
from PIL import Image

from objectfolder.mesh import srgb
from objectfolder.mesh.reading.parts import MeshPart, SurfaceMaterial
from objectfolder.mesh.textured import PLAIN


def base_color(part: MeshPart) -> np.ndarray:
    """Return the linear base colour (3,) of a part without an image."""
    color = part.material.color
    return np.full(3, 1.0 if part.colors is not None else PLAIN) if color is None else color


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    """Convert linear colours to sRGB bytes, clipped."""
    return np.rint(255 * srgb.encode(np.clip(linear, 0, 1))).astype(np.uint8)


def tint_pixels(material: SurfaceMaterial, image: Image.Image) -> np.ndarray:
    """Multiply an image by the material's colour; texels (H, W, 3) uint8."""
    pixels = np.asarray(image)
    if material.color is None or (material.color >= 1).all():
        return pixels
    return srgb_bytes(srgb.decode(pixels / 255) * material.color)


def texel_places(uv: np.ndarray | None, size: np.ndarray) -> np.ndarray:
    """Convert texture coordinates to texels (V, 2) of an image of that size, y down."""
    assert uv is not None
    return (uv * [1, -1] + [0, 1]) * size


def scale_image(image: Image.Image | None, size: np.ndarray) -> Image.Image:
    """Scale an image to a width and height."""
    assert image is not None
    width, height = map(int, size)
    return image if image.size == (width, height) else image.resize((width, height), Image.Resampling.LANCZOS)


def wrap_texels(index: np.ndarray, count: int, wrap: str) -> np.ndarray:
    """Return the texels of an image of ``count`` columns or rows that texels beyond it show."""
    if wrap == "clamp":
        return np.clip(index, 0, count - 1)
    if wrap == "mirror":
        index = index % (2 * count)
        return np.minimum(index, 2 * count - 1 - index)
    return index % count


def sample_texels(texels: np.ndarray, places: np.ndarray, wrap: tuple[str, str]) -> np.ndarray:
    """Sample texels (H, W, 3) uint8 bilinearly at texel coordinates (N, 2), y down; linear (N, 3)."""
    height, width = texels.shape[:2]
    low = np.floor(places - 0.5).astype(int)
    fx, fy = (places - 0.5 - low).T[:, :, None]
    x0, x1 = (wrap_texels(low[:, 0] + i, width, wrap[0]) for i in (0, 1))
    y0, y1 = (wrap_texels(low[:, 1] + i, height, wrap[1]) for i in (0, 1))
    a, b, c, d = (srgb.decode(texels[y, x] / 255) for y, x in ((y0, x0), (y0, x1), (y1, x0), (y1, x1)))
    linear: np.ndarray = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    return linear
