"""Model of the pictures of a ball pressed on a sensor."""

from dataclasses import replace
from functools import cached_property

import numpy as np
import torch

from objectfolder.base.recent import Recent
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.gel import GAP, deform
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.shading import Vectors

# Displacements: a fit asks for those of all pictures, and changes one pose at a time
_CACHED_DISPLACEMENTS = 256


class BallModel:
    """Changes of a sensor's picture by a ball of some radius, metres, under lights of any strength.

    A pose is an array of row and column of the ball's centre, in pixels, and its press depth, in metres.
    """

    def __init__(self, profile: SensorProfile, radius: float):
        self.profile, self.radius = profile, radius
        self.colors = sorted({light.color for light in profile.lights}, reverse=True)
        self._rays, self._gel = ray_directions(profile), gel_depth(profile)
        self._optics, self._displacements = Recent[Optics](1), Recent[torch.Tensor](_CACHED_DISPLACEMENTS)

    @cached_property
    def optics(self) -> Optics:
        """Optics of the profile as given."""
        return Optics(self.profile)

    @cached_property
    def still(self) -> tuple[Vectors, Vectors]:
        """Points and normals of the gel at rest; see `Optics.surface`."""
        points, normals, _ = self.optics.surface(torch.zeros(1, self.profile.height, self.profile.width))
        return points, normals

    def lit(self, logarithms: np.ndarray) -> SensorProfile:
        """Return the profile with the lights of each colour scaled by exp of the (C,) logarithms."""
        factor, given = dict(zip(self.colors, np.exp(logarithms))), self.profile.lights
        lights = [replace(light, intensity=float(light.intensity * factor[light.color])) for light in given]
        return replace(self.profile, lights=tuple(lights), background_image="", background_sha256="")

    def depth_of(self, row: float, column: float, pixels: float) -> float:
        """Return the approximate press depth, in metres, of a contact with a radius in pixels.

        Two surfaces that overlap by δ meet at a radius sqrt(2 δ ρ), with ρ from the sum of their curvatures;
        an elastic contact has the radius sqrt(δ ρ) (Hertz).
        """
        contact = pixels * self.profile.pixel_pitch
        curvature = 1 / self.radius + self.profile.gel_curvature
        depth = contact**2 * curvature * (0.5 if self.profile.gel == "rigid" else 1.0)
        return float(np.clip(depth, 0.02 * self.profile.max_indentation, 0.9 * self.profile.max_indentation))

    def displacement(self, pose: np.ndarray) -> torch.Tensor:
        """Return the displacement of the gel under the ball; (1, H, W)."""
        return self._displacements.of(pose.tobytes(), lambda: self._pressed(pose))

    def _pressed(self, pose: np.ndarray) -> torch.Tensor:
        height = self.height(pose)[None].astype(np.float32)
        return torch.from_numpy(deform(height, self.profile)[0])

    def height(self, pose: np.ndarray) -> np.ndarray:
        """Return the heights of the ball past the gel along the pixel rays; (H, W), metres."""
        row, column, depth = pose
        profile = self.profile
        vertical, horizontal = profile.half_extent
        along_y = (1 - (column + 0.5) * 2 / profile.width) * horizontal
        along_z = (1 - (row + 0.5) * 2 / profile.height) * vertical
        slope = np.array([1, along_y, along_z])
        # Point of the undeformed gel below the ball's centre, and its normal, away from the camera.
        at = slope * gel_depth(profile, slope)
        dome = profile.gel_dome_radius
        leaning = profile.gel_curvature * dome / np.sqrt(dome**2 - at[1] ** 2 - at[2] ** 2)
        normal = np.array([1, leaning * at[1], leaning * at[2]])
        away = self.radius - np.clip(depth, 0, profile.max_indentation)
        centre = at + normal / np.linalg.norm(normal) * away
        along, square = self._rays @ centre, (self._rays**2).sum(axis=2)
        root = along**2 - square * (centre @ centre - self.radius**2)
        ball = np.where(root >= 0, (along - np.sqrt(np.maximum(root, 0))) / square, np.inf)
        return np.clip(self._gel - ball, -GAP * profile.elastomer_thickness, profile.max_indentation)

    def change(self, logarithms: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Return the change in grey levels that the ball causes; (H, W, 3) float32."""
        optics = self._optics.of(logarithms.tobytes(), lambda: Optics(self.lit(logarithms)))
        return optics.change(self.displacement(pose))[0].permute(1, 2, 0).numpy()
