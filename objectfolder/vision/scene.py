"""Scene of the renderers: one object in the unit frame, its material and its lights."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.textured import DEFAULT_ROUGHNESS, PLAIN, TexturedMesh

LIGHT_INTENSITY = math.pi  #: of the point light: a white Lambertian surface at distance 1 has radiance 1
SPECULAR = 0.5  #: principled specular: a refractive index of 1.5
MIN_ROUGHNESS = 0.05  # a mirror would show a point light as nothing
BOUNCES = 2  #: of indirect light, after the direct light


@dataclass(frozen=True)
class Scene:
    """One object in the unit frame; camera and point light come with each view.

    The surface is a principled BSDF, seen from both sides. It is shaded with the mesh's vertex normals,
    interpolated over each face, or flat if it has none; its shape, outline and shadows are those of the faces
    in any case. Its base colour is the texture, if the mesh has one with coordinates; else its vertex
    colours; else grey. The background has alpha 0. Raises ObjectFolderError if the mesh has no faces or
    vertices that are not finite, or the ambient light is negative.
    """

    mesh: TexturedMesh
    ambient: float = 0.0  #: radiance from every direction, in addition to the point light

    def __post_init__(self) -> None:
        if not len(self.mesh.faces) or not np.isfinite(self.mesh.vertices).all():
            raise ObjectFolderError(
                "the mesh to render has no faces, or vertices that are not finite; build the object again"
            )
        if not 0 <= self.ambient < math.inf:
            raise ObjectFolderError(f"ambient light is {self.ambient}, expected a radiance of 0 or more")

    @property
    def base_color(self) -> Literal["texture", "vertices", "plain"]:
        """Source of the base colour."""
        if self.mesh.texture is not None and self.mesh.uv is not None:
            return "texture"
        return "plain" if self.mesh.vertex_colors is None else "vertices"

    @property
    def vertex_colors(self) -> np.ndarray:
        """(V, 3) float32, linear; grey where the mesh has none."""
        if self.mesh.vertex_colors is None:
            return np.full((len(self.mesh.vertices), 3), PLAIN, np.float32)
        return srgb.decode(self.mesh.vertex_colors / 255).astype(np.float32)

    @property
    def roughness(self) -> float:
        """Principled roughness."""
        roughness = DEFAULT_ROUGHNESS if self.mesh.roughness is None else self.mesh.roughness
        return max(float(roughness), MIN_ROUGHNESS)

    @property
    def metallic(self) -> float:
        """Principled metallic."""
        return float(self.mesh.metallic or 0)
