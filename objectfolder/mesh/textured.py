"""A triangle mesh with its appearance: the form in which meshes travel between load, generate and render."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

DEFAULT_ROUGHNESS = 0.5  # where the source does not say (scans: the texture holds the gloss)


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles, one texture, and what a renderer needs to shade them."""

    vertices: np.ndarray  #: (V, 3) float64, split at texture seams
    faces: np.ndarray  #: (F, 3) int64, counter-clockwise seen from outside
    uv: np.ndarray | None = None  #: (V, 2) float64, origin at the lower left of the texture
    texture: np.ndarray | None = None  #: (H, W, 3) uint8, sRGB
    vertex_colors: np.ndarray | None = None  #: (V, 3) uint8, sRGB; used when there is no texture
    roughness: float | None = None  #: principled roughness, None where the source does not say
    metallic: float | None = None  #: principled metallic, None where the source does not say

    def with_vertices(self, vertices: np.ndarray) -> "TexturedMesh":
        """Return the same mesh with moved vertices."""
        return replace(self, vertices=np.asarray(vertices, np.float64))

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) corners of the axis-aligned bounding box of the vertices that faces use."""
        used = self.vertices[np.unique(self.faces)]
        return np.stack([used.min(0), used.max(0)])

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return a `trimesh.Trimesh` with a PBR material or vertex colours; nothing is merged."""
        if self.uv is not None and self.texture is not None:
            material = trimesh.visual.material.PBRMaterial(
                baseColorTexture=Image.fromarray(self.texture),
                # Always written: glTF takes a factor that is absent for 1.
                roughnessFactor=DEFAULT_ROUGHNESS if self.roughness is None else self.roughness,
                metallicFactor=self.metallic or 0.0,
            )
            visual: Any = trimesh.visual.TextureVisuals(uv=self.uv, material=material)
        else:
            visual = trimesh.visual.ColorVisuals(vertex_colors=self.vertex_colors)
        return trimesh.Trimesh(self.vertices, self.faces, visual=visual, process=False)

    def write_glb(self, path: str | Path) -> None:
        """Write a binary glTF; turned y up, as the format demands and `load_mesh` expects of it."""
        x, y, z = self.vertices.T
        upright = self.with_vertices(np.stack([x, z, -y], 1))
        Path(path).write_bytes(trimesh.Scene(upright.to_trimesh()).export(file_type="glb"))
