from dataclasses import replace

import numpy as np
import pytest
from brick import felt_by
from solids import box

from objectfolder.sim import fingers
from objectfolder.sim.body import turn_poses
from objectfolder.sim.fingers import Presses, pad_presses, press_depths, tactile_images
from objectfolder.touch.contact import sensor_frames


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_angles_reproduce_the_orientation_of_the_sensor(rng):
    """The conventions of `ObjectFile.touch` turn angle, tilt and azimuth back into the same sensor."""
    normals, outward = unit(rng.normal(size=(50, 3))), unit(rng.normal(size=(50, 3)))
    up = unit(np.cross(outward, rng.normal(size=(50, 3))))
    angle, tilt, azimuth = fingers.sensor_angles(normals, outward, up)
    frames = sensor_frames(normals, angle)
    lean = np.cos(azimuth)[:, None] * frames[:, :, 2] - np.sin(azimuth)[:, None] * frames[:, :, 1]
    assert np.cos(tilt)[:, None] * normals + np.sin(tilt)[:, None] * lean == pytest.approx(outward, abs=1e-9)
    assert sensor_frames(outward, angle)[:, :, 2] == pytest.approx(up, abs=1e-9)


def test_contacts_in_the_frame_of_the_object():
    place = turn_poses(np.array([[0.0, 0, 0.05, 1, 0, 0, 0]]), [np.pi / 2], np.array([[0.3, 0.0]]))
    hand = np.array([[0.3, 0.0, 0.05, np.pi / 2]])
    # Jaws close along the world's y, which is the object's x.
    pressed = pad_presses(place, hand, np.array([[[0.3, 0.02, 0.05], [0.3, -0.02, 0.06]]]))
    assert pressed.points == pytest.approx(np.array([[0.02, 0, 0], [-0.02, 0, 0.01]]), abs=1e-12)
    assert pressed.outward == pytest.approx(np.array([[1, 0, 0], [-1, 0, 0]]), abs=1e-12)
    assert pressed.up == pytest.approx(np.array([[0, 0, 1], [0, 0, 1]]), abs=1e-12)


@pytest.fixture(scope="module")
def on_faces(brick):
    """Both fingers on the middles of the faces at y = +-3 cm."""
    hand = np.array([[0, 0, 0, np.pi / 2]])
    contacts = np.array([[[0, 0.03, 0], [0, -0.03, 0]]])
    return pad_presses(np.array([[0.0, 0, 0, 1, 0, 0, 0]]), hand, contacts)


def test_the_gel_pushes_back_with_the_force_of_the_jaws(brick, on_faces):
    wanted = np.array([5.0, 20.0])
    depths = press_depths(brick, on_faces, wanted)
    assert depths[1] > depths[0]
    for row, (force, depth) in enumerate(zip(wanted, depths)):
        felt = brick.press(on_faces.points[[row]], depth).force[0]
        assert felt == pytest.approx(force, rel=0.15)


def test_depth_is_clipped_to_the_range_of_the_sensor(brick, on_faces):
    deepest = brick.sensor_profile.max_indentation
    assert press_depths(brick, on_faces, np.array([1e6, 1e6])) == pytest.approx([deepest, deepest])


def on_box(profile, background):
    """The brick's exact surface."""
    corners, faces = box((0.1, 0.06, 0.03))
    return fingers.TrueSurface(corners, faces, profile, background)


def test_pads_may_face_away_from_the_surface(brick, on_faces):
    """As those that begin to close inside of an object."""
    away = Presses(on_faces.points, unit(np.array([[0.3, -1.0, 0.1], [-0.2, 1.0, 0.3]])), on_faces.up)
    away = replace(away, up=unit(np.cross(np.cross(away.outward, away.up), away.outward)))
    assert ((away.outward * brick.contact_normals(away.points)).sum(1) < -0.9).all()
    truth = on_box(brick.sensor_profile, brick.sensor_background)
    depths = np.array([0.0012, 0.0008])
    implicit, explicit = tactile_images(brick, away, depths), truth.tactile_images(away, depths)
    assert np.abs(implicit.astype(int) - explicit).mean() < 1
    limits = fingers.MIN_DEPTH, brick.sensor_profile.max_indentation
    found = press_depths(brick, away, np.array([1.0, 10.0]))
    assert ((found >= limits[0] * (1 - 1e-9)) & (found <= limits[1] * (1 + 1e-9))).all()


@pytest.mark.parametrize("sensor", ["digit", "digit_real"])
def test_implicit_and_true_touches_agree(brick, on_faces, sensor):
    """The brick's surface is flat, so that the stored distances hold it exactly."""
    brick = felt_by(brick, sensor)
    truth = on_box(brick.sensor_profile, brick.sensor_background)
    depths = np.array([0.0012, 0.0008])
    implicit, explicit = tactile_images(brick, on_faces, depths), truth.tactile_images(on_faces, depths)
    assert implicit.shape == (2, *brick.sensor_background.shape)
    assert np.abs(implicit.astype(int) - explicit).mean() < 1
    untouched = brick.press(on_faces.points, 0.0).images
    assert np.abs(implicit.astype(int) - untouched).mean() > 2
