"""Frequencies and decay times of ringing objects, from recordings of taps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from objectfolder.sound.recordings import USABLE_BAND

LN_1000 = np.log(1000.0)  # an amplitude falls by 60 dB in T60 = ln(1000) / decay rate
RISE = 10.0  # of the power at a strike
START = 0.004  # s after the strike: its noise and the overdamped modes are gone
MIN_STRIKE_INTERVAL = 0.1  # s between strikes
MAX_RING = 1.5  # s of a ring that are analysed
BAND = 150.0  # Hz, width of the bands that are analysed one by one
ABOVE_FLOOR = 4.0  # amplitude of a peak over the floor of the spectrum around it
FLOOR_WIDTH = 400.0  # Hz, over which that floor is the median
ABOVE_NOISE = 4.0  # amplitude of a ring over the noise after it
# Singular value of a mode, over the largest of its band; below are differences between taps
MIN_SINGULAR_VALUE = 0.1
MIN_DAMPING = 0.2  # decay rate, 1/s; slower is hum
MIN_SAMPLES = 40  # of a decimated ring
#: s of a tap; of shorter ones too few samples are left, decimated to the width of a band
MIN_TAP_LENGTH = 0.3
MIN_EXPLAINED_ENERGY = 0.95  # of a band's energy that few modes hold, if it rings to the end of the recording
MAX_STEADY_MODES = 8  # modes


@dataclass(frozen=True)
class Ringdown:
    """Modes that were heard, by frequency; arrays share (M,)."""

    frequency: np.ndarray  #: damped, Hz
    damping: np.ndarray  #: decay rates, 1/s
    level: np.ndarray  #: root mean square over the taps of the amplitude at the strike, full scale 1
    unexplained: np.ndarray  #: fraction of the energy around it, noise aside, that no exponentials hold

    @property
    def decay_time(self) -> np.ndarray:
        """T60, seconds; (M,)."""
        return LN_1000 / self.damping


def strikes(sound: np.ndarray, rate: float) -> list[np.ndarray]:
    """Cut a recording (samples,) into taps, each from shortly after its strike to the next or the end.

    A strike is where the power of a millisecond, above 200 Hz, exceeds ten times that of each of the 20
    before it, and a thousandth of the largest. Before the recording is what is at its end. A tap shorter than
    0.3 s, such as the click of a recorder that is switched off, is left out.
    """
    shortest, longest, skipped = (round(seconds * rate) for seconds in (MIN_TAP_LENGTH, MAX_RING, START))
    if len(sound) < shortest:
        return []
    block = max(1, round(rate / 1000))
    clear = signal.sosfiltfilt(signal.butter(4, 200.0, "high", fs=rate, output="sos"), sound)
    power = np.square(clear[: len(clear) // block * block]).reshape(-1, block).mean(1)
    before = np.concatenate([np.full(20, np.median(power[-len(power) // 10 :])), power[:-1]])
    before = np.lib.stride_tricks.sliding_window_view(before, 20).max(1)
    rises = np.flatnonzero((power > RISE * before) & (power > 1e-3 * power.max()))
    starts = rises[np.diff(rises, prepend=-1000) > 1000 * MIN_STRIKE_INTERVAL] * block
    ends = [*starts[1:], len(sound)]
    taps = [clear[a + skipped : min(b, a + skipped + longest)] for a, b in zip(starts, ends)]
    return [tap for tap in taps if len(tap) + skipped >= shortest]


def ringdown(
    taps: Sequence[np.ndarray], rate: float, lowest: float = 200.0, highest: float | None = None
) -> Ringdown:
    """Identify the modes that ring in all taps of an object together.

    Peaks of the mean spectrum are found first. Around each, the taps are shifted to frequency 0 and
    decimated; their damped exponentials are the eigenvalues that shift the signal subspace of their Hankel
    matrices (ESPRIT: Roy and Kailath 1989; Laroche 1993, for percussion). Modes a few hertz apart, such as
    the pairs of round objects, are told from each other, because their mix differs from tap to tap.
    Frequencies are from the lowest to the highest, Hz; up to 0.45 of the rate by default.
    """
    limit = USABLE_BAND * rate if highest is None else min(highest, USABLE_BAND * rate)
    bands = [(centre, _band(taps, rate, centre)) for centre in _bands(taps, rate, lowest, limit)]
    bands = [(centre, found) for centre, found in bands if len(found)]
    centres = np.array([centre for centre, _ in bands])
    # Bands overlap: a mode is taken from the one whose centre is nearest.
    parts = [found[np.abs(found[:, :1] - centres).argmin(1) == n] for n, (_, found) in enumerate(bands)]
    rows = np.concatenate([np.zeros((0, 4)), *parts])
    rows = rows[np.argsort(rows[:, 0])]
    return Ringdown(*rows.T)


def _bands(taps: Sequence[np.ndarray], rate: float, lowest: float, highest: float) -> np.ndarray:
    """Return centres of bands around the peaks of the taps' spectra, Hz."""
    count = 2 ** int(np.ceil(np.log2(rate * 0.5)))
    spectrum = np.zeros(count + 1)
    for tap in taps:
        part = tap[:count] * np.hanning(2 * len(tap[:count]))[len(tap[:count]) :]
        amplitude = np.abs(np.fft.rfft(part, 2 * count))
        spectrum += np.square(amplitude / amplitude.max())
    amplitude, hertz = np.sqrt(spectrum), np.fft.rfftfreq(2 * count, 1 / rate)
    floor = ndimage.percentile_filter(amplitude, 50, size=round(FLOOR_WIDTH / hertz[1]))
    peaks, _ = signal.find_peaks(amplitude / floor, height=ABOVE_FLOOR, distance=round(4 / hertz[1]))
    peaks = hertz[peaks][(hertz[peaks] > lowest) & (hertz[peaks] < highest)]
    centres: list[float] = []
    while len(peaks):  # peaks within half a band share one
        group = peaks[peaks < peaks[0] + BAND / 2]
        centres.append(float(group.mean()))
        peaks = peaks[len(group) :]
    return np.array(centres)


def _band(taps: Sequence[np.ndarray], rate: float, centre: float) -> np.ndarray:
    """Identify the modes of one band; rows of a `Ringdown`."""
    step = max(1, int(rate / (2 * BAND)))
    window = signal.firwin(8 * step + 1, BAND / 2, fs=rate)
    parts = []
    for tap in taps:
        shifted = tap * np.exp(-2j * np.pi * centre / rate * np.arange(len(tap)))
        parts.append(signal.fftconvolve(shifted, window, "valid")[::step])
    parts, noise = _ringing(parts)
    if not parts:
        return np.zeros((0, 4))
    lag = len(parts[0]) * 3 // 5
    hankel = np.concatenate([np.lib.stride_tricks.sliding_window_view(part, lag) for part in parts], axis=1)
    left, sizes, _ = np.linalg.svd(hankel, full_matrices=False)
    signals = left[:, sizes > max(MIN_SINGULAR_VALUE * sizes[0], 4 * np.median(sizes))]
    poles = np.linalg.eigvals(np.linalg.lstsq(signals[:-1], signals[1:], rcond=None)[0])
    s = np.log(poles) * rate / step
    frequency, damping = centre + s.imag / (2 * np.pi), -s.real
    powers = poles ** np.arange(len(parts[0]))[:, None]
    fitted = np.linalg.lstsq(powers, np.stack(parts, 1), rcond=None)[0]
    left = np.mean(np.square(np.abs(powers @ fitted - np.stack(parts, 1)))) - (noise or 0)
    unexplained = max(0.0, left / np.mean(np.square(np.abs(parts))))
    if noise is None and (len(poles) > MAX_STEADY_MODES or unexplained > 1 - MIN_EXPLAINED_ENERGY):
        return np.zeros((0, 4))  # noise, not a ring
    amplitude = np.abs(fitted)
    passed = (len(window) // 2) / rate  # s of each tap before the first decimated sample
    level = 2 * np.sqrt(np.mean(amplitude**2, 1)) * np.exp(damping * (passed + START))
    kept = (np.abs(frequency - centre) < BAND / 2) & (damping > MIN_DAMPING)
    return np.stack([frequency, damping, level, np.full(len(poles), unexplained)], 1)[kept]


def _ringing(parts: list[np.ndarray]) -> tuple[list[np.ndarray], float | None]:
    """Cut decimated taps where the ring sinks into noise; drop those too short.

    Also returns the power of that noise; None if the ring outlasts the recording.
    """
    parts = [part for part in parts if len(part) >= 2 * MIN_SAMPLES]
    if not parts:
        return [], None
    parts = [part[: min(map(len, parts))] for part in parts]
    power = np.mean([np.abs(part) ** 2 for part in parts], 0)
    noise = float(np.median(power[-MIN_SAMPLES:]))
    if power[:4].mean() <= 4 * ABOVE_NOISE**2 * noise:
        return parts, None
    quiet = np.flatnonzero(ndimage.uniform_filter1d(power, 9) < ABOVE_NOISE**2 * noise)
    count = max(MIN_SAMPLES, int(quiet[0]) if len(quiet) else len(power))
    return [part[:count] for part in parts], noise
