import numpy as np
import pytest

from objectfolder.sim.camera import ExternalCamera, box_hits


def test_rays_hit_a_box_at_the_right_distance_and_side():
    rays = np.array([[1.0, 0, 0], [1, 0.2, 0], [0, 1, 0], [-1, 0, 0], [1, 0.6, 0]])
    distance, normals = box_hits(np.array([-3.0, 0, 0]), rays, np.array([1.0, 0.5, 2.0]))
    assert distance == pytest.approx([2, 2, np.inf, np.inf, np.inf])
    assert normals[0] == pytest.approx([-1, 0, 0])
    from_above, up = box_hits(np.array([0.2, 0.1, 5.0]), np.array([[0.0, 0, -1]]), np.array([1.0, 0.5, 2.0]))
    assert (from_above[0], up[0].tolist()) == (3.0, [0, 0, 1])


def test_the_nearer_surface_hides_the_other(brick):
    """The hand hides the brick behind it, and nothing when it is far above."""
    camera, place = ExternalCamera(48), np.array([0, 0, 0.03, 1.0, 0, 0, 0])
    alone = camera.picture(brick, place, np.array([0, 0, 5.0, 0]), 0.08)
    before = camera.picture(brick, place, np.array([0.06, -0.08, 0.02, 0.9]), 0.08)
    empty = camera.picture(brick, place - [0, 0, 9, 0, 0, 0, 0], np.array([0, 0, 5.0, 0]), 0.08)
    shows_brick = (alone != empty).any(2)
    assert 0.01 < shows_brick.mean() < 0.5
    assert ((before != empty).any(2) & shows_brick).mean() > 0.8 * shows_brick.mean()
    assert (before != alone).any(2)[shows_brick].any()
    assert alone.dtype == np.uint8
