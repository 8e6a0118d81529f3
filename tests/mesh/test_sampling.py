import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from solids import box, sphere

from objectfolder.mesh.sampling import sample_surface, split_rows


def test_points_lie_on_the_surface_and_are_uniform_by_area(rng):
    sides = np.array([1.0, 0.5, 0.2])
    points = sample_surface(*box(sides), 20000, rng)
    on = np.isclose(np.abs(points), sides / 2, atol=1e-12)
    assert on.any(1).all()
    area = np.array([0.1, 0.2, 0.5])
    np.testing.assert_allclose(on.mean(0), area / area.sum(), atol=0.015)  # 4 sigma
    top = points[on[:, 2], :2]
    np.testing.assert_allclose(top.mean(0), 0, atol=0.015)
    np.testing.assert_allclose(top.var(0), sides[:2] ** 2 / 12, rtol=0.05)


def test_uneven_triangles_do_not_attract_points(rng):
    vertices, faces = sphere(1.0, 2)
    coarse = faces[vertices[faces].mean(1)[:, 2] < 0]
    fine = np.concatenate([coarse, faces[vertices[faces].mean(1)[:, 2] >= 0]])
    points = sample_surface(vertices, fine, 20000, rng)
    assert (points[:, 2] > 0).mean() == pytest.approx(0.5, abs=0.015)


@given(st.integers(0, 500), st.integers(0, 2**31))
def test_split_sizes(count, seed):
    split = split_rows(count, np.random.default_rng(seed))
    assert np.bincount(split, minlength=3)[1:].tolist() == [round(0.1 * count)] * 2
    assert len(split) == count
