"""Physical checks of an object."""

import copy

import numpy as np
import pytest

from objectfolder.objectfile.file import ObjectFile
from objectfolder.report.certificate import build_checks, file_checks

NORMALIZE = {"deviation_max_percent": 0.4}
MODAL = {"residual_max": 1e-11, "rigid_hz": [0.0, 0.01], "lowest_hz": [400.0], "max_frequency_hz": 2e4}
SOUND = {"psnr": 100.0, "baseline_silence": 50.0}
SOUND |= {"gain_error": 0.01, "baseline_nearest": 0.05, "lost_energy": 0.01}
METRICS = {
    "vision": {"psnr": 40.0, "baseline_white": 8.0},
    "audio": SOUND,
    "touch": {"psnr": 50.0, "baseline_mean_image": 30.0},
}


def failed(checks):
    return [check.name for check in checks if not check.passed]


def edited(file, **header):
    return ObjectFile(copy.deepcopy(file.header) | header, file.tensors)


def test_a_sound_object_passes(brick):
    checks = file_checks(brick)
    assert failed(checks) == []
    assert len(checks) >= 7


@pytest.mark.parametrize(
    ("solid", "name"),
    [
        ({"volume": 0.3}, "Volumes of surface and solid differ by"),
        ({"inertia": [1, 1, 3, 0, 0, 0]}, "Two smaller moments of inertia, over the largest"),
        ({"centre": [0, 0.4, 0]}, "Centre of mass, depth in the bounding box"),
    ],
)
def test_an_impossible_solid_fails(brick, solid, name):
    assert failed(file_checks(edited(brick, solid=brick.header["solid"] | solid))) == [name]


def test_a_uniform_brick_has_the_figures_of_theory(brick):
    rows = {check.name: check for check in file_checks(brick)}
    a, b, c = np.sort(np.array([1.0, 0.6, 0.3]) ** 2)
    moments = rows["Two smaller moments of inertia, over the largest"]
    assert moments.figure == f"{((a + b) + (a + c)) / (b + c):.3g}"
    centre = rows["Centre of mass, depth in the bounding box"]
    assert (centre.figure, centre.limit) == ("15 mm", "at least 0 mm")  # half of the shortest side


@pytest.mark.parametrize(
    ("change", "figure"),
    [
        ({"frequency_uncertainty": 0.2}, "20 %"),
        ({"frequency_uncertainty_unknown": True}, "not known"),
        ({"frequency_uncertainty": 0.48, "uncertain": True}, "48 %, sound marked uncertain"),
        (
            {"frequency_uncertainty_unknown": True, "uncertain": True},
            "not known, sound marked uncertain",
        ),
    ],
)
def test_uncertain_frequencies_fail(brick, change, figure):
    audio = {k: v for k, v in brick.header["audio"].items() if k != "frequency_uncertainty"} | change
    [check] = [check for check in file_checks(edited(brick, audio=audio)) if not check.passed]
    assert (check.name, check.figure) == ("Estimated error of frequencies", figure)


def test_a_good_build_passes():
    checks = build_checks(NORMALIZE, MODAL, METRICS)
    assert (failed(checks), len(checks)) == ([], 8)
    assert build_checks(None, None, None) == []


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"vision": {"psnr": 7.0, "baseline_white": 8.0}}, "Looks better than an empty picture"),
        ({"audio": SOUND | {"gain_error": 0.1}}, "Error of gains, below that of the nearest known point"),
        ({"audio": SOUND | {"lost_energy": 0.2}}, "Energy of a sound in modes left out"),
        ({"residual_max": 1.0}, "Largest residual of the modes, relative"),
    ],
)
def test_figures_beyond_their_limit_fail(change, name):
    assert failed(build_checks(NORMALIZE, MODAL | change, METRICS | change)) == [name]


def test_presses_are_as_deep_as_the_sensors_profile_says(brick, monkeypatch):
    """A net has learned no others."""
    pressed = []
    real = ObjectFile.press

    def press(self, points, depth):
        pressed.append(np.unique(depth))
        return real(self, points, depth)

    monkeypatch.setattr(ObjectFile, "press", press)
    for low, high in ((2e-4, 4e-4), (3e-4, 3e-4)):
        touch = copy.deepcopy(brick.header["touch"])
        touch["net"]["sensor"]["press_depth"] = [low, high]
        names = [check.name for check in file_checks(edited(brick, touch=touch))]
        assert ("Deeper presses touch more" in names) == (low < high)
    np.testing.assert_allclose(pressed, [[2e-4, 3e-4, 4e-4]])


def test_a_mode_that_never_decays_fails(brick):
    endless = brick.tensors["audio.damping"].copy()
    endless[0] = 0
    file = ObjectFile(brick.header, dict(brick.tensors) | {"audio.damping": endless})
    assert "Every mode decays: least rate" in failed(file_checks(file))
