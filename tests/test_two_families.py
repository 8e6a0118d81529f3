"""Tables of perf/faithful.py and perf/holdout.py: means over objects, beside trivial answers."""

import faithful
import holdout
import numpy as np
import pytest


def scored(decibel):
    """Return scores as `evaluate` writes them."""
    audio = {"gain_error": 0.01, "baseline_silence": 52.0, "baseline_nearest": 0.2}
    return {
        "vision": {"psnr": decibel, "psnr_lit_foreground": 20.0, "baseline_white": 9.0},
        "audio": {"psnr": decibel + 20, **audio},
        "touch": {"psnr": decibel + 1, "baseline_mean_image": 27.0},
    }


def built(decibel, seconds):
    steps = {"vision": 4000 + 100 * decibel, "audio": 50_000, "touch": 500_000}
    return {
        "scores": scored(decibel),
        "hours": dict.fromkeys(faithful.MODALITIES, seconds / 3600),
        "curves": {sense: [[20, 0.2, 0.2], [count, 0.1, 0.1]] for sense, count in steps.items()},
    }


def test_a_mean_over_objects_ends_each_sense_and_stands_beside_the_papers():
    objects = {
        "paper": {"mug": built(5.0, 600), "die": built(15.0, 1200), "bell": built(1.0, 1)},
        "default": {"mug": built(40.0, 6), "die": built(42.0, 6)},  # the bell failed: in no mean
    }
    rows = faithful.rows_of(objects, {"vision": 128, "audio": 2048, "touch": 16_384})
    assert [row["object"] for row in rows] == ["mug", "die", "mean"] * 3
    assert [row["steps"] for row in rows[:3]] == [4500, 5500, 5000]  # where each one's curve ends
    vision, audio, touch = (row for row in rows if row["object"] == "mean")
    assert (vision["paper_net"], vision["default_net"], vision["trivial"]) == (10, 41, 9)
    assert vision["hours"] == pytest.approx(0.25)
    shares = [[row[f"of_papers_{what}"] for row in (vision, audio, touch)] for what in ("steps", "drawn")]
    np.testing.assert_allclose(shares, [[0.01, 0.1, 1], [0.01 / 8, 0.1 / 8, 1]], rtol=1e-12)
    assert vision["drawn"] == 640_000
    assert [row["paper"] for row in (vision, audio, touch)] == [39.8, 53.6, 29.4]


def test_families_differ_by_their_nets_alone():
    paper = {"vision": "osf", "audio": "spectrogram", "touch": "image"}
    assert faithful.family_nets("paper") == {f"train_{sense}.net": net for sense, net in paper.items()}
    assert set(faithful.family_nets("default").values()) == {"surface", "gains", "geometric"}


def test_objects_never_seen_have_means_and_silent_ones_no_sound():
    silent = scored(44.0)
    silent["audio"] = {"modes": 3, "modes_heard": 0}
    found = {row["score"]: row for row in holdout.means({"a": scored(40.0), "b": silent})}
    assert found["vision psnr"]["mean"] == 42
    assert found["vision psnr"]["baseline"] == 9
    assert found["audio psnr"]["mean"] == 60
    assert [found[f"{sense} psnr"]["objects"] for sense in faithful.MODALITIES] == [2, 1, 2]
    assert "baseline" not in found["vision psnr_lit_foreground"]
    assert holdout.means({}) == []
