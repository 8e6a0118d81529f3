"""Images of sheared gels: rigid motions of the object, and a surface that is carried along."""

from dataclasses import replace

import numpy as np
import pytest

from objectfolder import ObjectFile
from objectfolder.objectfile.samples import available_samples, sample_path
from objectfolder.touch.camera import gel_depth
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.dragged import dragged_contacts
from objectfolder.touch.gel import deform


@pytest.fixture(scope="module")
def sensor(digit):
    return replace(digit, gel_curvature=0.0)


def bar(sensor, row, column):
    """An ellipsoidal bar, longer than wide, 0.6 mm deep; (1, H, W)."""
    rows, columns = np.indices((sensor.height, sensor.width))
    square = ((rows - row) / 3) ** 2 + (columns - column) ** 2
    return (6e-4 - square * sensor.pixel_pitch**2 / 8e-3).clip(-6e-4)[None].astype(np.float32)


def seen_after(height, dragged, shear, twist, sensor):
    pressure = deform(height, sensor)[1]
    return dragged_contacts(height, pressure, dragged, shear, np.array([twist]), sensor)[1]


def drag(sensor, right, up):
    moved = np.zeros((1, sensor.height, sensor.width, 2), np.float32)
    moved[...] = right, up
    return moved


def test_object_that_does_not_move_changes_nothing(sensor):
    height = bar(sensor, 80, 60)
    seen = seen_after(height, drag(sensor, 0, 0), np.zeros((1, 2)), 0.0, sensor)
    np.testing.assert_allclose(seen, deform(height, sensor)[0], atol=1e-9)


def test_imprint_that_sticks_moves_with_the_object(sensor):
    height, step = bar(sensor, 80, 60), sensor.pixel_pitch
    shear = np.array([[3 * step, 5 * step]])
    seen = seen_after(height, drag(sensor, *shear[0]), shear, 0.0, sensor)
    before = deform(height, sensor)[0][0]
    # Three columns to the right, five rows up.
    np.testing.assert_allclose(seen[0, 10:-10, 10:-10], before[15:-5, 7:-13], atol=2e-8)


def test_height_and_pressure_are_seen_where_the_object_is(sensor):
    step, height = sensor.pixel_pitch, bar(sensor, 80, 60)
    _, pressure = deform(height, sensor)
    shear = np.array([[3 * step, 5 * step]])
    motion = drag(sensor, *shear[0]), shear, np.zeros(1)
    after, displacement, pressed = dragged_contacts(height, pressure, *motion, sensor)
    np.testing.assert_allclose(after[0, 10:-10, 10:-10], height[0, 15:-5, 7:-13], atol=1e-8)
    assert np.array_equal(pressed[0, 10:-10, 10:-10], pressure[0, 15:-5, 7:-13])
    touching = pressed > 0
    np.testing.assert_allclose(displacement[touching], after[touching], atol=2e-8)


def test_object_slides_on_a_gel_without_friction(sensor):
    step = sensor.pixel_pitch
    shear = np.array([[-4 * step, 6 * step]])
    seen = seen_after(bar(sensor, 80, 60), drag(sensor, 0, 0), shear, 0.0, sensor)
    there = deform(bar(sensor, 74, 56), sensor)[0]
    np.testing.assert_allclose(seen, there, atol=5e-6)  # both are solved to 0.8 % of the depth


def test_object_turns_anticlockwise_in_the_image(sensor):
    height = bar(sensor, 79.5, 63.5)  # right of the centre
    seen = seen_after(height, drag(sensor, 0, 0), np.zeros((1, 2)), np.pi / 2, sensor)
    square = np.s_[79 - 39 : 79 + 41, 59 - 39 : 59 + 41]  # pixels around the image's centre
    turned = np.rot90(height[0][square])
    touching = turned > 2e-4
    assert np.abs(seen[0][square] - turned)[touching].max() < 2e-6
    assert np.argwhere(turned == turned.max())[0][0] < 39  # up


@pytest.mark.parametrize("stuck", [0.0, 1.0])
def test_object_under_a_dome_reaches_no_further_than_the_gel_gives_way(digit, stuck):
    """It is as deep as heights get, beside the apex, and moves towards it, where the dome is higher."""
    rows, columns = np.indices((digit.height, digit.width))
    square = ((rows - 79.5) ** 2 + (columns - 100) ** 2) * digit.pixel_pitch**2
    height = (6e-3 - square / 6e-3).clip(-6e-4, digit.max_indentation)[None].astype(np.float32)
    pressure, shear = deform(height, digit)[1], np.array([[-2e-3, 0.0]])
    moved = dragged_contacts(height, pressure, drag(digit, *(stuck * shear[0])), shear, np.zeros(1), digit)
    sag, step = gel_depth(digit) - digit.camera_to_gel, round(2e-3 / digit.pixel_pitch)
    assert (sag[80, 95 - step] - sag[80, 95]) > 1e-4  # by which it would reach further
    limit = np.float32(digit.max_indentation)
    assert [float(of.max()) for of in moved[:2]] == [limit, limit]
    assert moved[0][0, 80, 95 - step] == moved[1][0, 80, 95 - step] == limit


def test_gel_beside_the_contact_is_carried_along(sensor):
    """The free surface keeps its depth where it is dragged: a slope that moves right by a column."""
    height, step = bar(sensor, 80, 60), sensor.pixel_pitch
    before = deform(height, sensor)[0][0]
    shear = np.array([[step, 0.0]])
    slid, stuck = (seen_after(height, drag(sensor, part * step, 0), shear, 0.0, sensor)[0] for part in (0, 1))
    edge = np.s_[80, 74]  # right of the imprint, which ends at column 71
    assert before[edge] < before[80, 73]
    assert stuck[edge] == pytest.approx(before[80, 73], abs=1e-8)
    assert slid[edge] == pytest.approx(stuck[edge], abs=3e-5)


def test_file_without_friction_shows_the_object_at_its_new_pose():
    """Against the sensor pressed where the motion has brought it, on the stored surface."""
    file = ObjectFile.load(sample_path(available_samples()[0]))
    points = file.sample_surface(3, seed=3)
    shear, twist = np.array([4e-4, 2e-4]), 0.05
    plain = file.press(points, depth=5e-4)
    found = file.press(points, depth=5e-4, shear=shear, twist=twist, friction=0.0)
    sense = file._parts.touch
    closest = sense._surface.snap(points, 0.02, 0.25)
    normals = sense.net.normals(closest)
    frames = sensor_frames(normals, np.zeros(3))
    cos, sin = np.cos(twist), np.sin(twist)
    back = np.array([cos * shear[0] + sin * shear[1], cos * shear[1] - sin * shear[0]])
    moved = closest + back[0] * frames[:, :, 1] - back[1] * frames[:, :, 2]
    expected = next(sense.net.touches(moved, normals, np.full(3, -twist), np.full(3, 5e-4)))
    error, unmoved = (
        np.sqrt(np.mean((of.displacement - expected.displacement) ** 2)) for of in (found, plain)
    )
    assert error < 0.3 * unmoved
    difference, change = (np.mean((of.images.astype(float) - expected.images) ** 2) for of in (found, plain))
    assert difference < 0.5 * change
    assert (found.mask == expected.mask).mean() > 0.99 > (plain.mask == expected.mask).mean()
    assert np.array_equal(found.force, plain.force)
