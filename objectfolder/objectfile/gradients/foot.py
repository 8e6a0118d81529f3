"""Points that follow the stored surface."""

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile.gradients.first_order import first_order


def on_surface(points: torch.Tensor, feet: np.ndarray, surface: Isosurface) -> torch.Tensor:
    """Return feet on the surface whose gradients are those of a projection of the points.

    The foot of a moving point moves by the part of the motion that the implicit function theorem leaves: the
    stored distance d stays 0, and its normal n is the direction of projection,

        d(foot) = (I - n grad(d)' / (n . grad(d))) d(point).

    This is exact for points on the surface. Of points off it, the surface's curvature is left out, an error
    of the order of the distance over the radius of curvature.

    Parameters
    ----------
    points : (N, 3) tensor, unit frame
    feet : (N, 3) array, unit frame
        Where the points are projected to; those equal to a point follow it without constraint.
    surface : Isosurface

    Returns
    -------
    (N, 3) tensor of the values of ``feet``
    """
    foot = torch.from_numpy(feet).to(points)
    if not points.requires_grad:
        return foot
    points = first_order(points)
    place = torch.tensor(feet, dtype=torch.float32, requires_grad=True)
    with torch.enable_grad():
        (slope,) = torch.autograd.grad(surface.grid.distance(place).sum(), place)
    normal, slope = surface.grid.normals(place.detach()).to(points), slope.to(points)
    moved = points - points.detach()
    free = (foot == points.detach()).all(1, keepdim=True)
    along = (moved * slope).sum(1, keepdim=True) / (normal * slope).sum(1, keepdim=True)
    return foot + torch.where(free, moved, moved - along * normal)
