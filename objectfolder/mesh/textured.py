"""Triangle mesh with its appearance, the common form of loaded, generated and rendered meshes."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from objectfolder.mesh import normals, srgb

DEFAULT_ROUGHNESS = 0.5  # where the source has none (scans: the texture contains the gloss)
PLAIN = 0.6  # linear base colour where the source has none
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963  # glTF buffer targets of vertex and index data


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles with one texture or vertex colours, and principled shading parameters."""

    vertices: np.ndarray  #: (V, 3) float64, split at texture seams and creases
    faces: np.ndarray  #: (F, 3) int64, counter-clockwise seen from outside
    uv: np.ndarray | None = None  #: (V, 2) float64, origin at the lower left of the repeating texture
    texture: np.ndarray | None = None  #: (H, W, 3) uint8, sRGB
    vertex_colors: np.ndarray | None = None  #: (V, 3) uint8, sRGB; used when there is no texture
    roughness: float | None = None  #: principled roughness; None: unspecified by the source
    metallic: float | None = None  #: principled metallic; None: unspecified by the source
    normals: np.ndarray | None = None  #: (V, 3) float64, unit; None: flat shading
    source: dict[str, Any] = field(default_factory=dict)  #: findings of the loader, see `appearance_report`

    def with_vertices(self, vertices: np.ndarray) -> "TexturedMesh":
        """Return the mesh with moved or uniformly scaled vertices; normals stay."""
        return replace(self, vertices=np.asarray(vertices, np.float64))

    def rotate(self, turn: Callable[[np.ndarray], np.ndarray]) -> "TexturedMesh":
        """Return the mesh rotated by a function of vectors (N, 3)."""
        turned = None if self.normals is None else turn(self.normals)
        return replace(self, vertices=turn(self.vertices), normals=turned)

    def with_normals(self, corners: np.ndarray) -> "TexturedMesh":
        """Return the mesh with unit normals (F, 3, 3) of its faces' corners.

        Vertices whose corners differ are duplicated; duplicates follow all vertices.
        """
        vertex, faces, of_vertices = normals.split_vertices(self.faces, corners, len(self.vertices))
        return replace(
            self,
            vertices=self.vertices[vertex],
            faces=faces,
            uv=None if self.uv is None else self.uv[vertex],
            vertex_colors=None if self.vertex_colors is None else self.vertex_colors[vertex],
            normals=of_vertices,
        )

    def with_smooth_normals(self) -> "TexturedMesh":
        """Return the mesh with smooth normals and creases, see `objectfolder.mesh.normals.crease_normals`."""
        return self.with_normals(normals.crease_normals(self.vertices, self.faces))

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) axis-aligned bounding box of the vertices used by faces."""
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        return np.stack([self.vertices[used].min(0), self.vertices[used].max(0)])

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return a `trimesh.Trimesh` with a PBR material, vertices unmerged.

        Vertex colours are the attribute ``_COLOR_0``, linear as in glTF.
        """
        textured = self.uv is not None and self.texture is not None
        visual: Any = None
        attributes: dict[str, Any] = {}
        if textured or self.vertex_colors is not None or (self.roughness, self.metallic) != (None, None):
            plain = not textured and self.vertex_colors is None
            material = trimesh.visual.material.PBRMaterial(
                baseColorFactor=[PLAIN, PLAIN, PLAIN, 1.0] if plain else None,
                baseColorTexture=Image.fromarray(self.texture)
                if textured and self.texture is not None
                else None,
                # Always written: an absent glTF factor means 1.
                roughnessFactor=DEFAULT_ROUGHNESS if self.roughness is None else self.roughness,
                metallicFactor=self.metallic or 0.0,
            )
            visual = trimesh.visual.TextureVisuals(uv=self.uv if textured else None, material=material)
        if not textured and self.vertex_colors is not None:
            attributes["_COLOR_0"] = np.float32(srgb.decode(self.vertex_colors / 255))
        return trimesh.Trimesh(
            self.vertices,
            self.faces,
            vertex_normals=self.normals,
            visual=visual,
            vertex_attributes=attributes,
            process=False,
        )

    def write_glb(self, path: str | Path) -> None:
        """Write a binary glTF, rotated y up as the format requires."""
        scene = trimesh.Scene(self.rotate(y_up).to_trimesh())
        Path(path).write_bytes(scene.export(file_type="glb", tree_postprocessor=complete_document))


def y_up(vectors: np.ndarray) -> np.ndarray:
    """Rotate vectors (N, 3) from z up to y up."""
    x, y, z = vectors.T
    return np.stack([x, z, -y], 1)


def z_up(vectors: np.ndarray) -> np.ndarray:
    """Rotate vectors (N, 3) from y up to z up."""
    x, y, z = vectors.T
    return np.stack([x, -z, y], 1)


def appearance_report(mesh: TexturedMesh) -> dict[str, Any]:
    """Return the appearance of a mesh and the changes that loading made to it.

    Parameters
    ----------
    mesh : TexturedMesh

    Returns
    -------
    dict
        ``texture_size`` ([width, height] or None), ``vertex_colors`` (bool), ``vertex_normals`` (bool; False:
        flat shading), ``roughness``, ``metallic``. A loaded mesh also has ``materials`` (number in the
        source), ``source_texture_size`` (longest side, pixels), the fractions of faces
        ``uv_degenerate_fraction`` (no area in a texture larger than a pixel), ``uv_outside_fraction`` (beyond
        [0, 1], where textures repeat) and ``uv_not_finite_fraction``, the fraction of normals
        ``normals_bad_fraction`` that `objectfolder.mesh.normals.replace_bad_normals` replaced, and ``notes``.
    """
    return {
        "texture_size": None if mesh.texture is None else list(mesh.texture.shape[1::-1]),
        "vertex_colors": mesh.texture is None and mesh.vertex_colors is not None,
        "vertex_normals": mesh.normals is not None,
        "roughness": mesh.roughness,
        "metallic": mesh.metallic,
        **mesh.source,
    }


def complete_document(document: dict[str, Any]) -> None:
    """Complete the glTF document that trimesh exports.

    Renames the vertex colours to their standard name: trimesh's own export has 8 bits, too few for linear
    colours. Adds buffer targets, which some readers require.
    """
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            if "_COLOR_0" in attributes:
                attributes["COLOR_0"] = attributes.pop("_COLOR_0")
            targets = dict.fromkeys(attributes.values(), ARRAY_BUFFER)
            for accessor, target in {**targets, primitive["indices"]: ELEMENT_ARRAY_BUFFER}.items():
                document["bufferViews"][document["accessors"][accessor]["bufferView"]]["target"] = target
