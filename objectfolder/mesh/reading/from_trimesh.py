"""Shared code of the readers: files and materials for trimesh, polygons, colours."""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from trimesh.resolvers import Resolver

from objectfolder.mesh import srgb
from objectfolder.mesh.polygon import fan
from objectfolder.mesh.reading.files import read_image, read_referenced
from objectfolder.mesh.reading.parts import SurfaceMaterial

NAME = "file"  # entry of a stand-in's metadata


class ReferencedFiles(Resolver):
    """Resolver that decodes the images a mesh names, in place of trimesh.

    trimesh opens images of every format and swallows errors. It gets stand-ins, see `surface_material`.
    """

    def __init__(self, path: Path):
        self.path = path
        self.images: dict[str, Image.Image] = {}
        self.error: Exception | None = None

    def get(self, key: str) -> bytes:
        """Return the bytes that stand for a file, for trimesh."""
        try:
            return self.read(key)
        except Exception as error:  # raised by `check`
            self.error = self.error or error
            return _stand_in(key)

    def read(self, key: str) -> bytes:
        """Decode an image, and return its stand-in."""
        if key not in self.images:
            data = read_referenced(self.path, key)
            self.images[key] = read_image(data, self.path.parent / key, self.path)
        return _stand_in(key)

    def check(self) -> None:
        """Raise the first error of any file."""
        if self.error is not None:
            raise self.error

    def write(self, name: str, data: Any) -> None:
        """Refuse: nothing is written."""
        raise NotImplementedError

    def namespaced(self, namespace: str) -> Any:
        """Refuse: there is one namespace."""
        raise NotImplementedError

    def keys(self) -> list[str]:
        """Return no names: trimesh must ask for each file."""
        return []


def _stand_in(key: str) -> bytes:
    """Return an image of one pixel that carries the name of a file."""
    note, stream = PngInfo(), BytesIO()
    note.add_text(NAME, key)
    Image.new("RGB", (1, 1)).save(stream, "png", pnginfo=note)
    return stream.getvalue()


def surface_material(source: Any, images: Mapping[str, Image.Image]) -> SurfaceMaterial:
    """Convert a trimesh material, whose colours are sRGB, and whose image stands for one of ``images``."""
    if source is None:
        return SurfaceMaterial()
    image: Image.Image | None = getattr(source, "image", None)
    if image is not None:
        return SurfaceMaterial(images[image.info[NAME]])
    return SurfaceMaterial(color=srgb.decode(np.asarray(source.main_color[:3]) / 255))


def as_points(values: Any) -> np.ndarray:
    """Return positions or normals as (V, 3) float64."""
    return np.asarray(values, np.float64).reshape(-1, 3)


def fan_triangles(values: Any) -> np.ndarray:
    """Split polygons (P, n) into triangle fans; (F, 3)."""
    polygons = np.asarray(values, np.int64)
    return polygons[:, fan(polygons.shape[1])].reshape(-1, 3)


def split_by_face_color(colors: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Duplicate vertices by face colour; return colours (V', 3), original vertices (V',), faces (F, 3)."""
    palette, color = np.unique(colors, axis=0, return_inverse=True)
    corner = faces * len(palette) + color.reshape(-1, 1)
    kept, renumbered = np.unique(corner, return_inverse=True)
    return palette[kept % len(palette)], kept // len(palette), renumbered.reshape(-1, 3)


def color_unit(brightest: float) -> int:
    """Return what stands for full brightness in a format that leaves open whether it is 1 or 255."""
    return 255 if brightest > 1 else 1
