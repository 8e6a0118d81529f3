"""Decode pictures that a user gives: of known formats, and not too large."""

import warnings
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from objectfolder.base.errors import ObjectFolderError, shortened

# No others: Pillow passes some to programs, such as EPS to Ghostscript.
PICTURE_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")  #: that are opened
MAX_SIDE = 8192  #: pixels, of a square picture; others may have as many pixels


def decoded(source: Path | BinaryIO, where: str, mode: str = "RGB", upright: bool = False) -> Image.Image:
    """Decode a picture into Pillow's pixels ``mode``, upright as its EXIF orientation says if asked.

    Raises ObjectFolderError, which begins with ``where``, if it is damaged, not in one of `PICTURE_FORMATS`,
    or has more pixels than a square of `MAX_SIDE`.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about odd metadata, and sizes, which are checked here
            with Image.open(source, formats=PICTURE_FORMATS) as stored:
                if stored.width * stored.height <= MAX_SIDE**2:  # known from the header alone
                    return _in_bytes(ImageOps.exif_transpose(stored) if upright else stored).convert(mode)
                size = f"{stored.width} x {stored.height}"
    except Image.DecompressionBombError:
        size = f"more than {2 * (Image.MAX_IMAGE_PIXELS or 0)}"
    except Exception as error:  # decoders raise anything
        reason = "unknown format" if isinstance(error, UnidentifiedImageError) else shortened(error, 200)
        problem, known = f"{where} cannot be read as an image ({reason})", ", ".join(PICTURE_FORMATS)
        raise ObjectFolderError(f"{problem}; expected {known}") from error
    raise ObjectFolderError(f"{where} has {size} pixels, expected at most {MAX_SIDE} x {MAX_SIDE}; resize it")


def png_bytes(image: np.ndarray) -> bytes:
    """Return an image (H, W) or (H, W, 3) uint8 as PNG."""
    stream = BytesIO()
    Image.fromarray(image).save(stream, "PNG")
    return stream.getvalue()


def _in_bytes(image: Image.Image) -> Image.Image:
    """Scale greys of 16 bits, and those from 0 to 1, to 8 bits; Pillow would clip them."""
    if image.mode != "F" and not image.mode.startswith("I"):
        return image
    greys = np.nan_to_num(np.asarray(image, np.float64)) * (255 if image.mode == "F" else 1 / 257)
    return Image.fromarray(np.rint(greys.clip(0, 255)).astype(np.uint8))
