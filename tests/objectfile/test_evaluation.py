"""Scores of answers that are known: perfect, silent, noise, off by a factor."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from brick import SCALE
from refusals import refused

from objectfolder import ObjectFile
from objectfolder.base.materials import material
from objectfolder.base.metrics import psnr
from objectfolder.objectfile.evaluation import summary_row
from objectfolder.sound.evaluation import (
    SoundTruth,
    UnitStrikes,
    compare_sounds,
    count_lost_modes,
    draw_noise,
    evaluate_sound,
    lost_energy,
)
from objectfolder.sound.gains_net import energy_weights
from objectfolder.sound.spectrogram import spectrogram
from objectfolder.sound.synthesis import gains, sinusoid_bank
from objectfolder.touch.evaluation import evaluate_touch, score_images
from objectfolder.vision.cameras import Intrinsics, look_at, sphere_points
from objectfolder.vision.evaluation import choose_views, compare_views, evaluate_vision

ROWS = np.arange(20, 60)
PLACES = ("points", "split")  # what is not of modes
LIMIT, FOUND = 20000.0, 200


@pytest.fixture(scope="module")
def modes(brick):
    """Ground truth that is the brick's own answer, so that it scores as perfect."""
    points = brick.sample_surface(60) / SCALE
    return {
        "points": points,
        "split": np.where(np.isin(np.arange(len(points)), ROWS), 2, 0),
        "shapes": brick.mode_shapes(points * SCALE),
        "damped_frequency": brick.tensors["audio.damped_frequency"],
        "damping": brick.tensors["audio.damping"],
    }


@pytest.fixture
def strikes(rng):
    return UnitStrikes.random(ROWS, 20, rng)


def score(brick, modes, strikes, seed=0):
    report = {"count_below_max_frequency": None}
    return evaluate_sound(brick, SoundTruth(modes, report, strikes, np.random.default_rng(seed)))


def louder(modes, factor, mode=slice(None)):
    shapes = modes["shapes"].copy()
    shapes[..., mode] *= factor
    return modes | {"shapes": shapes}


def test_strikes_are_unit_impulses_at_the_given_points(strikes):
    assert set(strikes.rows) <= set(ROWS)
    np.testing.assert_allclose(np.linalg.norm(strikes.impulses, axis=1), 1)
    assert len(set(strikes.rows)) > 10
    (title,) = strikes[:1].describe(np.zeros((60, 3)))
    assert title.startswith("at (0.0, 0.0, 0.0) mm\ntowards (")


def test_the_truth_scores_perfectly(brick, modes, strikes):
    scores = score(brick, modes, strikes)
    assert min(scores["psnr"], scores["psnr_own_max"]) > 150
    assert max(scores[name] for name in ("gain_error", "gain_error_frobenius", "gain_error_worst")) < 1e-6
    assert scores["frequency_error"] == scores["decay_time_error"] == 0
    assert (scores["modes"], scores["points"], scores["impacts"]) == (12, 40, 20)


def test_an_answer_that_is_too_quiet(brick, modes, strikes):
    """Everything is linear: a tenth too quiet is 20 dB better than silence."""
    scores = score(brick, louder(modes, 1 / 0.9), strikes)
    for name in ("gain_error", "gain_error_frobenius", "gain_error_worst"):
        assert scores[name] == pytest.approx(0.1, rel=1e-4)
    assert scores["psnr"] - scores["baseline_silence"] == pytest.approx(20, abs=0.01)
    one = score(brick, louder(modes, 2.0, 7), strikes)
    assert one["gain_error_worst"] == pytest.approx(0.5)
    assert one["worst_mode_hz"] == pytest.approx(brick.frequencies[7])
    assert one["gain_error"] < 0.5


def test_the_baselines_are_silence_and_noise_of_the_same_energy(brick, modes, strikes):
    """By the definition, from the sounds themselves."""
    scores = score(brick, modes, strikes)
    truth, _ = compare_sounds(brick, modes, strikes)
    spectra = torch.view_as_real(spectrogram(torch.from_numpy(truth))).numpy()
    span = np.ptp(spectra)
    silence = -10 * np.log10(np.mean((spectra / span) ** 2))
    assert scores["baseline_silence"] == pytest.approx(silence, abs=0.01)
    # Noise is not correlated with the sound: both energies add.
    noise = draw_noise(torch.from_numpy(truth), np.random.default_rng(1))
    np.testing.assert_allclose(noise.norm(dim=1), np.linalg.norm(truth, axis=1), rtol=1e-5)
    hiss = torch.view_as_real(spectrogram(noise)).numpy()
    both = -10 * np.log10(np.mean((spectra / span) ** 2) + np.mean((hiss / span) ** 2))
    assert scores["baseline_noise"] == pytest.approx(both, abs=0.1)
    assert scores["baseline_noise"] < silence - 1  # saying nothing is better


def test_the_mean_over_sounds_counts_each_alike(brick, modes, strikes):
    """Errors are proportional to the sounds: so is the distance of each from its own silence."""
    scores = score(brick, louder(modes, 1 / 0.9), strikes)
    truth, _ = compare_sounds(brick, louder(modes, 1 / 0.9), strikes)
    spectra = torch.view_as_real(spectrogram(torch.from_numpy(truth))).numpy()
    silence = -10 * np.log10(np.mean((spectra / np.ptp(spectra)) ** 2, axis=(1, 2, 3)))
    assert scores["psnr_mean"] == pytest.approx(silence.mean() + 20, abs=0.01)
    assert scores["psnr_mean"] > scores["psnr"]


def test_the_nearest_training_point_is_a_baseline(brick, modes, strikes):
    train = np.setdiff1d(np.arange(len(modes["points"])), ROWS)
    apart = np.linalg.norm(modes["points"][ROWS][:, None] - modes["points"][train], axis=2)
    answer = modes["shapes"][train[apart.argmin(1)]]
    weight = (1 / (4 * modes["damping"] * modes["damped_frequency"] ** 2))[None, None]
    truth = modes["shapes"][ROWS]
    error = np.sqrt((weight * (answer - truth) ** 2).sum() / (weight * truth**2).sum())
    assert score(brick, modes, strikes)["baseline_nearest"] == pytest.approx(error, rel=1e-4)


def test_errors_of_frequency_and_decay_time_are_relative(brick, modes, strikes):
    shifted = modes["damped_frequency"].copy()
    shifted[3] *= 1.01
    scores = score(brick, modes | {"damped_frequency": shifted, "damping": modes["damping"] * 1.2}, strikes)
    assert scores["frequency_error"] == pytest.approx(1 - 1 / 1.01)
    assert scores["decay_time_error"] == pytest.approx(0.2)


def test_points_that_the_stored_surface_lost_are_scored_at_the_nearest_place(brick, modes, strikes):
    far = dict(modes, points=modes["points"].copy())
    far["points"][ROWS] *= 1.5
    refused("off the surface", brick.mode_shapes, far["points"] * SCALE)
    assert 0 < score(brick, far, strikes)["gain_error"] < np.inf


def test_other_modes_than_the_files_are_refused(brick, modes, strikes):
    fewer = {name: value if name in PLACES else value[..., :5] for name, value in modes.items()}
    refused(r"brick: .* 12 modes, modes.npz 5; run `objectfolder build", score, brick, fewer, strikes)


def test_strike_sounds_are_the_answers_beside_the_truth(brick, modes, strikes):
    truth, answers = compare_sounds(brick, modes, strikes)
    assert truth.shape == answers.shape == (20, 32000)
    np.testing.assert_allclose(answers, truth, atol=1e-5 * np.abs(truth).max())
    bank = sinusoid_bank(torch.from_numpy(modes["damped_frequency"]), torch.from_numpy(modes["damping"]))
    shape, impulse = modes["shapes"][strikes.rows[2]], strikes.impulses[2]
    one = gains(torch.from_numpy(shape)[None].double(), torch.from_numpy(impulse)[None]).float() @ bank
    np.testing.assert_allclose(truth[2], one[0], atol=1e-6 * np.abs(truth[2]).max())


def mute(brick, modes, kept):
    """An object with only some of its modes, and its ground truth."""
    tensors = dict(brick.tensors)
    for name in ("damped_frequency", "damping", "amplitude"):
        tensors[f"audio.{name}"] = tensors[f"audio.{name}"][kept]
    for name in ("weight", "weight_exponent", "bias"):
        value = tensors[f"audio.output.{name}"]
        rows = value.reshape(3, 12, *value.shape[1:])[:, kept]
        tensors[f"audio.output.{name}"] = rows.reshape(-1, *value.shape[1:])
    kept_modes = {name: value if name in PLACES else value[..., kept] for name, value in modes.items()}
    return ObjectFile(brick.header, tensors), kept_modes


@pytest.mark.parametrize("kept", [slice(0, 0), slice(-1, None)])
def test_a_silent_object_has_no_score_and_nothing_that_is_not_a_number(brick, modes, strikes, kept):
    """No mode at all, or none below the Nyquist frequency of the spectrogram."""
    if kept.start:
        high = modes["damped_frequency"].copy()
        high[-1] = 2 * np.pi * 9000
        brick = ObjectFile(brick.header, {**brick.tensors, "audio.damped_frequency": high})
        modes = modes | {"damped_frequency": high}
    silent, none = mute(brick, modes, kept)
    scores = score(silent, none, strikes)
    assert "psnr" not in scores
    assert scores["modes_heard"] == 0
    json.dumps(scores, allow_nan=False)
    truth, answers = compare_sounds(silent, none, strikes)
    assert not truth.any()
    assert not answers.any()
    row = summary_row("x", {"vision": {}, "audio": scores, "touch": {}, "file_bytes": 1})
    assert row["audio / silence"] == "silent"
    assert row["modes"] == str(len(none["damping"]))


def test_the_summary_shows_baselines_beside_scores_and_the_modes_that_were_not_solved(brick, modes, strikes):
    audio = score(brick, modes, strikes) | {"psnr": 101.24, "baseline_silence": 50.06}
    audio |= {"gain_error": 0.0031, "baseline_nearest": 0.0404, "modes_found": 40}
    row = summary_row("x", {"vision": {}, "audio": audio, "touch": {}, "file_bytes": 1})
    assert row["audio / silence"] == "101.2 / 50.1"
    assert row["gain error / nearest"] == "0.3% / 4.0%"
    assert row["modes"] == "12 of 40"
    marked = summary_row(
        "x", {"vision": {}, "audio": audio | {"uncertain": True}, "touch": {}, "file_bytes": 1}
    )
    assert marked == row | {"audio / silence": "101.2 / 50.1, uncertain"}


def test_strikes_across_a_mode_score_finitely(brick, modes, strikes):
    """Where the truth is silent although the object is not, nothing is divided by zero."""
    quiet = dataclasses.replace(strikes, impulses=strikes.impulses * (np.arange(20) > 0)[:, None])
    json.dumps(score(brick, modes, quiet), allow_nan=False)
    none = dataclasses.replace(strikes, impulses=0 * strikes.impulses)
    assert "psnr" not in score(brick, modes, none)


# Modes that were not solved


@pytest.fixture
def all_modes(rng):
    """All modes of an object, as evenly spaced as a plate's, with shapes of equal mean square."""
    return {
        "shapes": rng.standard_normal((500, 3, FOUND)).astype(np.float32),
        "damped_frequency": 2 * np.pi * (np.arange(FOUND) + 0.5) / FOUND * LIMIT,
    }


def kept(modes, count):
    return {name: value[..., :count] for name, value in modes.items()}


@pytest.mark.parametrize("law", ["rayleigh", "loss_factor"])
@pytest.mark.parametrize("count", [10, 60, 199])
def test_the_estimate_is_the_energy_that_a_reference_with_all_modes_has_more(all_modes, law, count):
    wood = material("wood", law)
    w = all_modes["damped_frequency"]
    energy = (all_modes["shapes"] ** 2).mean((0, 1)) * energy_weights(w, wood.damping(w**2))
    estimate = lost_energy(*kept(all_modes, count).values(), wood, FOUND, LIMIT)
    assert estimate == pytest.approx(energy[count:].sum() / energy.sum(), rel=0.1)


def test_no_mode_is_lost_if_all_were_kept(all_modes):
    report = {"count_below_max_frequency": FOUND, "max_frequency_hz": LIMIT, "truncated": False}
    report |= {"material": "wood", "material_properties": material("wood").properties()}
    assert count_lost_modes(all_modes, report) == {"modes_found": FOUND, "lost_energy": 0.0}
    few = count_lost_modes(kept(all_modes, 20), report | {"truncated": True})
    assert few["modes_found"] == FOUND
    assert 0 < few["lost_energy"] < 1
    assert lost_energy(*kept(all_modes, 0).values(), material("wood"), FOUND, LIMIT) == 0
    # Scaled from an earlier solve, which did not count them.
    assert count_lost_modes(all_modes, report | {"count_below_max_frequency": None}) == {}


# Views


@pytest.fixture(scope="module")
def views(brick):
    """Views that are the brick's own answers, the third with an error, of another focal length and format."""
    rng = np.random.default_rng(4)
    poses, lights = look_at(sphere_points(5, 2.5, rng)), sphere_points(5, 1.0, rng)
    rgba = brick.render(poses, lights, intrinsics=Intrinsics(30, 20, 40.0)).rgba
    for row, error in ((2, 0.3), (4, 0.1)):
        rgba[row, 10, 15, :3] += error
    optics = {"focal": np.float64(40.0), "center": np.full((5, 2), [15.0, 10.0])}
    return {"rgba": rgba, "camera_to_world": poses, "light": lights} | optics


def test_the_best_the_median_and_the_worst_view_are_named(brick, views):
    scores = evaluate_vision(brick, views)
    # The median is the third best, of three that are perfect.
    assert (scores["worst_view"], scores["median_view"], scores["best_view"]) == (2, 3, 0)
    assert scores["psnr_worst"] < 50
    rgba = np.ones((5, 2, 2, 4))
    titles = choose_views(scores, rgba, 4)
    assert list(titles.items())[:3] == [(2, "worst: view 3"), (3, "median: view 4"), (0, "best: view 1")]
    assert len(titles) == 4
    assert set(choose_views(scores, rgba, 9)) == set(range(5))
    rgba[0, ..., :3] = rgba[1, 0, :, :3] = 0  # the best is black, another half lit
    titles = choose_views(scores, rgba, 4)
    assert list(titles.values()) == ["worst: view 3", "median: view 4", "view 5", "view 2"]
    single = {name: value if name == "focal" else value[2:3] for name, value in views.items()}
    scores = evaluate_vision(brick, single)
    assert scores["best_view"] == scores["median_view"] == scores["worst_view"] == 0
    assert choose_views(scores, rgba[:1], 5) == {0: "worst: view 1"}


def test_views_are_compared_with_their_truth(brick, views):
    truth, answers, scores = compare_views(brick, views, [2, 0])
    assert truth.shape == answers.shape == (2, 20, 30, 3)
    np.testing.assert_allclose(truth[1], answers[1], atol=1e-6)
    assert scores[0] == pytest.approx(evaluate_vision(brick, views)["psnr_worst"])
    assert scores[1] > 60


def test_compared_views_are_scored_without_the_noise_of_their_truth(brick, views):
    noise = 0.001 * np.random.default_rng(5).normal(size=views["rgba"].shape)
    noise *= views["rgba"][..., 3:] * [1, 1, 1, 0]
    noisy = views | {"rgba": views["rgba"] + noise, "noise": noise}
    truth, answers, scores = compare_views(brick, noisy, [2, 0])
    assert scores[0] == pytest.approx(evaluate_vision(brick, noisy)["psnr_worst"])
    old = compare_views(brick, noisy | {"noise": np.zeros((5, 2))}, [2, 0])[2]  # of an older build
    np.testing.assert_allclose(old, psnr(np.square(answers - truth).mean((1, 2, 3))), rtol=1e-4)
    assert scores[1] > old[1] + 3


# Touches


def grey(levels, obstructed, pixels):
    """Contacts whose images have one grey level, and masks of so many pixels."""
    masks = np.arange(20 * 10).reshape(1, 20, 10) < np.array(pixels)[:, None, None]
    images = np.broadcast_to(np.array(levels, np.uint8)[:, None, None, None], (len(levels), 20, 10, 3)).copy()
    return {"images": images, "masks": masks, "obstructed": np.array(obstructed)}


def test_scores_of_touches_are_pooled_over_the_contacts_that_count():
    contacts = grey([100, 100, 100, 100], [0, 0, 0, 0.4], [60, 100, 10, 60])
    images = contacts["images"].copy()
    images[0] += 51  # a fifth of the range
    images[1, 10:] += 51  # half, none of it in contact
    images[2, :1] += 51  # a twentieth: all of the contact, which is too small to count
    images[3] += 102
    scores = score_images(images, contacts)
    free = np.array([1, 0.5, 0.05]) * 0.04
    assert scores["psnr"] == pytest.approx(-10 * np.log10((free.sum() + 0.16) / 4), abs=1e-4)
    assert scores["psnr_unobstructed"] == pytest.approx(-10 * np.log10(free.mean()), abs=1e-4)
    assert scores["psnr_median_unobstructed"] == pytest.approx(-10 * np.log10(0.02), abs=1e-4)
    assert scores["psnr_contact"] == pytest.approx(-10 * np.log10(0.04 * 60 / 160), abs=1e-4)
    assert scores["obstructed_fraction"] == 0.25


def test_obstructed_or_tiny_contacts_have_no_score_of_their_own():
    scores = score_images(grey([1, 2], [0.1, 1.0], [90, 90])["images"], grey([1, 2], [0.1, 1.0], [90, 90]))
    assert not {"psnr_unobstructed", "psnr_median_unobstructed", "psnr_contact"} & set(scores)
    assert "psnr_contact" not in score_images(grey([1], [0], [49])["images"], grey([1], [0], [49]))


def test_touches_beside_the_mean_image_and_their_forces(brick):
    contacts = {"points": brick.sample_surface(5), "depths": np.full(5, 0.001), "angles": np.zeros(5)}
    found, mean = brick.press(*contacts.values()), np.full((160, 120, 3), 100.0)
    contacts |= {"images": found.images, "masks": found.mask, "force": found.force}
    contacts |= {"obstructed": np.zeros(5), "mean_image": mean}
    perfect = evaluate_touch(brick, contacts)
    assert perfect["psnr"] == pytest.approx(200, abs=1e-3)  # float32: the last digit is the machine's
    assert perfect["psnr_contact"] == pytest.approx(200, abs=1e-3)
    assert perfect["force_error"] == 0
    error = np.mean((found.images / 255.0 - mean / 255.0) ** 2)
    assert perfect["baseline_mean_image"] == pytest.approx(-10 * np.log10(error), abs=1e-3)
    weaker = evaluate_touch(brick, contacts | {"force": 0.8 * found.force})
    assert weaker["force_error"] == pytest.approx(0.25)
    astray = evaluate_touch(brick, contacts | {"points": 1.5 * contacts["points"]})  # which a query refuses
    assert astray["psnr"] < perfect["psnr"]
    unknown = evaluate_touch(brick, contacts | {"force": np.full(5, np.nan)})
    assert "force_error" not in unknown
    json.dumps(unknown, allow_nan=False)
