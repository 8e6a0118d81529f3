"""How much the ground under a touch can tell: the relief of the surface around a point."""

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.touch.contact import sensor_frames

SPAN = 0.0095  #: side of the square that is looked at, metres
RAYS = 9  #: along each side
ABOVE = 0.004  #: where rays start, metres above the point
BELOW = 0.003  #: and where they end below it: gel of no sensor reaches further


def surface_relief(surface: Isosurface, points: np.ndarray, scale: float) -> np.ndarray:
    """Return the root mean square height of the surface around points, above its mean plane there.

    Parameters
    ----------
    surface : Isosurface
        Unit frame.
    points : (N, 3) array
        On the surface, object frame, metres.
    scale : float
        Longest side of the object, metres.

    Returns
    -------
    (N,) float64
        Metres; of the first surface that rays along the inward normal meet, in a square of side `SPAN`. Zero
        on flat ground, however inclined.
    """
    place = np.asarray(points, np.float64) / scale
    normals = surface.grid.normals(torch.from_numpy(place.astype(np.float32))).numpy()
    frames = sensor_frames(normals.astype(np.float64), np.zeros(len(place)))
    across = np.linspace(-SPAN / 2, SPAN / 2, RAYS)
    square = np.stack(np.meshgrid(across, across), -1).reshape(-1, 2)
    starts = ABOVE * -frames[:, None, :, 0] + np.einsum("kc,nxc->nkx", square, frames[:, :, 1:])
    origins = (place[:, None] + starts / scale).reshape(-1, 3)
    inward = np.repeat(frames[:, :, 0], len(square), 0)
    distance, _ = surface.caster.first_hit(origins.astype(np.float32), inward.astype(np.float32))
    height = np.maximum(ABOVE - scale * distance.astype(np.float64), -BELOW).reshape(len(place), -1)
    plane = np.column_stack([np.ones(len(square)), square])
    height -= height @ np.linalg.pinv(plane).T @ plane.T
    return np.sqrt((height**2).mean(1))
