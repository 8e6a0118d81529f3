"""Shared code of the readers built on trimesh: referenced files, materials, polygons."""

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from trimesh.resolvers import Resolver

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.reading.files import read_image, read_referenced
from objectfolder.mesh.reading.parts import SurfaceMaterial


class ReferencedFiles(Resolver):
    """Resolver that gives trimesh the images a mesh names, and keeps the errors that trimesh swallows."""

    def __init__(self, path: Path):
        self.path = path
        self.error: ObjectFolderError | None = None

    def get(self, key: str) -> bytes:
        """Return the bytes of a file, for trimesh."""
        try:
            return self.read(key)
        except ObjectFolderError as error:
            self.error = self.error or error
            raise

    def read(self, key: str) -> bytes:
        """Return the bytes of a file; raise if it is not an image."""
        data = read_referenced(self.path, key)
        read_image(data, self.path.parent / key, self.path)
        return data

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


def surface_material(source: Any) -> SurfaceMaterial:
    """Convert a trimesh material, whose colours are sRGB."""
    if source is None:
        return SurfaceMaterial()
    image: Image.Image | None = getattr(source, "image", None) or getattr(source, "baseColorTexture", None)
    if image is not None:
        return SurfaceMaterial(image.convert("RGB"))
    return SurfaceMaterial(color=srgb.decode(np.asarray(source.main_color[:3]) / 255))


def as_points(values: Any) -> np.ndarray:
    """Return positions or normals as (V, 3) float64."""
    return np.asarray(values, np.float64).reshape(-1, 3)


def fan_triangles(values: Any) -> np.ndarray:
    """Split polygons (P, n) into triangle fans; (F, 3)."""
    polygons = np.asarray(values, np.int64)
    corner = np.arange(1, polygons.shape[1] - 1)
    fans = np.stack([np.zeros_like(corner), corner, corner + 1], 1)
    return polygons[:, fans].reshape(-1, 3)
