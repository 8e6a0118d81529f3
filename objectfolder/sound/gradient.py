"""Sound that carries gradients to point, impulse, material, size and contact."""

import copy
from dataclasses import fields
from typing import Any

import numpy as np
import torch

from objectfolder.base.checks import require_memory
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.sound.contact import Striker
from objectfolder.sound.gains_net import GainsNet
from objectfolder.sound.query import SoundSettings
from objectfolder.sound.senses import ModalSense
from objectfolder.sound.synthesis import (
    RESPONSES,
    gains,
    half_sine_response,
    is_audible,
    pulse_phasor,
    response_at,
)
from objectfolder.stored.arguments import broadcast_rows, finite_rows
from objectfolder.stored.gradient_module import AnswerModule, follow_surface
from objectfolder.stored.surface import TOLERANCE, ObjectSurface

_BYTES_PER_PAIR = 100  # of a mode and a sample, with what gradients need
#: A float, or a tensor without dimensions, through which gradients flow.
Number = Any


def detach_number(number: Number) -> float:
    """Return a number without its gradient."""
    return number.item() if isinstance(number, torch.Tensor) else number


class TensorMaterial(Material):
    """A material whose density, Young's modulus and damping may be tensors, through which gradients flow.

    `dataclasses.replace` changes some of them. Poisson's ratio is a number: mode shapes depend on it, and
    they are stored.

    Raises
    ------
    ObjectFolderError
        If a value is not physical.
    """

    def __post_init__(self) -> None:
        values = {field.name: getattr(self, field.name) for field in fields(Material) if field.name != "name"}
        knots = tuple((hertz, detach_number(loss)) for hertz, loss in values.pop("loss_factor"))
        object.__setattr__(self, "loss_factor", tuple(map(tuple, self.loss_factor)))
        Material(self.name, **{name: detach_number(v) for name, v in values.items()}, loss_factor=knots)

    @classmethod
    def of(cls, material: Material) -> "TensorMaterial":
        """Return a material with the same values."""
        return cls(**vars(material))


class Sound(AnswerModule):
    """Sound of strikes, as `ObjectFile.impact` without a listener, with gradients.

    Gradients reach points, impulses, contact time, size, and the numbers of a `TensorMaterial`; through the
    contact time of the striker too. Which modes are heard is discrete: a mode that leaves the range of
    hearing, or passes half the sample rate, does so without a gradient. Modes are synthesized in double
    precision; all of them and all samples are in memory at once, some 100 bytes for each pair.

    Parameters
    ----------
    sense : ModalSense
    surface : ObjectSurface
    dtype : torch.dtype
        Of mode shapes and answers.

    Raises
    ------
    ObjectFolderError
        If the net is of another kind than ``gains``.
    """

    def __init__(self, sense: ModalSense, surface: ObjectSurface, dtype: torch.dtype):
        super().__init__()
        if not (isinstance(sense, ModalSense) and isinstance(sense.net, GainsNet)):
            raise ObjectFolderError(
                "gradients of sound need an audio net of kind gains; build the object with train_audio.net: "
                "gains"
            )
        sense.warn_if_uncertain()
        self._sense, self._surface, self._dtype = sense, surface, dtype
        self.net = copy.deepcopy(sense.net).cpu().to(dtype).requires_grad_(False)

    @property
    def material(self) -> TensorMaterial:
        """The object's own material.

        Raises
        ------
        ObjectFolderError
            If the file does not describe it, as imported ones.
        """
        return TensorMaterial.of(self._sense.own_material)

    def forward(
        self,
        points: torch.Tensor,
        forces: torch.Tensor,
        sample_rate: float = 16000,
        duration: float = 2.0,
        response: str = "displacement",
        tolerance: float = TOLERANCE,
        contact_time: Number | None = None,
        material: str | Material | None = None,
        scale: Number | None = None,
        striker: str | Striker | None = None,
    ) -> torch.Tensor:
        """Strike the object, or one of its shape; parameters and errors as of `ObjectFile.impact`.

        Parameters
        ----------
        points : (N, 3) tensor, object frame, metres
        forces : (N, 3) tensor, N s, object frame

        Returns
        -------
        (N, samples) tensor, absolute amplitude
        """
        places, pushes = finite_rows("points", points, 3), finite_rows("forces", forces, 3)
        places, pushes = broadcast_rows("points", places, "forces", pushes)
        played = sample_rate, duration, response, contact_time, material, scale, striker
        settings = SoundSettings(*played).checked(len(places))
        stuff = material if isinstance(material, Material) else settings.material
        shapes = self._shapes(points, places, tolerance, scale)
        tuning = self._sense.tuning(stuff, scale)
        if contact_time is None:
            contact_time = self._sense.striking_time(settings.striker, stuff, scale)
        heard = is_audible(tuning.damped_frequency, settings.sample_rate)
        s = torch.complex(-tuning.damping, tuning.damped_frequency)[heard].to(torch.complex128)[:, None]
        samples = round(settings.sample_rate * settings.duration)
        require_memory(
            f"gradients of {len(s)} modes in {samples:,} samples",
            _BYTES_PER_PAIR * len(s) * samples,
            "ask for fewer seconds or a lower sample_rate",
        )
        time = torch.arange(samples, dtype=torch.float64) / settings.sample_rate
        bank = respond_to_pulse(s, time, contact_time, RESPONSES.index(response))
        impulses = torch.as_tensor(forces).to(shapes).expand(pushes.shape)
        strength = gains(shapes[..., tuning.modes[heard]], impulses) * tuning.shape_factor
        return (strength.double() @ bank).to(self._dtype)

    def _shapes(
        self, points: torch.Tensor, places: np.ndarray, tolerance: float, scale: Number | None
    ) -> torch.Tensor:
        """Return mode shapes (N, 3, M) at points, whose values are places."""
        size = self._surface.scale if scale is None else scale
        surface = self._surface.resized(detach_number(size))
        closest = surface.to_unit(surface.snap(places, tolerance))
        unit = (torch.as_tensor(points).double() / size).expand(places.shape)
        on = follow_surface(unit, closest, surface.read()) if surface.stored else unit
        return self.net(on.to(self._dtype)) * self.net.amplitude


def respond_to_pulse(s: torch.Tensor, time: torch.Tensor, contact_time: Number, order: int) -> torch.Tensor:
    """Compute the response of modes to a half sine of force; see `objectfolder.sound.synthesis.responses`.

    ``s`` (M, 1) is -c + i w, 1/s; ``time`` (samples,) ascends from the start of contact, seconds; a contact
    time of 0 is an ideal impulse; ``order`` is 0 for the displacement, 1 for its velocity, 2 for its
    acceleration. Returns (M, samples) float64.
    """
    if not contact_time:
        return response_at(s, time, 0.0, order)
    touching = int((time < contact_time).sum())
    end = pulse_phasor(s, torch.ones(1, dtype=torch.float64), contact_time)
    ringing = response_at(s, time[touching:] - contact_time, 0.0, order, end)
    return torch.cat([half_sine_response(s, time[:touching], contact_time, order), ringing], 1)
