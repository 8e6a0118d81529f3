"""Content of a mesh file: parts of a mesh, each with one surface material."""

from dataclasses import dataclass, field

import numpy as np
from PIL import Image


@dataclass(frozen=True, eq=False)
class SurfaceMaterial:
    """Base colour, roughness and metallic factor of a surface."""

    image: Image.Image | None = None  #: sRGB base colour texture, RGB
    color: np.ndarray | None = None  #: (3,) linear base colour, multiplies `image`; None: unspecified
    roughness: float | None = None
    metallic: float | None = None
    wrap: tuple[str, str] = ("repeat", "repeat")  #: beyond [0, 1] in u and v: repeat, clamp or mirror


@dataclass(frozen=True)
class MeshPart:
    """Triangles of one surface material."""

    vertices: np.ndarray  #: (V, 3) float64
    faces: np.ndarray  #: (F, 3) int64, counter-clockwise seen from outside
    material: SurfaceMaterial
    uv: np.ndarray | None = None  #: (V, 2) float64, origin at the lower left of the image
    colors: np.ndarray | None = None  #: (V, 3) linear colours in [0, 1], multiply the material's
    normals: np.ndarray | None = None  #: (V, 3) as in the file, any length; None if the file has none

    @property
    def used(self) -> np.ndarray:
        """(V,) bool, whether any face uses the vertex."""
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        return used


@dataclass(frozen=True)
class MeshContent:
    """Content of a mesh file."""

    parts: list[MeshPart]
    notes: list[str] = field(default_factory=list)  #: what of its appearance was dropped, in words


def split_by_face_color(colors: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Duplicate vertices by face colour; return colours (V', 3), original vertices (V',), faces (F, 3)."""
    palette, color = np.unique(colors, axis=0, return_inverse=True)
    corner = faces * len(palette) + color.reshape(-1, 1)
    kept, renumbered = np.unique(corner, return_inverse=True)
    return palette[kept % len(palette)], kept // len(palette), renumbered.reshape(-1, 3)


def color_unit(brightest: float) -> int:
    """Return what stands for full brightness in a format that leaves open whether it is 1 or 255."""
    return 255 if brightest >= 2 else 1  # fractions may be a little above 1
