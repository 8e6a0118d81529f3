"""How the gel gives way."""

import torch

from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.smoothing import smooth


def deform(penetration: torch.Tensor, profile: SensorProfile) -> torch.Tensor:
    """Displacement of the soft gel's surface.

    The penetration is smoothed with ever shorter Gaussians, and after each the gel is pushed out of the
    object again (the pyramid of Taxim, Si and Yuan 2022, with a maximum in place of its mask: a mask leaves
    a step at the rim of smooth contacts). Thus displacement >= penetration everywhere, and the gel is drawn
    in around the contact.

    Limits: purely geometric. No forces, no elastic constants, no bulging of displaced volume, no friction;
    the smoothing lengths stand in for the thickness of the layer.

    Parameters
    ----------
    penetration : (N, H, W) float tensor, metres
    profile : SensorProfile

    Returns
    -------
    (N, H, W) float32 tensor, metres towards the camera.
    """
    displacement = penetration.float().clone()
    for image in displacement:  # one at a time: the same bits whatever else is in the batch
        rigid = image.clone()
        soft = rigid
        for length in profile.gel_smoothing:
            soft = torch.maximum(rigid, smooth(soft, length / profile.pixel_pitch))
        image.copy_(soft)
    return displacement
