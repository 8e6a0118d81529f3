import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder.base.materials import material
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.samples import available_samples, sample_path
from objectfolder.touch.markers import Markers, draw_markers, marker_flow
from objectfolder.touch.sheared import ShearedTouches

MARKERS = Markers()


@pytest.fixture(scope="module")
def places(digit):
    return MARKERS.places(digit)


def still(profile, count=1):
    shape = (count, profile.height, profile.width)
    return np.zeros((*shape, 2)), np.zeros(shape)


def test_markers_are_a_centred_grid_inside_the_image(digit, places):
    np.testing.assert_allclose(places.mean(axis=0), [59.5, 79.5])
    step = MARKERS.spacing / digit.pixel_pitch
    np.testing.assert_allclose(np.diff(np.unique(places[:, 0].round(9))), step)
    assert places.min() >= MARKERS.radius / digit.pixel_pitch - 0.5
    assert len(places) == 13 * 17


def test_gel_at_rest_moves_no_marker(digit, places):
    assert np.abs(marker_flow(places, *still(digit), digit)).max() < 1e-4


def test_flow_is_the_motion_of_the_gel_in_pixels(flat):
    places = MARKERS.places(flat)
    sideways, towards = still(flat)
    sideways[..., 0], sideways[..., 1] = 3e-4, 1e-4
    expected = np.array([3e-4, -1e-4]) / flat.pixel_pitch
    flow = marker_flow(places, sideways, towards, flat)[0]
    np.testing.assert_allclose(flow, np.broadcast_to(expected, flow.shape), rtol=1e-4)


def test_pressed_gel_looks_larger(flat):
    places = MARKERS.places(flat)
    sideways, towards = still(flat)
    towards += 1e-3
    expected = (places - [59.5, 79.5]) * (0.022 / 0.021 - 1)
    np.testing.assert_allclose(marker_flow(places, sideways, towards, flat)[0], expected, atol=1e-3)


def test_drawn_markers_are_dark_discs_of_their_size(digit, places):
    images = np.full((1, 160, 120, 3), 230, np.uint8)
    flow = np.full((1, len(places), 2), 1.3)
    drawn = draw_markers(images, places, flow, MARKERS, digit)[0]
    assert (images == 230).all()
    for column, row in (places + 1.3)[40:60].round().astype(int):
        assert (drawn[row, column] < 60).all()
    ink = (230 - drawn[..., 0].astype(float)).sum() / 200
    area = np.pi * (MARKERS.radius / digit.pixel_pitch) ** 2
    assert ink / len(places) == pytest.approx(area, rel=0.05)


def test_marker_that_leaves_the_image_is_not_drawn(digit):
    images = np.full((1, 160, 120, 3), 230, np.uint8)
    for away in ((-30.0, 50.0), (200.0, 50.0), (50.0, -9.0), (60.0, 1e4)):
        drawn = draw_markers(images, np.array([away]), np.zeros((1, 1, 2)), MARKERS, digit)
        assert np.array_equal(drawn, images)


@pytest.mark.parametrize("size", [(1e-3, 6e-4), (0.0, 1e-4), (1e-3, 0.0)])
def test_markers_that_overlap_are_refused(size):
    refused("expected a radius above 0 and under half of the spacing", Markers, *size)


@pytest.fixture(scope="module")
def file():
    return ObjectFile.load(sample_path(available_samples()[0]))


@pytest.fixture(scope="module")
def points(file):
    return file.sample_surface(2, seed=3)


def test_pressed_object_can_be_sheared_and_twisted(file, points):
    plain = file.press(points, depth=5e-4)
    found = file.press(points, depth=5e-4, shear=[2e-4, 0.0], twist=[0.0, 0.05], markers=True)
    assert isinstance(found, ShearedTouches)
    assert not isinstance(plain, ShearedTouches)
    assert np.array_equal(found.force, plain.force)
    assert (found.shear_force[:, 0] > 0).all()
    assert (np.hypot(*found.shear_force.T) <= found.friction * found.force * 1.05).all()
    assert found.torque[1] > found.torque[0]
    assert found.friction[0] == file.friction == material(file.material).friction
    assert found.marker_flow.shape == (2, len(found.markers), 2)
    assert (found.images != plain.images).any()
    without = file.press(points, depth=5e-4, shear=[2e-4, 0.0])
    assert (without.images != plain.images).any()
    assert (without.images != found.images).any()
    still = file.press(points, depth=5e-4, shear=[0.0, 0.0])
    assert np.array_equal(still.images, plain.images)
    assert np.array_equal(still.displacement, plain.displacement)
    rows = np.array([[2e-4, 0.0], [2e-4, 0.0]])
    assert np.array_equal(file.press(points, 5e-4, shear=rows).shear_force, without.shear_force)
    tensor = torch.tensor([2e-4, 0.0], dtype=torch.float64, requires_grad=True)
    assert np.array_equal(file.press(points, 5e-4, shear=tensor).shear_force, without.shear_force)


def test_object_moves_as_far_as_the_gel_is_pressed_in_and_turns_by_half(file, points):
    """In any direction; the limit is the sensor's own."""
    point, along = points[:1], np.array([0.6, -0.8])
    for sensor, most in (("digit", 3e-3), ("gelsight_mini", 2.5e-3)):
        little, most_of_all = (
            file.press(point, 5e-4, shear=by * along, sensor=sensor) for by in (most / 10, most * (1 - 1e-9))
        )
        assert 0 < little.shear_force[0] @ along < most_of_all.shear_force[0] @ along
        assert little.slipping[0] < most_of_all.slipping[0]
        message = f"shear: row 0 is .* m long, expected at most {most:g} m, .* sensor '{sensor}'; .*in metres"
        refused(message, file.press, point, 5e-4, shear=1.001 * most * along, sensor=sensor)
    assert file.press(point, 5e-4, twist=-np.pi).torque[0] < 0
    refused("rigid and cannot be sheared", file.press, points, 5e-4, twist=0.1, sensor="tacto_digit")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"shear": [[1e-4, 0], [1, 1]]}, r"shear: row 1 is 1.41421 m long, expected at most 0.003 m"),
        ({"shear": np.zeros((3, 2))}, "shear has 3 rows, expected one or 2"),
        ({"shear": [1e-4, float("nan")]}, "shear: row 0"),
        ({"shear": [[1e-4, 0], [1e-4]]}, "shear"),
        ({"twist": [0.1, -5]}, r"twist: row 1 is -5 rad, .* 3.14 either way; .*in radians"),
        ({"shear": [1e-4, 0], "friction": [0.5, -1]}, "friction: row 1 is -1"),
        ({"markers": 3}, "markers is of type int, expected True, False or a Markers"),
    ],
)
def test_wrong_motions_are_refused_before_anything_is_pressed(file, points, monkeypatch, wrong, message):
    monkeypatch.setattr("objectfolder.touch.geometric_net.press", lambda *given: pytest.fail("pressed"))
    refused(message, file.press, points, **wrong)
