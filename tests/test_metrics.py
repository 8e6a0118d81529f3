import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from objectfolder.base.metrics import SpectrogramErrors, gain_errors, psnr, ssim


def test_psnr_of_known_errors():
    assert psnr(0.01) == pytest.approx(20)
    assert psnr(1.0) == pytest.approx(0)
    assert psnr(4.0, peak=20.0) == pytest.approx(20)
    assert psnr(0.0) == pytest.approx(200)
    np.testing.assert_allclose(psnr(np.array([0.1, 0.001])), [10, 30])


def test_ssim(rng):
    image = rng.random((40, 50, 3))
    assert ssim(image, image) == pytest.approx(1, abs=1e-6)
    noisy = [ssim(image, np.clip(image + rng.normal(0, s, image.shape), 0, 1)) for s in (0.02, 0.1, 0.5)]
    assert 1 > noisy[0] > noisy[1] > noisy[2] > 0
    other = rng.random((40, 50, 3))
    assert ssim(image, other) == pytest.approx(ssim(other, image), abs=1e-6)


def test_ssim_is_the_mean_over_all_11x11_gaussian_windows(rng):
    image = rng.random((20, 25, 3))
    other = np.clip(image + rng.normal(0, 0.1, image.shape), 0, 1)
    profile = np.exp(-((np.arange(11) - 5) ** 2) / (2 * 1.5**2))
    weights = np.outer(profile, profile) / profile.sum() ** 2
    x, y = (np.lib.stride_tricks.sliding_window_view(v, (11, 11), (0, 1)) for v in (image, other))

    def mean(values):
        return (values * weights).sum((-2, -1))

    mx, my = mean(x), mean(y)
    variance, covariance = mean(x * x) - mx**2 + mean(y * y) - my**2, mean(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    expected = (2 * mx * my + c1) * (2 * covariance + c2) / ((mx**2 + my**2 + c1) * (variance + c2))
    assert ssim(other, image) == pytest.approx(expected.mean(), abs=1e-12)


@given(st.floats(1e-6, 1e6), st.floats(1e-3, 1e3), st.integers(0, 99))
def test_gain_errors_do_not_depend_on_scale(shape_scale, weight_scale, seed):
    rng = np.random.default_rng(seed)
    truth, predicted = rng.standard_normal((2, 6, 3, 4))
    energy, gain = rng.random((2, 4)) + 0.1
    a = gain_errors(predicted, truth, energy, gain)
    b = gain_errors(shape_scale * predicted, shape_scale * truth, weight_scale * energy, weight_scale * gain)
    assert a == pytest.approx(b)


def test_the_worst_mode_has_the_largest_error_of_its_own(rng):
    truth = rng.standard_normal((6, 3, 4)) * [1, 10, 0.1, 0]
    predicted = truth * [1.1, 1.2, 1.5, 1]
    errors = gain_errors(predicted, truth, np.ones(4), np.ones(4))
    assert errors["worst_mode"] == 2  # although it hardly counts
    assert errors["gain_error_worst"] == pytest.approx(0.5)
    assert errors["gain_error"] == pytest.approx(0.2, abs=0.01)


def test_gain_errors_of_known_predictions(rng):
    truth, weights = rng.standard_normal((6, 3, 4)), np.ones(4)
    names = ("gain_error", "gain_error_frobenius", "gain_error_worst")
    for factor in (1, 0, 1.1):
        errors = gain_errors(factor * truth, truth, weights, weights)
        assert [errors[name] for name in names] == pytest.approx([abs(factor - 1)] * 3)
    # An error in a mode without weight does not count.
    wrong = truth.copy()
    wrong[:, :, 0] += 9
    assert gain_errors(wrong, truth, np.array([0, 1, 1, 1]), weights)["gain_error"] == 0
    assert gain_errors(truth, 0 * truth, weights, weights)["gain_error"] == 0


def test_modes_weigh_by_energy_and_by_the_square_of_their_gain():
    """Two modes of equal shapes, the second off by a tenth: its share of the weight times 0.1 squared."""
    truth = np.ones((5, 3, 2))
    wrong = truth * [1, 1.1]
    errors = gain_errors(wrong, truth, np.array([3.0, 1.0]), np.array([1.0, 2.0]))
    assert errors["gain_error"] == pytest.approx(0.1 * np.sqrt(1 / 4))
    assert errors["gain_error_frobenius"] == pytest.approx(0.1 * np.sqrt(4 / 5))


def test_spectrograms_are_scored_in_the_range_of_the_truth():
    """Real and imaginary parts from -2 to 6, off by 0.8 and silent in turn: a tenth of the range is 20 dB."""
    truth = torch.tensor([[[-2 + 6j, 2 + 2j]], [[0j, 1 + 1j]]])
    errors = SpectrogramErrors()
    for part in truth.split(1):
        errors.add(part + (0.8 + 0.8j), part)
    scores = errors.scores()
    assert scores["psnr"] == pytest.approx(20, abs=1e-4)
    assert scores["psnr_mean"] == pytest.approx(20, abs=1e-4)
    power = (4 + 36 + 4 + 4 + 1 + 1) / 8
    assert scores["baseline_silence"] == pytest.approx(10 * np.log10(64 / power))
