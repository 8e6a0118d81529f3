import numpy as np
import scipy.signal
import torch

from objectfolder.sound.spectrogram import DURATION, FFT, HOP, SAMPLE_RATE, WINDOW, spectrogram


def test_it_agrees_with_scipy(rng):
    sound = rng.standard_normal(32000)
    window = np.zeros(FFT)
    window[(FFT - WINDOW) // 2 : (FFT + WINDOW) // 2] = scipy.signal.get_window("hann", WINDOW)
    padded = np.pad(sound, FFT // 2, mode="reflect")
    frames = np.stack([padded[i * HOP : i * HOP + FFT] * window for i in range(201)], 1)
    found = spectrogram(torch.from_numpy(sound)[None].float())[0]
    np.testing.assert_allclose(found, np.fft.rfft(frames, axis=0), atol=1e-3)


def test_a_click_is_in_the_frames_whose_25_milliseconds_hold_it():
    """Frames are 10 ms apart, so that those 10 ms before and after hold it, those 20 ms away do not."""
    click = torch.zeros(1, int(DURATION * SAMPLE_RATE))
    click[0, SAMPLE_RATE] = 1
    loud = spectrogram(click).abs()[0].amax(0)
    assert torch.nonzero(loud > 1e-6)[:, 0].tolist() == [99, 100, 101]
    away = np.cos(np.pi * 0.010 / 0.025) ** 2  # of Hann's window, 10 ms from its middle
    np.testing.assert_allclose(loud[99:102], [away, 1, away], rtol=1e-4)
