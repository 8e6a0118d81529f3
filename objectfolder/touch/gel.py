"""How the gel gives way."""

import torch

from objectfolder.touch.profiles import SensorProfile


def deform(penetration: torch.Tensor, profile: SensorProfile) -> torch.Tensor:
    """Displacement of the gel's surface; (N, H, W) float32 tensor, metres towards the camera.

    Parameters
    ----------
    penetration : (N, H, W) float tensor, metres
    profile : SensorProfile
    """
    return penetration.float().clone()
