"""Deformation of a soft gel with gradients, by implicit differentiation of the contact problem."""

from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from objectfolder.touch.active_set import ACCURACY, settle, supporting_pressure
from objectfolder.touch.gel import deform, layer_of, respond
from objectfolder.touch.profiles import SensorProfile

_SINGLE = 1e-5  # accuracy of gradients in single precision


class SoftGel(torch.autograd.Function):
    """Press a rigid object into a soft gel; `objectfolder.touch.gel.deform` with gradients.

    Where they touch, the displacement is the height and the pressure solves C p = h on the touching pixels,
    C being the layer's symmetric response; elsewhere the displacement is C p. The touching pixels change
    where the gap or the pressure is 0, which alters no first derivative. So gradients (a, b) of displacement
    and pressure are, on the touching pixels, those of the heights

        a + C^-1 (C a' + b),

    where a' is a outside of them.
    """

    @staticmethod
    def forward(ctx: Any, height: torch.Tensor, profile: SensorProfile) -> tuple[torch.Tensor, torch.Tensor]:
        """Return displacement, metres, and pressure, Pa, of heights (N, H, W), metres.

        In double precision the contact is solved to rounding, in single as `deform` does.
        """
        values = height.detach().numpy()
        displacement, pressure = deform(values, profile)
        if height.dtype == torch.float64:
            displacement, pressure = displacement.astype(np.float64), pressure.astype(np.float64)
            for i in np.flatnonzero(pressure.any((1, 2))):
                displacement[i], pressure[i] = settle(
                    values[i], pressure[i], profile.pixel_pitch, layer_of(profile)
                )
        ctx.profile = profile
        # Pixels that were laid onto the object without a pressure belong to it, too.
        ctx.touching = (displacement == values) & pressure.any((1, 2), keepdims=True)
        return torch.from_numpy(displacement), torch.from_numpy(pressure)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Any) -> tuple[torch.Tensor, None]:
        """Return the gradients of heights (N, H, W)."""
        of_moved, of_pressure = (g.numpy().astype(np.float64) for g in gradients)
        pitch, layer = ctx.profile.pixel_pitch, layer_of(ctx.profile)
        accuracy = ACCURACY if gradients[0].dtype == torch.float64 else _SINGLE
        result = np.where(ctx.touching, of_moved, 0)
        for i in np.flatnonzero(ctx.touching.any((1, 2))):
            free = respond(np.where(ctx.touching[i], 0, of_moved[i]), pitch, layer)
            result[i] += supporting_pressure(free + of_pressure[i], ctx.touching[i], pitch, layer, accuracy)
        return torch.from_numpy(result).to(gradients[0].dtype), None
