"""Truth, answer and difference side by side."""

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from objectfolder.base.figures import page, save_page
from objectfolder.report.comparison import MAGMA, join_spectrograms, show_sounds, show_views
from objectfolder.sound.spectrogram import magnitudes


def test_the_sheet_of_views_shows_truth_answer_and_enlarged_difference(rng, tmp_path):
    figure, truth = page(4, 6, "x: views"), 0.2 + 0.8 * rng.random((2, 20, 30, 3))
    show_views(figure, truth, np.clip(truth - 0.1, 0, 1), np.array([42.31, 7]), ["one", "two"])
    assert [a.get_title() for a in figure.axes[:2]] == ["one\n42.3 dB", "two\n7.0 dB"]
    labels = [axes.get_ylabel() for axes in figure.axes[::2]]
    assert labels == ["ground truth", "Object File", "difference, 4 times"]
    difference = figure.axes[5].images[0].get_array()
    np.testing.assert_allclose(difference, 0.6, atol=1e-5)
    with Image.open(save_page(figure, tmp_path / "sheet.png")) as image:
        assert np.asarray(image.convert("RGB")).std() > 5


def test_the_sheet_of_sounds_shows_truth_answer_and_difference(tmp_path):
    time = np.arange(80000) / 40000
    truth = np.stack([np.sin(2 * np.pi * f * time) * np.exp(-4 * time) for f in (1000, 13000)])
    figure = page(8, 9, "x: sounds")
    show_sounds(figure, truth, 0.9 * truth, 40000, ["one", "two"])
    panels = figure.axes[:6]
    assert [a.get_title() for a in panels[::2]] == ["one\nground truth", "Object File", "difference"]
    assert panels[0].get_ylabel() == "frequency [kHz]"
    assert panels[4].get_xlabel() == "time [s]"
    assert figure.axes[6].get_ylabel() == "dB relative to the peak of the ground truth"
    peaks = np.array([a.images[0].get_array().max() for a in panels]).reshape(3, 2)
    np.testing.assert_allclose(peaks, [[0, 0], [20 * np.log10(0.9)] * 2, [-20, -20]], atol=1e-3)
    # Rows are frequencies: 1 and 13 kHz out of 20.
    for axes, hertz in zip(panels[:2], (1000, 13000)):
        loudest = int(axes.images[0].get_array()[:, 50].argmax())
        assert loudest * 20000 / 256 == pytest.approx(hertz, abs=80)
        assert (*axes.get_xlim(), *axes.get_ylim()) == (0, 2, 0, 20)
    with Image.open(save_page(figure, tmp_path / "sheet.png")) as image:
        assert np.asarray(image.convert("RGB")).std() > 5


def test_the_sheet_of_silence_says_so(tmp_path):
    figure = page(8, 9, "x: silence")
    show_sounds(figure, np.zeros((2, 32000)), np.zeros((2, 32000)), 16000, ["one", "two"])
    assert all(a.texts[0].get_text() == "silent" for a in figure.axes)
    assert save_page(figure, tmp_path / "sheet.png").stat().st_size > 1000
    assert magnitudes(np.ones(32000)).shape == (257, 201)  # as of the paper's spectrogram


def test_spectrograms_in_a_row_have_matplotlibs_colours_without_it():
    colours = colormaps["magma"](np.linspace(0, 1, 9))[:, :3]
    np.testing.assert_allclose(np.array([*MAGMA]).reshape(9, 3) / 255, colours, atol=0.01)
    tone = np.sin(2 * np.pi * 2000 * np.arange(16000) / 16000)
    image, seconds = join_spectrograms(tone, tone, 16000)
    assert seconds == 1.0
    width = (image.shape[1] - 4) // 3  # of truth, answer and difference, with gaps of two
    loudest = image[-65, 10:90]  # 2 of 8 kHz
    np.testing.assert_allclose(loudest, np.broadcast_to(colours[-1], (80, 3)), atol=0.05)
    np.testing.assert_allclose(image[:, -width:], np.broadcast_to(colours[0], (257, width, 3)), atol=0.01)


def test_joined_spectrograms_end_at_20_khz():
    sound = np.sin(2 * np.pi * 19500 * np.arange(48000) / 48000)
    image, _ = join_spectrograms(None, sound, 48000)
    assert len(image) == 1 + round(256 * 20 / 24)
    assert np.abs(image[5:8, 20]).sum(-1).argmax() == 0  # bin 208, of 213
