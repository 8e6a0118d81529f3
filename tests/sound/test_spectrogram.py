import numpy as np
import pytest
import scipy.signal
import torch
from PIL import Image

from objectfolder.base.figures import page, save_page
from objectfolder.sound.spectrogram import DURATION, FFT, HOP, SAMPLE_RATE, WINDOW, show_sounds, spectrogram


def tone(hertz):
    return torch.sin(2 * np.pi * hertz * torch.arange(int(DURATION * SAMPLE_RATE)) / SAMPLE_RATE)[None]


def test_two_seconds_give_257_by_201_complex_bins():
    answer = spectrogram(tone(440))
    assert answer.shape == (1, 257, 201)
    assert answer.is_complex()


def test_it_agrees_with_scipy(rng):
    sound = rng.standard_normal(32000)
    window = np.zeros(FFT)
    window[(FFT - WINDOW) // 2 : (FFT + WINDOW) // 2] = scipy.signal.get_window("hann", WINDOW)
    padded = np.pad(sound, FFT // 2, mode="reflect")
    frames = np.stack([padded[i * HOP : i * HOP + FFT] * window for i in range(201)], 1)
    np.testing.assert_allclose(
        spectrogram(torch.from_numpy(sound)[None].float())[0], np.fft.rfft(frames, axis=0), atol=1e-3
    )


def test_a_click_is_in_the_frames_whose_25_milliseconds_hold_it():
    """Frames are 10 ms apart, so that those 10 ms before and after hold it, those 20 ms away do not."""
    click = torch.zeros(1, int(DURATION * SAMPLE_RATE))
    click[0, SAMPLE_RATE] = 1
    loud = spectrogram(click).abs()[0].amax(0)
    assert torch.nonzero(loud > 1e-6)[:, 0].tolist() == [99, 100, 101]
    away = np.cos(np.pi * 0.010 / 0.025) ** 2  # of Hann's window, 10 ms from its middle
    np.testing.assert_allclose(loud[99:102], [away, 1, away], rtol=1e-4)


def test_the_sheet_shows_truth_answer_and_difference(tmp_path):
    time = np.arange(32000) / 16000
    truth = np.stack([np.sin(2 * np.pi * f * time) * np.exp(-4 * time) for f in (1000, 3000)])
    figure = page(8, 9, "x: sounds")
    show_sounds(figure, truth, 0.9 * truth, ["one", "two"])
    panels = figure.axes[:6]
    assert [a.get_title() for a in panels[::2]] == ["one\nground truth", "Object File", "difference"]
    assert panels[0].get_ylabel() == "frequency [kHz]"
    assert panels[4].get_xlabel() == "time [s]"
    assert figure.axes[6].get_ylabel() == "dB relative to the peak of the ground truth"
    peaks = np.array([a.images[0].get_array().max() for a in panels]).reshape(3, 2)
    np.testing.assert_allclose(peaks, [[0, 0], [20 * np.log10(0.9)] * 2, [-20, -20]], atol=1e-3)
    # Rows are frequencies: 1 and 3 kHz out of 8.
    for axes, hertz in zip(panels[:2], (1000, 3000)):
        loudest = int(axes.images[0].get_array()[:, 50].argmax())
        assert loudest * 8000 / 256 == pytest.approx(hertz, abs=32)
    with Image.open(save_page(figure, tmp_path / "sheet.png")) as image:
        assert np.asarray(image.convert("RGB")).std() > 5


def test_the_sheet_of_silence_says_so(tmp_path):
    figure = page(8, 9, "x: silence")
    show_sounds(figure, np.zeros((2, 32000)), np.zeros((2, 32000)), ["one", "two"])
    assert all(a.texts[0].get_text() == "silent" for a in figure.axes)
    assert save_page(figure, tmp_path / "sheet.png").stat().st_size > 1000
