import numpy as np
import pytest
import trimesh
from scipy.ndimage import distance_transform_edt
from touch_solids import caster

from objectfolder.touch.optics import Optics
from objectfolder.touch.simulate import touch_images


@pytest.fixture(scope="module")
def contacts():
    """Contacts all over a block with a knob."""
    knob = trimesh.creation.icosphere(4, radius=0.004)
    knob.apply_translation((0.02, 0, 0))
    block = caster(trimesh.creation.box((0.03, 0.03, 0.03)), knob)
    n = np.random.default_rng(0).normal(size=(9, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    points = 0.015 * n / np.abs(n).max(axis=1, keepdims=True)
    return block, points, n, np.linspace(0, 6, 9), np.linspace(0.5e-3, 1.5e-3, 9)


@pytest.fixture(scope="module")
def batch(contacts, digit, optics):
    return touch_images(*contacts, digit, optics)


def test_shapes_and_types(batch, digit):
    images, displacement, obstructed = batch
    assert (images.shape, images.dtype) == ((9, digit.height, digit.width, 3), np.uint8)
    assert (displacement.shape, displacement.dtype) == ((9, digit.height, digit.width), np.float32)
    assert obstructed.shape == (9,)
    assert np.all((obstructed >= 0) & (obstructed <= 1))


@pytest.mark.parametrize("rows", [[4], [8, 0], [1, 2, 3, 5, 6, 7], list(range(9))[::-1]])
def test_rows_do_not_depend_on_the_batch(contacts, batch, digit, optics, rows):
    block, *contact = contacts
    part = touch_images(block, *(c[rows] for c in contact), digit, optics)
    for whole, found in zip(batch, part):
        np.testing.assert_array_equal(found, whole[rows])


def test_repeats_to_the_bit(contacts, batch, digit):
    for first, second in zip(batch, touch_images(*contacts, digit, Optics(digit))):
        np.testing.assert_array_equal(first, second)


def test_no_contacts_give_no_images(contacts, digit, optics):
    block, *contact = contacts
    images, _, obstructed = touch_images(block, *(c[:0] for c in contact), digit, optics)
    assert images.shape == (0, digit.height, digit.width, 3)
    assert obstructed.shape == (0,)


def test_deeper_press_makes_a_larger_contact(ball, digit, optics):
    depths = np.linspace(0.3e-3, 2e-3, 6)
    tops = np.tile([[0, 0, 0.01]], (6, 1))
    images, displacement, _ = touch_images(ball, tops, tops * 100, np.zeros(6), depths, digit, optics)
    area = (displacement > 1e-4).sum(axis=(1, 2))
    changed = (np.abs(images.astype(int) - optics.background.numpy()).max(axis=3) > 2).sum(axis=(1, 2))
    assert np.all(np.diff(area) > 0)
    assert np.all(np.diff(changed) > 0)


def test_image_differs_around_the_contact_only(ball, digit, optics):
    top = np.array([[0, 0, 0.01]])
    images, displacement, _ = touch_images(ball, top, top * 100, 0.0, 1e-3, digit, optics)
    change = np.abs(images[0].astype(int) - optics.background.numpy()).max(axis=2)
    assert change.max() > 10
    assert change[distance_transform_edt(displacement[0] < 1e-6) > 8].max() <= 1


def test_turning_the_sensor_turns_the_imprint(digit, optics):
    """A rod looks the same after half a turn, upside down; a quarter turn lays it across."""
    rod = caster(trimesh.creation.cylinder(0.004, 0.06, sections=256))
    x = np.array([[1.0, 0, 0]])
    angles = np.array([0, np.pi, np.pi / 2])
    _, imprint, _ = touch_images(
        rod, np.repeat(0.004 * x, 3, 0), np.repeat(x, 3, 0), angles, np.full(3, 1e-3), digit, optics
    )
    np.testing.assert_allclose(imprint[1], imprint[0, ::-1, ::-1], atol=2e-5)
    square = imprint[:, 20:140]
    np.testing.assert_allclose(np.rot90(square[0], -1)[30:90, 30:90], square[2][30:90, 30:90], atol=3e-5)
