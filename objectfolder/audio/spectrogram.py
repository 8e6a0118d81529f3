"""The paper's spectrogram: window 25 ms, hop 10 ms, FFT 512 at 16 kHz (supplementary E)."""

import torch

from objectfolder.errors import ObjectFolderError

WINDOW, HOP, FFT = 400, 160, 512
SAMPLE_RATE = 16000  #: Hz
DURATION = 2.0  #: s
SHAPE = (FFT // 2 + 1, 1 + round(SAMPLE_RATE * DURATION) // HOP)  #: (257, 201): bins, frames


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


def sounds_of(spectra: torch.Tensor) -> torch.Tensor:
    """Return the two-second sounds with the closest spectrograms; (N, 257, 201) -> (N, 32000)."""
    window = torch.hann_window(WINDOW)
    return torch.istft(spectra, FFT, HOP, WINDOW, window, length=round(SAMPLE_RATE * DURATION))
