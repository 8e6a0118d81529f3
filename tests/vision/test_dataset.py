"""Views as they are stored, and the noise that they are said to have."""

import numpy as np
import pytest
import torch
from solids import box, join, sphere

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.vision.cameras import Intrinsics, image_intrinsics
from objectfolder.vision.color import on_white
from objectfolder.vision.evaluation import evaluate_vision, noiseless_error
from objectfolder.vision.renderers.mitsuba import MitsubaRenderer
from objectfolder.vision.scene import Scene
from objectfolder.vision.truth import TILES_PER_LIGHT, Frames, render_frames

SMALL = Intrinsics.square(32)


class Noisy:
    """A grey disc, lit on its left half, with noise that falls with the root of the samples."""

    version = "noisy"

    def __init__(self, deviation=0.1):
        self.deviation = deviation
        self.asked = []
        rows, columns = np.mgrid[:32, :32] - 15.5
        alpha = (np.hypot(rows, columns) < 12).astype(np.float32)
        self.truth = np.stack([0.4 * alpha * (columns < 0)] * 3 + [alpha], 2).astype(np.float32)

    def render(self, camera_to_world, light, intrinsics, samples, seed):
        self.asked.append((samples, seed))
        noise = np.random.default_rng(seed).standard_normal((32, 32, 3)) * self.deviation / samples**0.5
        image = self.truth.copy()
        image[..., :3] += noise * (image[..., :3] > 0)
        return image


class Perfect:
    """Answers views with the truth behind their noise."""

    def __init__(self, *images):
        self.images = iter(images)

    def view(self, pose, light, intrinsics):
        image = next(self.images)
        return on_white(torch.from_numpy(image)).numpy()[None]


def split(renderer, samples, halves=True, count=4):
    rng = np.random.default_rng(5)
    return render_frames(renderer, Frames.views(count, SMALL, rng), samples, rng, halves=halves)


def test_halves_share_the_samples_and_no_seed():
    renderer = Noisy()
    views = split(renderer, 64)
    samples, seeds = zip(*renderer.asked)
    assert samples == (32,) * 8
    assert len(set(seeds)) == 8
    pairs = [Noisy().render(None, None, None, 32, seed) for seed in seeds]
    np.testing.assert_allclose(views["rgba"][1], (pairs[2] + pairs[3]) / 2, atol=1e-3)
    np.testing.assert_allclose(views["noise"][1], (pairs[2] - pairs[3]) / 2, atol=1e-3)


def test_a_split_without_halves_is_one_render_of_the_same_cameras():
    renderer = Noisy()
    views, halves = split(renderer, 64, halves=False), split(Noisy(), 64)
    assert [samples for samples, _ in renderer.asked] == [64] * 4
    for name in ("camera_to_world", "light"):
        np.testing.assert_array_equal(views[name], halves[name])
    np.testing.assert_array_equal(views["center"], np.full((4, 2), 16.0))
    assert "noise" not in views  # and no floor of the scores
    scores = evaluate_vision(Perfect(*[renderer.truth] * 4), views)
    assert "psnr_lit_foreground" in scores
    assert not any(name.startswith("noise_floor") for name in scores)


class Grey:
    """Answers views with a grey image."""

    def __init__(self, level):
        self.image = np.full((1, 32, 32, 3), level, np.float32)

    def view(self, pose, light, intrinsics):
        return self.image


def noiseless(renderer, count):
    rgba = np.repeat(renderer.truth[None].astype(np.float16), count, axis=0)
    return split(renderer, 2, count=count) | {"rgba": rgba, "noise": np.zeros_like(rgba)}


@pytest.mark.parametrize("level", [0.2, 0.7])
@pytest.mark.parametrize("samples", [4, 16])
def test_scores_of_noisy_views_are_those_of_views_without_noise(samples, level):
    renderer = Noisy()
    scores = evaluate_vision(Grey(level), split(renderer, samples, count=16))
    expected = evaluate_vision(Grey(level), noiseless(renderer, 16))
    assert expected["psnr_standard_error"] == 0
    assert scores["views_at_least"] == expected["views_at_least"] == 0
    assert scores["psnr"] == pytest.approx(expected["psnr"], abs=0.02)
    assert scores["psnr_standard_error"] < 0.05
    for name in ("psnr_pooled", "baseline_white"):
        assert scores[name] == pytest.approx(expected[name], abs=0.02)
    assert scores["psnr_lit_foreground"] == pytest.approx(expected["psnr_lit_foreground"], abs=0.3)


def test_the_standard_error_is_the_spread_of_the_score():
    views = split(Noisy(), 4, count=400)
    one = [{name: v[i : i + 1] for name, v in views.items() if name in ("rgba", "noise")} for i in range(400)]
    image = Grey(0.6).image[0]
    found = [noiseless_error(image, *(v[0].astype(np.float32) for v in each.values())) for each in one]
    means = [error.mean() for error, _ in found]
    expected = np.sqrt(np.mean([np.square(spread).sum() for _, spread in found])) / 32**2
    assert np.std(means) == pytest.approx(expected, rel=0.15)


def test_a_perfect_answer_scores_no_better_than_the_noise_allows_to_tell():
    renderer = Noisy()
    for samples in (16, 64):
        views = split(renderer, samples, count=16)
        scores = evaluate_vision(Perfect(*[renderer.truth] * 16), views)
        assert scores["views_at_least"] > 12
        assert scores["noise_floor"] + 3 < scores["psnr"] < scores["noise_floor"] + 30
        assert scores["noise_floor_lit"] < scores["noise_floor"]  # the background has no noise


def test_four_times_the_samples_are_six_decibels_less_noise():
    scores = [evaluate_vision(Grey(0.5), split(Noisy(), n)) for n in (16, 64)]
    assert scores[1]["noise_floor"] - scores[0]["noise_floor"] == pytest.approx(10 * np.log10(4), abs=0.3)


def test_views_without_light_have_no_lit_score():
    views = noiseless(Noisy(), 2)
    views["rgba"][..., :3] = 0
    assert "noise_floor_lit" not in (scores := evaluate_vision(Grey(0.5), views))
    assert "psnr_lit_foreground" not in scores


@pytest.fixture(scope="module")
def table():
    """A ball over a board, in many colours."""
    solid = join(sphere(0.25, 3, (0, 0, 0.2)), box((1.0, 1.0, 0.1), (0, 0, -0.1)))
    colors = np.random.default_rng(1).integers(0, 255, (len(solid[0]), 3)).astype(np.uint8)
    return Scene(TexturedMesh(*solid, vertex_colors=colors))


def test_scores_of_path_traced_views_are_those_of_converged_ones(table):
    renderer = MitsubaRenderer(table)
    views = split(renderer, 64, count=3)
    shown = zip(views["camera_to_world"], views["light"])
    truth = [renderer.render(pose, light, SMALL, 1024, 1) for pose, light in shown]
    darker = [image * [0.8, 0.8, 0.8, 1] for image in truth]
    still = {"rgba": np.float16(truth), "noise": np.zeros((3, 1, 1, 4))}
    plain = {name: value for name, value in views.items() if name != "noise"}
    expected, noisy = (
        evaluate_vision(Perfect(*darker), views | still),
        evaluate_vision(Perfect(*darker), plain),
    )
    scores = evaluate_vision(Perfect(*darker), views)
    assert abs(scores["psnr"] - expected["psnr"]) < scores["psnr_standard_error"] < 0.8
    assert abs(noisy["psnr"] - expected["psnr"]) > 1


def test_tiles_are_cut_from_whole_views(table):
    renderer, rng = MitsubaRenderer(table), np.random.default_rng(2)
    frames = Frames.tiles(9, 12, table.mesh.vertices, SMALL, rng)
    tiles = render_frames(renderer, frames, 64, rng)
    assert tiles["rgba"].shape == (9, 12, 12, 4)
    corners = np.round(16 - tiles["center"]).astype(int)
    assert len(np.unique(corners, axis=0)) > 4
    for tile, pose, light, (column, row) in zip(tiles["rgba"], frames.camera_to_world, frames.light, corners):
        whole = np.pad(renderer.render(pose, light, SMALL, 64, 1), ((0, 12), (0, 12), (0, 0)))
        truth = whole[row : row + 12, column : column + 12]
        error = np.abs(tile - truth)
        assert truth[..., 3].any()
        assert error[truth[..., 3] == 1].mean() < 0.02
        assert error[..., 3].mean() < 0.01
    stored = [(i.width, i.cx, i.cy) for i in image_intrinsics(tiles)]
    assert stored == [(12, i.cx, i.cy) for i in frames.intrinsics]


def test_every_tile_has_a_camera_and_every_few_a_light():
    frames = Frames.tiles(10, 8, sphere(0.4, 2)[0], SMALL, np.random.default_rng(3))
    assert len(np.unique(frames.camera_to_world[:, :3, 3].round(9), axis=0)) == 10
    changes = np.flatnonzero(np.diff(frames.light, axis=0).any(1)) + 1
    assert changes.tolist() == list(range(TILES_PER_LIGHT, 10, TILES_PER_LIGHT))


def test_a_tile_that_is_larger_than_the_object_begins_where_it_may_begin():
    frames = Frames.tiles(9, 30, np.zeros((1, 3)), SMALL, np.random.default_rng(3))
    # The point is at pixel 16 of 32, and its rectangle begins up to two pixels before it.
    assert all(1 <= c <= 2 for part in frames.intrinsics for c in (part.cx, part.cy))


def test_cameras_are_on_the_sphere_of_radius_two_and_a_half_and_lights_on_that_of_one():
    frames = Frames.views(100, SMALL, np.random.default_rng(0))
    places, axes = frames.camera_to_world[:, :3, 3], frames.camera_to_world[:, :3, :3]
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 2.5)
    np.testing.assert_allclose(np.linalg.norm(frames.light, axis=1), 1)
    np.testing.assert_allclose(2.5 * axes[..., 2], places, atol=1e-9)  # they look at the origin
    for drawn, radius in ((places, 2.5), (frames.light, 1)):  # all around: deviation of a mean 0.06
        assert (np.abs(drawn.mean(0)) < 0.2 * radius).all()
