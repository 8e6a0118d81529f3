"""Read pictures of radiance as their headers say: Radiance, OpenEXR and PFM."""

import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError, shortened

RADIANCE_SUFFIXES = (".hdr", ".exr", ".pfm")
MAX_PIXELS = 2**27  #: of a picture


def read_radiance(path: Path) -> np.ndarray:
    """Read a picture of linear radiance, upright and in the units of its header; (H, W, 3).

    The pixels are decoded by mitsuba. What it leaves out is done here: exposure, colour correction,
    orientation and old run lengths of Radiance files, and the display window of OpenEXR files.

    Raises
    ------
    ObjectFolderError
        If the picture cannot be read, is a cube map, has a gamma or colours in XYZ, or mitsuba is missing.
    """
    try:
        import mitsuba  # noqa: F401
    except ModuleNotFoundError as error:
        raise ObjectFolderError(
            f"{path} needs mitsuba, which the extra objectfolder[build] brings; or pass an array (H, W, 3)"
        ) from error
    try:
        data = path.read_bytes()
        if data[:2] == b"#?":
            return _read_rgbe(data)
        if data[:4] == b"v/1\x01":
            return _read_exr(data)
        if data[:2] in (b"PF", b"Pf"):
            return _decode(data)
        raise ValueError("it begins like none of Radiance, OpenEXR and PFM files")
    except Exception as error:  # the decoders raise anything
        raise ObjectFolderError(f"{path} cannot be read as a picture ({shortened(error, 200)})") from error


def _decode(data: bytes) -> np.ndarray:
    """Decode the pixels of a file that mitsuba knows; (H, W, 3)."""
    import mitsuba

    with _workers():
        stream = mitsuba.MemoryStream(len(data))
        stream.write(data)
        stream.seek(0)
        bitmap: Any = mitsuba.Bitmap(stream)
        struct = bitmap.struct_()
        names = [struct[place].name for place in range(len(struct))]
        pixels = np.array(bitmap, np.float64)
    pixels = pixels.reshape(*pixels.shape[:2], len(names))
    # Channels of a layer begin with its name. Beside the colours may be depth and other things.
    layers = [name[:-1] for name in names if name.endswith("R") and {name[:-1] + c for c in "GB"} < {*names}]
    if not layers and "Y" in names:
        return np.repeat(pixels[..., names.index("Y"), None], 3, -1)
    if "" not in layers and len(layers) != 1:
        found = ", ".join(layer.rstrip(".") for layer in layers) or "none"
        raise ValueError(f"it has layers of colours R, G and B: {found}; expected one, export it alone")
    layer = "" if "" in layers else layers[0]
    return pixels[..., [names.index(layer + color) for color in "RGB"]]


@contextmanager
def _workers() -> Iterator[None]:
    """Give Dr.Jit two threads: with one, as renderers set it, mitsuba waits forever for an EXR file."""
    import drjit

    before = drjit.thread_count()
    drjit.set_thread_count(max(before, 2))
    try:
        yield
    finally:
        drjit.set_thread_count(before)


def _read_rgbe(data: bytes) -> np.ndarray:
    """Read a Radiance picture; Ward, "Real Pixels" (Graphics Gems II), and the manual of its file formats."""
    size = re.search(rb"\n\r?\n([+-])([XY]) +(\d+) +([+-])([XY]) +(\d+) *\r?\n", data)
    if size is None or size[2] == size[5]:
        raise ValueError("it has no line of its size such as '-Y 512 +X 1024' after an empty line")
    header, lines, length = data[: size.start()].decode("latin-1"), int(size[3]), int(size[6])
    if "32-bit_rle_xyze" in header:
        raise ValueError("its colours are XYZ, expected RGB; convert it with ra_xyze -r")
    if lines * length > MAX_PIXELS:
        raise ValueError(f"it has {lines} x {length} pixels, expected at most {MAX_PIXELS}; resize it")
    factor = np.ones(3)
    for name, value in re.findall(r"^ *(EXPOSURE|COLORCORR|GAMMA) *= *(.*?)\s*$", header, re.MULTILINE):
        numbers = np.array([float(number) for number in value.split()])
        if name == "GAMMA" and (numbers != 1).any():
            raise ValueError(f"its gamma is {value}, expected linear radiance: 1")
        factor *= numbers
    if not (np.isfinite(factor).all() and (factor > 0).all()):
        raise ValueError("its EXPOSURE or COLORCORR is not a positive number")
    body = data[size.end() :]
    if body[:2] == b"\2\2" and body[2:3] < b"\x80" and 8 <= length < 2**15:  # run lengths of each channel
        plain = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (lines, length)
        pixels = _decode(plain + body)
    else:
        pixels = _flat_rgbe(body, lines * length).reshape(lines, length, 3)
    pixels /= factor
    # The first axis named goes from line to line. Upright is -Y +X.
    if size[2] == b"X":
        pixels = pixels.swapaxes(0, 1)
    signs = {size[2]: size[1], size[5]: size[4]}
    return pixels[:: 1 if signs[b"Y"] == b"-" else -1, :: 1 if signs[b"X"] == b"+" else -1]


def _flat_rgbe(body: bytes, count: int) -> np.ndarray:
    """Return the pixels of four bytes each; (count, 3). 1, 1, 1, n repeats the pixel before n times."""
    values = np.frombuffer(body, np.uint8, len(body) // 4 * 4).reshape(-1, 4)
    repeats = (values[:, :3] == 1).all(1)
    place = np.arange(len(values))
    first = np.maximum.accumulate(np.where(repeats, 0, place))  # the pixel that each one repeats
    digits = 8 * np.clip(place - first - 1, 0, 7)  # runs in a row are the digits of one number
    times = np.where(repeats, values[:, 3].astype(np.int64) << digits, 1)
    ends = np.cumsum(times)
    needed = int(np.searchsorted(ends, count)) + 1
    if needed > len(values) or repeats[:1].any() or ends[needed - 1] != count:
        raise ValueError(f"its pixels are not the {count} of its header")
    source = values[np.repeat(first[:needed], times[:needed])].astype(np.float64)
    return np.where(source[:, 3:] > 0, np.ldexp(source[:, :3], source[:, 3:].astype(int) - 136), 0)


def _read_exr(data: bytes) -> np.ndarray:
    """Read an OpenEXR picture; it is black outside of its data window, and cut at its display window."""
    attributes = dict(_exr_attributes(data))
    if attributes.get(b"envmap", b"\0") != b"\0":
        raise ValueError("it is a cube map, expected an equirectangular picture; convert it")
    left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
    x0, y0, x1, y1 = struct.unpack("<4i", attributes[b"displayWindow"])
    if max(x1 - x0, right - left) * max(y1 - y0, bottom - top) > MAX_PIXELS:
        raise ValueError(f"its windows have more than {MAX_PIXELS} pixels; resize it")
    pixels = _decode(data)
    if pixels.shape[:2] != (bottom - top + 1, right - left + 1):
        raise ValueError(f"its pixels are {pixels.shape[:2]}, its data window says otherwise")
    whole = np.zeros((y1 - y0 + 1, x1 - x0 + 1, 3))
    rows = slice(max(top, y0), max(min(bottom, y1) + 1, max(top, y0)))
    columns = slice(max(left, x0), max(min(right, x1) + 1, max(left, x0)))
    whole[rows.start - y0 : rows.stop - y0, columns.start - x0 : columns.stop - x0] = pixels[
        rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
    ]
    return whole


def _exr_attributes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the names and values of the first part's header."""
    place = 8
    while data[place]:
        name, kind = data[place : place + 512].split(b"\0", 2)[:2]
        place += len(name) + len(kind) + 2
        (size,) = struct.unpack_from("<i", data, place)
        yield name, data[place + 4 : place + 4 + size]
        place += 4 + size
