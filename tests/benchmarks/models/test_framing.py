import numpy as np
import pytest

from objectfolder.benchmarks.models.framing import SHARE, frame_cutout, frame_views

SIDE = 64
SMALL = (50, 50, 60, 60)  # left, top, right, bottom
BOXES = ((10, 20, 40, 35), (0, 0, 7, 60), SMALL, (0, 0, 64, 64))


def rectangle(box, colour=(200, 30, 30), side=SIDE):
    """One on white; (side, side, 3) uint8."""
    view = np.full((side, side, 3), 255, np.uint8)
    left, top, right, bottom = box
    view[top:bottom, left:right] = colour
    return view


def cut(box, side=SIDE):
    """The same, cut out: linear, premultiplied."""
    rgba = np.zeros((side, side, 4), np.float32)
    left, top, right, bottom = box
    rgba[top:bottom, left:right] = (0.5, 0.01, 0.01, 1)
    return rgba


def check(view, box, half):
    """It is in the middle, and its longer side fills the share of the frame."""
    left, top, right, bottom = box
    longest = max(right - left, bottom - top)
    dark = view[..., 1] < half
    for axis, length in ((0, right - left), (1, bottom - top)):
        found = np.flatnonzero(dark.any(axis))
        assert len(found) == pytest.approx(length / longest * SHARE * SIDE, abs=2)
        assert found.mean() == pytest.approx(SIDE / 2 - 0.5, abs=1)
    assert (view[[0, -1]] == 255).all()
    assert (view[:, [0, -1]] == 255).all()


def test_views_show_everything_in_the_middle_and_as_large():
    framed_ = frame_views(np.stack([rectangle(box) for box in BOXES]))
    assert (framed_.dtype, framed_.shape) == (np.uint8, (len(BOXES), SIDE, SIDE, 3))
    for view, box in zip(framed_, BOXES):
        check(view, box, 142)  # the mean of 30 and 255
        assert view[32, 32].tolist() == [200, 30, 30]  # its colour stays


def test_a_view_does_not_depend_on_the_others_and_one_of_nothing_stays_white():
    views = np.stack([rectangle(BOXES[0]), np.full((SIDE, SIDE, 3), 255, np.uint8)])
    first, nothing = frame_views(views)
    np.testing.assert_array_equal(first, frame_views(views[:1])[0])
    assert (nothing == 255).all()


def test_what_is_framed_already_stays_where_it_is():
    once = frame_views(np.stack([rectangle(box) for box in BOXES if box != SMALL]))  # its edges blur
    assert np.abs(frame_views(once).astype(int) - once).mean() < 4


def test_cut_out_objects_are_framed_as_views_are():
    for box in BOXES:
        view = frame_cutout(cut(box), SIDE)
        check(view, box, 188)  # as light as half the white
        onto_white = rectangle(box, view[32, 32])
        assert np.abs(frame_views(onto_white[None])[0].astype(int) - view).mean() < 7


def test_framing_takes_no_notice_of_size_and_place():
    small = frame_cutout(cut((10, 20, 40, 35)), SIDE)
    np.testing.assert_array_equal(frame_cutout(cut((30, 40, 60, 55)), SIDE), small)
    assert np.abs(frame_cutout(cut((20, 40, 80, 70), 128), SIDE).astype(int) - small).mean() < 3
