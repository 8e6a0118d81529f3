"""Modal sound synthesis: a bank of damped sinusoids, mixed by modal gains."""

import math
from typing import Any

import torch

from objectfolder.base.checks import finite_number, one_of
from objectfolder.base.errors import ObjectFolderError

RESPONSES = ("displacement", "velocity", "acceleration")
_STRIDE = 256  # samples between computed exponentials; the others are products
# Radians of a mode during a contact beyond which its force counts as slow; see `force_factors`
_SLOW_CONTACT_PHASE = 1.5 * math.pi


def sinusoid_bank(
    damped_frequency: torch.Tensor,
    damping: torch.Tensor,
    sample_rate: float = 16000,
    duration: float = 2.0,
    response: str = "displacement",
    contact_time: float = 0.0,
) -> torch.Tensor:
    """Compute the response of each mode to a unit impulse, per unit of gain; (M, samples) float32.

    After an ideal impulse, a mode with shape value g is displaced by g / w exp(-c t) sin(w t); velocity and
    acceleration are the derivatives. A strike of finite duration is a half-sine force pulse of unit impulse;
    see `half_sine_response`. Modes at or above the Nyquist frequency would alias and are set to zero.

    Damped frequencies w (M,) are angular, rad/s, decay rates c (M,) 1/s; the sample rate is in Hz, durations
    in seconds; the strike starts at the first sample, and a contact time of 0 is an ideal impulse. Raises
    ObjectFolderError for an unknown response, a rate or duration that is not positive, or a negative contact
    time.
    """
    samples = count_samples(sample_rate, duration)
    heard = is_audible(damped_frequency, sample_rate)
    bank = torch.zeros(len(heard), samples, dtype=torch.float32, device=heard.device)
    modes = damped_frequency[heard], damping[heard]
    bank[heard] = responses(*modes, sample_rate, range(samples), response, contact_time)
    return bank


def count_samples(sample_rate: float, duration: float) -> int:
    """Return the number of samples of a sound.

    Raises ObjectFolderError if there are none, since the rate or the duration is not positive, or too large
    for a number.
    """
    rate, seconds = finite_number("sample rate", sample_rate), finite_number("duration", duration)
    samples = round(rate * seconds) if rate > 0 and math.isfinite(rate * seconds) else 0
    if samples <= 0 < min(rate, seconds) and math.isfinite(rate * seconds):
        raise ObjectFolderError(
            f"duration is {duration} s, expected at least one sample of {1 / rate:g} s at {sample_rate} Hz"
        )
    if samples <= 0:
        raise ObjectFolderError(
            f"sample rate {sample_rate} Hz and duration {duration} s give no samples; both must be positive"
        )
    return samples


def checked_sample_rate(sample_rate: float) -> float:
    """Return a sample rate, Hz, or raise ObjectFolderError if it is not a positive, finite number."""
    rate = finite_number("sample_rate", sample_rate)
    if rate <= 0:
        raise ObjectFolderError(f"sample_rate is {rate:g} Hz, expected a positive number")
    return rate


def checked_contact_time(seconds: float) -> float:
    """Return a contact time, or raise ObjectFolderError if it is negative or not a finite number."""
    value = finite_number("contact time", seconds)
    if value < 0:
        raise ObjectFolderError(f"contact time is {value} s, expected 0 or more")
    return value


def responses(
    damped_frequency: torch.Tensor,
    damping: torch.Tensor,
    sample_rate: float,
    samples: range,
    response: str = "displacement",
    contact_time: float = 0.0,
    ahead: bool = False,
) -> torch.Tensor:
    """Compute a range of samples of `sinusoid_bank`, including modes that alias; (M, len(samples)) float32.

    Modes may ring a quarter of a period ahead: cosines instead of sines. Raises ObjectFolderError for an
    unknown response or a negative contact time.
    """
    one_of("response", response, RESPONSES)
    checked_contact_time(contact_time)
    order = RESPONSES.index(response)
    s = torch.complex(-damping.double(), damped_frequency.double())[:, None]
    time = torch.arange(samples.start, samples.stop, dtype=torch.float64, device=s.device) / sample_rate
    contact = time[time < contact_time]
    turn = 1j if ahead else 1.0
    bank = torch.empty(len(s), len(samples), dtype=torch.float32, device=s.device)
    if len(contact):
        bank[:, : len(contact)] = half_sine_response(s, contact, contact_time, order, turn).float()
    one = torch.ones(1, dtype=torch.float64, device=s.device)
    state = pulse_phasor(s, one, contact_time) if contact_time else torch.ones_like(s)
    # After contact, a mode rings freely as exp(s t), whose derivatives are s exp(s t) and s^2 exp(s t).
    free = bank[:, len(contact) :]
    if free.numel():
        start = float(time[len(contact)]) - contact_time
        free[:] = _ringing(turn * state * s**order / s.imag, s, start, 1 / sample_rate, free.shape[1])
    return bank


def _ringing(state: torch.Tensor, s: torch.Tensor, start: float, step: float, count: int) -> torch.Tensor:
    """Compute the imaginary part of state exp(s t) at evenly spaced times; (M, count) float32.

    exp(s (a + b)) = exp(s a) exp(s b): two short tables replace an exponential per sample.
    """
    near = torch.arange(_STRIDE, dtype=torch.float64, device=s.device) * step
    far = start + torch.arange(-(-count // _STRIDE), dtype=torch.float64, device=s.device) * (_STRIDE * step)
    fast, slow = torch.exp(s * near)[:, None, :], (state * torch.exp(s * far))[:, :, None]
    wave = torch.empty(len(s), far.shape[0], _STRIDE, dtype=torch.float32, device=s.device)
    for out, x, y in zip(wave, fast, slow):  # mode by mode, so that intermediates stay in the cache
        out.copy_(torch.addcmul(x.imag * y.real, x.real, y.imag))
    return wave.flatten(1)[:, :count]


def half_sine_response(
    s: torch.Tensor, time: torch.Tensor, contact_time: float, order: int = 0, turn: complex = 1.0
) -> torch.Tensor:
    """Compute in closed form the response of modes, at rest before, during a half-sine force pulse.

    Solves ``y'' + 2 c y' + (w^2 + c^2) y = f(t)`` with ``f(t) = pi / (2 T) sin(pi t / T)``, which has unit
    impulse and approximates the force of an elastic (Hertzian) contact to a few per cent. Poles s = -c + i w
    (M, 1) are complex, 1/s; times (samples,) since the start of contact go from 0 to the contact time T,
    seconds. The order is 0 for the displacement y, 1 for its velocity, 2 for its acceleration; ``turn`` is a
    factor of the modes' phasors. Returns (M, samples) float64.
    """
    moved = (turn * pulse_phasor(s, time / contact_time, contact_time) * s**order).imag / s.imag
    if order == 2:  # add the force itself; the other terms are elastic and viscous
        moved = moved + half_sine(time, contact_time)[0]
    return moved


def half_sine(time: torch.Tensor, contact_time: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a half sine of unit impulse, and its derivative over pi / T, 1/s; 0 outside the contact time T.

    Times since its start, of any shape, and T > 0 are in seconds.
    """
    turn, touching = math.pi / contact_time, (time >= 0) & (time <= contact_time)
    return turn / 2 * torch.sin(turn * time) * touching, turn / 2 * torch.cos(turn * time) * touching


def force_factors(s: Any, contact_time: float) -> tuple[Any, Any]:
    """Return how the force itself is heard while it acts on modes that are heard by their acceleration.

    A mode rings as the imaginary part of G z, with z' = s z + f. Its acceleration, times w, is the imaginary
    part of s^2 z + s f + f'. So G / s^2 is the pressure per acceleration, and while the force acts, the
    imaginary parts of G times these factors add the parts of `half_sine`: the force f, and its derivative f'
    over pi / T. Poles s (M,) are per second, or per sample, as the contact time is.

    The pressure per acceleration is known at the mode's frequency alone, as W. Its imaginary part is heard of
    the derivative of the acceleration, Re W - b Re s + b d/dt with b = Im W / w, or of the integral, the
    velocity. With the velocity, the force adds Im(W s) / w times f; with the derivative, Im W / w times f',
    too, which is nearer where the force is slow for the mode, but too loud where it is short. The share of f'
    is fitted to W at all frequencies, for any causal force; see docs/sound.md.
    """
    turned = s.imag * contact_time
    share = turned**2 / (turned**2 + _SLOW_CONTACT_PHASE**2)
    return 1 / s, share * (math.pi / contact_time) / s**2


def response_at(
    s: torch.Tensor,
    time: torch.Tensor,
    contact_time: float,
    order: int = 0,
    weight: torch.Tensor | complex = 1.0,
) -> torch.Tensor:
    """Compute the response of modes at any times, as `responses` does at samples; 0 before the strike.

    Poles s = -c + i w (M, 1), 1/s; times (M, T) or (T,) since the start of contact, and the contact time,
    seconds. The order is 0 for the displacement, 1 for its velocity; the weight (M, 1) is a factor of the
    modes' phasors: 1 + b s adds b times the velocity to the displacement. Returns (M, T) float64.
    """
    free = (time - contact_time).clip(min=0)
    share = (time / contact_time).clip(0, 1) if contact_time else torch.ones_like(time)
    state = pulse_phasor(s, share, contact_time) if contact_time else torch.ones_like(s * share)
    return (state * torch.exp(s * free) * (weight * s**order)).imag / s.imag * (time >= 0)


def pulse_phasor(s: torch.Tensor, share: torch.Tensor, contact_time: float) -> torch.Tensor:
    """Convolve exp(s t) with the half sine of unit impulse, at shares of the contact, 0 to 1; complex.

    Poles s = -c + i w (M, 1), 1/s, and shares (samples,) or (M, samples) give (M, samples): at the end of the
    contact, the phasor with which modes ring on.
    """
    motion = s * (share * contact_time)
    turn = 1j * math.pi * share
    difference = _divided_difference(turn, motion) - _divided_difference(-turn, motion)
    return math.pi / 2 * share * difference / 2j


def _divided_difference(p: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
    """Compute (exp(p) - exp(q)) / (p - q), accurate near p = q, where the pulse resonates with the mode."""
    half = (p - q) / 2
    near = half.abs() < 0.1
    x = torch.where(near, half, 0) ** 2
    series = torch.exp((p + q) / 2) * (1 + x / 6 * (1 + x / 20 * (1 + x / 42)))
    return torch.where(near, series, (torch.exp(p) - torch.exp(q)) / torch.where(near, 1, 2 * half))


def is_audible(damped_frequency: torch.Tensor, sample_rate: float) -> torch.Tensor:
    """Return a mask of the modes below the Nyquist frequency; (M,) bool."""
    return damped_frequency < math.pi * sample_rate


def gains(shapes: torch.Tensor, forces: torch.Tensor) -> torch.Tensor:
    """Compute modal gains: shapes (N, 3, M) in kg^-1/2, impulses (N, 3) in N s -> (N, M)."""
    return torch.einsum("ndm,nd->nm", shapes, forces)
