from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import distance_transform_edt
from touch_solids import caster

from objectfolder.touch.optics import Optics
from objectfolder.touch.simulate import press, touch_images


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
    images, found = batch
    size = (9, digit.height, digit.width)
    assert (images.shape, images.dtype) == ((*size, 3), np.uint8)
    for image in (found.height, found.displacement, found.pressure):
        assert (image.shape, image.dtype) == (size, np.float32)
    assert (found.mask.shape, found.mask.dtype) == (size, bool)
    for number in (found.area, found.max_penetration, found.mean_penetration, found.force, found.obstructed):
        assert (number.shape, number.dtype) == ((9,), np.float64)
        assert np.all(number >= 0)
    assert found.obstructed.max() <= 1


@pytest.mark.parametrize("rows", [[4], [8, 0], [1, 2, 3, 5, 6, 7], list(range(9))[::-1], list(range(9)), []])
def test_rows_depend_on_neither_the_batch_nor_the_optics(contacts, batch, digit, rows):
    block, *contact = contacts
    images, found = touch_images(block, *(c[np.array(rows, int)] for c in contact), digit, Optics(digit))
    np.testing.assert_array_equal(images, batch[0][np.array(rows, int)])
    for name, whole in vars(batch[1]).items():
        np.testing.assert_array_equal(getattr(found, name), whole[np.array(rows, int)])


def test_deeper_press_makes_a_larger_contact(ball, digit, optics):
    depths = np.linspace(0.3e-3, 2e-3, 6)
    tops = np.tile([[0, 0, 0.01]], (6, 1))
    images, found = touch_images(ball, tops, tops * 100, np.zeros(6), depths, digit, optics)
    changed = (np.abs(images.astype(int) - optics.background.numpy()).max(axis=3) > 2).sum(axis=(1, 2))
    np.testing.assert_allclose(found.max_penetration, depths, atol=3e-6)
    for grows in (found.area, found.mean_penetration, found.force, changed):
        assert np.all(np.diff(grows) > 0)


def test_image_differs_around_the_contact_only(ball, digit):
    rigid = replace(digit, gel="rigid")
    optics = Optics(rigid)
    top = np.array([[0, 0, 0.01]])
    images, found = touch_images(ball, top, top * 100, 0.0, 1e-3, rigid, optics)
    change = np.abs(images[0].astype(int) - optics.background.numpy()).max(axis=2)
    assert change.max() > 10
    assert change[distance_transform_edt(~found.mask[0]) > 8].max() <= 1


def test_contact_is_measured_in_metres_and_newtons(ball, digit):
    """Against sums over the images, and the area of the circle in which a ball cuts a flat gel."""
    flat = replace(digit, gel_curvature=0.0, gel="rigid")
    tops = np.tile([[0, 0, 0.01]], (2, 1))
    depths = np.array([0.5e-3, 1e-3])
    found = press(ball, tops, tops * 100, 0.0, depths, flat)
    np.testing.assert_allclose(found.area, np.pi * (2 * 0.01 * depths - depths**2), rtol=0.02)
    # Volume of a spherical cap over its area; the camera sees it in perspective.
    mean = depths * (0.03 - depths) / (0.06 - 3 * depths)
    np.testing.assert_allclose(found.mean_penetration, mean, rtol=0.05)
    assert np.isnan(found.force).all()
    assert np.isnan(found.pressure).all()

    soft = press(ball, tops, tops * 100, 0.0, depths, replace(flat, gel="soft"))
    pixel = flat.pixel_pitch**2
    np.testing.assert_allclose(soft.force, soft.pressure.sum(axis=(1, 2)) * pixel, rtol=1e-5)
    np.testing.assert_allclose(soft.area, (soft.pressure > 0).sum(axis=(1, 2)) * pixel, rtol=1e-5)
    stiff = press(ball, tops, tops * 100, 0.0, depths, replace(flat, gel="soft", young_modulus=3e5))
    np.testing.assert_allclose(stiff.force, soft.force * 3e5 / flat.young_modulus, rtol=1e-3)


def test_nothing_under_the_gel_is_no_contact(ball, digit):
    point = np.array([[0, 0, 0.012]])  # 2 mm off the ball
    found = press(ball, point, point / 0.012, 0.0, 1e-3, digit)
    assert not found.mask.any()
    assert not found.displacement.any()
    assert found.force == found.area == found.max_penetration == found.mean_penetration == 0


def test_turning_the_sensor_turns_the_imprint(digit):
    """A rod looks the same after half a turn, upside down; a quarter turn lays it across."""
    rod = caster(trimesh.creation.cylinder(0.004, 0.06, sections=256))
    x = np.array([[1.0, 0, 0]])
    angles = np.array([0, np.pi, np.pi / 2])
    axes = np.repeat(x, 3, 0)
    imprint = press(rod, 0.004 * axes, axes, angles, np.full(3, 1e-3), digit).displacement
    np.testing.assert_allclose(imprint[1], imprint[0, ::-1, ::-1], atol=2e-5)
    square = imprint[:, 20:140]
    np.testing.assert_allclose(np.rot90(square[0], -1)[30:90, 30:90], square[2][30:90, 30:90], atol=3e-5)
