"""The paper's spectrogram, window 25 ms, hop 10 ms, FFT 512 at 16 kHz (supplementary E), and its figures."""

from typing import TYPE_CHECKING

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

WINDOW, HOP, FFT = 400, 160, 512
SAMPLE_RATE = 16000  #: Hz
DURATION = 2.0  #: s
SHAPE = (FFT // 2 + 1, 1 + round(SAMPLE_RATE * DURATION) // HOP)  #: (257, 201): bins, frames
DYNAMIC_RANGE = 80.0  #: of a figure, dB


def spectrogram(sounds: torch.Tensor) -> torch.Tensor:
    """Compute complex spectrograms; (N, samples) -> (N, 257, frames), 201 frames for two seconds.

    Raises ObjectFolderError if the sounds are too short for one window.
    """
    if sounds.shape[-1] <= FFT // 2:
        raise ObjectFolderError(
            f"sounds of {sounds.shape[-1]} samples are too short, expected more than {FFT // 2}"
        )
    if not len(sounds):  # which torch refuses
        frames = 1 + sounds.shape[-1] // HOP
        return torch.zeros(0, SHAPE[0], frames, dtype=torch.complex64, device=sounds.device)
    window = torch.hann_window(WINDOW, device=sounds.device)
    return torch.stft(sounds, FFT, hop_length=HOP, win_length=WINDOW, window=window, return_complex=True)


def phases(hertz: torch.Tensor) -> torch.Tensor:
    """Return the phases of lasting tones, one for each frequency bin; (257,) Hz -> (257, 201) complex64.

    A mode's spectrogram over these changes slowly: relative to the middle of the window, not its start, the
    phase has no sign that alternates from bin to bin, and it stands still from frame to frame where the mode
    has the bin's frequency.
    """
    frames = torch.arange(SHAPE[1], dtype=torch.float64, device=hertz.device) * (HOP / SAMPLE_RATE)
    half_turns = torch.arange(SHAPE[0], dtype=torch.float64, device=hertz.device) / 2
    turns = (hertz.double()[:, None] * frames + half_turns[:, None]) % 1
    return torch.polar(torch.ones_like(turns), 2 * torch.pi * turns).to(torch.complex64)


def invert_spectrogram(spectra: torch.Tensor) -> torch.Tensor:
    """Return the two-second sounds with the closest spectrograms; (N, 257, 201) -> (N, 32000)."""
    window = torch.hann_window(WINDOW)
    return torch.istft(spectra, FFT, HOP, WINDOW, window, length=round(SAMPLE_RATE * DURATION))


def show_spectrogram(
    axes: "Axes", sound: np.ndarray, title: str = "", peak: float | None = None
) -> "AxesImage | None":
    """Show the spectrogram of a sound (samples,) at `SAMPLE_RATE` in decibels below its peak.

    Given a reference magnitude as the peak, no colour bar is added: panels share one. Returns None for a
    silent sound.
    """
    level = magnitudes(sound)
    axes.set(title=title, xlabel="time [s]", ylabel="frequency [kHz]")
    top = level.max() if peak is None else peak
    if not (level.any() and top > 0):
        axes.text(0.5, 0.5, "silent", transform=axes.transAxes, ha="center", va="center")
        return None
    decibels = 20 * np.log10(np.maximum(level / top, 10 ** (-DYNAMIC_RANGE / 20)))
    extent = (0, (level.shape[1] - 1) * HOP / SAMPLE_RATE, 0, SAMPLE_RATE / 2000)
    image = axes.imshow(
        decibels, origin="lower", aspect="auto", extent=extent, cmap="magma", vmin=-DYNAMIC_RANGE, vmax=0
    )
    if peak is None:
        axes.figure.colorbar(image, ax=axes, label="dB relative to the peak")
    return image


def magnitudes(sound: np.ndarray) -> np.ndarray:
    """Return the spectrogram magnitudes of a (samples,) sound; (257, frames)."""
    return spectrogram(torch.from_numpy(np.asarray(sound, np.float32))[None])[0].abs().numpy()
