"""Sound of a struck object: a bank of damped sinusoids, mixed by modal gains."""

import math

import torch

from objectfolder.errors import ObjectFolderError

RESPONSES = ("displacement", "velocity", "acceleration")


def sinusoid_bank(
    damped_frequency: torch.Tensor,
    damping: torch.Tensor,
    sample_rate: float = 16000,
    duration: float = 2.0,
    response: str = "displacement",
    contact_time: float = 0.0,
) -> torch.Tensor:
    """Response of each mode to a unit impulse, per unit of gain.

    A mode with shape value g that is struck for an instant moves as g / w exp(-c t) sin(w t); velocity and
    acceleration are its derivatives. A strike of finite duration pushes with half a sine, whose integral is
    one too, and the answer is that of `half_sine_response`. Modes above the Nyquist frequency would alias
    and are zero.

    Parameters
    ----------
    damped_frequency : (M,) tensor
        Damped angular frequencies w, rad/s.
    damping : (M,) tensor
        Decay rates c, 1/s.
    sample_rate : float
        Hz.
    duration : float
        Seconds.
    response : {"displacement", "velocity", "acceleration"}
    contact_time : float
        Seconds that the strike lasts from the first sample on; 0 is an ideal impulse.

    Returns
    -------
    (M, samples) float32

    Raises
    ------
    ObjectFolderError
        For an unknown response, a rate or duration that is not positive, or a negative contact time.
    """
    if response not in RESPONSES:
        raise ObjectFolderError(f"response {response!r} is not one of {', '.join(RESPONSES)}")
    samples = sample_rate * duration
    samples = round(samples) if sample_rate > 0 and math.isfinite(samples) else 0
    if samples <= 0:
        raise ObjectFolderError(
            f"sample rate {sample_rate} Hz and duration {duration} s give no samples; both must be positive"
        )
    if not 0 <= contact_time < math.inf:
        raise ObjectFolderError(f"contact time is {contact_time} s, expected a finite duration or 0")
    time = torch.arange(samples, dtype=torch.float64) / sample_rate
    order = RESPONSES.index(response)
    s = torch.complex(-damping.double(), damped_frequency.double())[:, None]
    contact = time[time < contact_time]
    bank = torch.empty(len(s), samples, dtype=torch.float64)
    if len(contact):
        bank[:, : len(contact)] = half_sine_response(s, contact, contact_time, order)
    state = (
        _state(s, torch.ones(1, dtype=torch.float64), contact_time) if contact_time else torch.ones_like(s)
    )
    # Once it is free, a mode rings as exp(s t), whose derivatives are s exp(s t) and s^2 exp(s t).
    state = state * s**order / s.imag
    free = time[len(contact) :] - contact_time
    bank[:, len(contact) :] = (
        state.abs() * torch.exp(s.real * free) * torch.sin(s.imag * free + state.angle())
    )
    bank[~audible(damped_frequency, sample_rate)] = 0
    return bank.float()


def half_sine_response(
    s: torch.Tensor, time: torch.Tensor, contact_time: float, order: int = 0
) -> torch.Tensor:
    """Response of modes, at rest before, while half a sine of force of unit impulse acts; closed form.

    Solves ``y'' + 2 c y' + (w^2 + c^2) y = f(t)`` with ``f(t) = pi / (2 T) sin(pi t / T)``, the force of an
    elastic (Hertzian) contact to a few per cent.

    Parameters
    ----------
    s : (M, 1) complex tensor
        -c + i w, 1/s.
    time : (samples,) tensor
        Seconds since the contact began, from 0 to the contact time T.
    contact_time : float
        T, seconds.
    order : int
        0 for the displacement y, 1 for its velocity, 2 for its acceleration.

    Returns
    -------
    (M, samples) float64
    """
    moved = (_state(s, time / contact_time, contact_time) * s**order).imag / s.imag
    if order == 2:  # the force itself; what remains of the acceleration is elastic and viscous
        moved = moved + math.pi / (2 * contact_time) * torch.sin(math.pi * time / contact_time)
    return moved


def _state(s: torch.Tensor, share: torch.Tensor, contact_time: float) -> torch.Tensor:
    """Convolution of exp(s t) with the half sine of unit impulse, at shares of the contact; (M, samples)."""
    motion = s * (share * contact_time)
    turn = 1j * math.pi * share
    difference = _divided_difference(turn, motion) - _divided_difference(-turn, motion)
    return math.pi / 2 * share * difference / 2j


def _divided_difference(p: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
    """(exp(p) - exp(q)) / (p - q), accurate where p is near q: a strike in tune with an undamped mode."""
    half = (p - q) / 2
    near = half.abs() < 0.1
    x = torch.where(near, half, 0) ** 2
    series = torch.exp((p + q) / 2) * (1 + x / 6 * (1 + x / 20 * (1 + x / 42)))
    return torch.where(near, series, (torch.exp(p) - torch.exp(q)) / torch.where(near, 1, 2 * half))


def audible(damped_frequency: torch.Tensor, sample_rate: float) -> torch.Tensor:
    """Which modes lie below the Nyquist frequency; (M,) bool."""
    return damped_frequency < math.pi * sample_rate


def gains(shapes: torch.Tensor, forces: torch.Tensor) -> torch.Tensor:
    """Modal gains: shapes (N, 3, M) in kg^-1/2, impulses (N, 3) in N s -> (N, M)."""
    return torch.einsum("ndm,nd->nm", shapes, forces)
