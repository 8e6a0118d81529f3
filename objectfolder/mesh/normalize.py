"""Bring a source mesh into the unit frame, and derive its closed physical surface."""

from dataclasses import dataclass

import numpy as np

from objectfolder.mesh.surface import Surface, close_surface
from objectfolder.mesh.textured import TexturedMesh


@dataclass(frozen=True)
class Normalized:
    """An object in the unit frame: longest side 1, bounding box centred on the origin, z up."""

    visual: TexturedMesh
    surface: Surface
    source_centre: np.ndarray  #: (3,) centre of the bounding box, in the z-up source's units
    source_size: float  #: longest side of the bounding box, in the source's units

    def report(self, scale: float, up: str) -> dict:
        """Return what ``normalize.json`` holds; lengths in metres where the name ends in ``_m``."""
        surface = self.surface
        return {
            "scale_m": scale,
            "source_up": up,
            "source_centre": self.source_centre.tolist(),
            "source_size": self.source_size,
            "steps": surface.steps,
            "weld_tolerance": surface.weld_tolerance,
            "deviation_max_m": surface.deviation_max * scale,
            "deviation_mean_m": surface.deviation_mean * scale,
            "volume_m3": surface.volume * scale**3,
            "components": surface.components,
            "vertices": len(surface.vertices),
            "faces": len(surface.faces),
            "visual_faces": len(self.visual.faces),
        }


def normalize(mesh: TexturedMesh, name: str = "mesh") -> Normalized:
    """Centre and scale a z-up mesh to the unit frame and close its surface.

    Raises
    ------
    ObjectFolderError
        If the surface cannot be closed.
    """
    lower, upper = mesh.bounds
    centre, size = (lower + upper) / 2, float((upper - lower).max())
    visual = mesh.with_vertices((mesh.vertices - centre) / size)
    surface = close_surface(visual.vertices, visual.faces, name)
    return Normalized(visual, surface, centre, size)
