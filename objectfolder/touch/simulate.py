"""From contacts to tactile images: the one path that ground truth and query share."""

import numpy as np
import torch

from objectfolder.mesh.raycast import RayCaster
from objectfolder.touch.contact import heightmaps
from objectfolder.touch.gel import deform
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile


def touch_images(
    caster: RayCaster,
    points: np.ndarray,
    normals: np.ndarray,
    angles: np.ndarray,
    depths: np.ndarray,
    profile: SensorProfile,
    optics: Optics,
    scale: float = 1.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Press the sensor on an object and read its images, without noise.

    Parameters are those of `heightmaps`; ``optics`` renders the same profile. Each row depends on its own
    contact only, to the bit.

    Returns
    -------
    images : (N, H, W, 3) uint8, RGB
    displacement : (N, H, W) float32, metres, of the gel's surface towards the camera
    obstructed : (N,) float64, fraction of pixels; see `heightmaps`
    """
    penetration, obstructed = heightmaps(caster, points, normals, angles, depths, profile, scale)
    displacement = torch.from_numpy(deform(penetration, profile)[0])
    return optics.render(displacement).numpy(), displacement.numpy(), obstructed
