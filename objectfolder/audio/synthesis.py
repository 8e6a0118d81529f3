"""Sound of a struck object: a bank of damped sinusoids, mixed by modal gains."""

import math

import torch

from objectfolder.errors import ObjectFolderError

RESPONSES = ("displacement", "velocity", "acceleration")


def sinusoid_bank(
    damped_frequency: torch.Tensor,
    damping: torch.Tensor,
    sample_rate: int = 16000,
    duration: float = 2.0,
    response: str = "displacement",
) -> torch.Tensor:
    """Response of each mode to a unit impulse, per unit of gain.

    A mode with shape value g at the strike moves as g / w exp(-c t) sin(w t); velocity and acceleration
    are its derivatives. Modes above the Nyquist frequency would alias and are zero.

    Parameters
    ----------
    damped_frequency : (M,) tensor
        Damped angular frequencies w, rad/s.
    damping : (M,) tensor
        Decay rates c, 1/s.
    sample_rate : int
        Hz.
    duration : float
        Seconds.
    response : {"displacement", "velocity", "acceleration"}

    Returns
    -------
    (M, samples) float32

    Raises
    ------
    ObjectFolderError
        For an unknown response, or a rate or duration that is not positive.
    """
    if response not in RESPONSES:
        raise ObjectFolderError(f"response {response!r} is not one of {', '.join(RESPONSES)}")
    samples = round(sample_rate * duration) if math.isfinite(duration) else 0
    if sample_rate <= 0 or samples <= 0:
        raise ObjectFolderError(
            f"sample rate {sample_rate} Hz and duration {duration} s give no samples; both must be positive"
        )
    time = torch.arange(samples, dtype=torch.float64) / sample_rate
    w, c = damped_frequency.double()[:, None], damping.double()[:, None]
    # The m-th derivative of exp(s t) is s^m exp(s t), with s = -c + i w.
    order = RESPONSES.index(response)
    amplitude, phase = (w * w + c * c) ** (order / 2) / w, torch.atan2(w, -c) * order
    bank = amplitude * torch.exp(-c * time) * torch.sin(w * time + phase)
    bank[~audible(damped_frequency, sample_rate)] = 0
    return bank.float()


def audible(damped_frequency: torch.Tensor, sample_rate: int) -> torch.Tensor:
    """Which modes lie below the Nyquist frequency; (M,) bool."""
    return damped_frequency < math.pi * sample_rate


def gains(shapes: torch.Tensor, forces: torch.Tensor) -> torch.Tensor:
    """Modal gains: shapes (N, 3, M) in kg^-1/2, impulses (N, 3) in N s -> (N, M)."""
    return torch.einsum("ndm,nd->nm", shapes, forces)
