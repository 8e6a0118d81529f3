"""Where the ground truth of touch presses: random points, or the vertices and normals of the mesh."""

import dataclasses

import numpy as np
import pytest
from solids import sphere

from objectfolder.touch.profiles import load_profile
from objectfolder.touch.settings import RenderTouchConfig
from objectfolder.touch.truth import draw_contacts, render_contacts

BALL = sphere(0.4, 4)
ALL = dict.fromkeys(("train", "val", "test"))
VERTICES = RenderTouchConfig(
    locations="vertices", normals="vertex", renderer="tacto", depth=1e-3, angle=0.0, **ALL
)


def places(config):
    return draw_contacts(*BALL, config, np.random.default_rng(0))


def test_every_vertex_is_touched_once_in_one_split_along_its_normal():
    splits = places(VERTICES)
    count, tenth = len(BALL[0]), round(len(BALL[0]) / 10)
    assert [len(points) for points, _ in splits] == [count - 2 * tenth, tenth, tenth]
    touched = np.concatenate([points for points, _ in splits])
    assert len(np.unique(touched, axis=0)) == count
    for points, normals in splits:  # of a ball, radial
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
        assert (np.sum(normals * points, 1) / 0.4 > 0.999).all()


def test_counts_of_vertices_are_limits_and_their_points_are_among_all():
    whole, some = places(VERTICES)[2][0], places(dataclasses.replace(VERTICES, test=7))[2][0]
    assert len(some) == 7
    assert len({tuple(p) for p in some} - {tuple(p) for p in whole}) == 0
    assert len(places(dataclasses.replace(VERTICES, test=10**6))[2][0]) == len(whole)


def test_random_points_have_counts_and_no_vertex_normals():
    surface = dataclasses.replace(VERTICES, locations="surface", normals="contact", train=5, val=3, test=4)
    assert [(len(points), normals) for points, normals in places(surface)] == [(n, None) for n in (5, 3, 4)]
    with pytest.raises(ValueError, match=r"val is null, expected a number"):
        dataclasses.replace(surface, val=None)
    with pytest.raises(ValueError, match=r"normals is vertex, which needs locations: vertices"):
        dataclasses.replace(surface, normals="vertex")


def test_the_sensor_comes_along_the_normals_that_are_given():
    profile, points = load_profile("tacto_digit"), places(VERTICES)[2][0][:2]
    leaned = points / 0.4 + [0.05, 0, 0.05]
    leaned /= np.linalg.norm(leaned, axis=1, keepdims=True)

    def render(normals):
        rng = np.random.default_rng(1)
        return render_contacts(*BALL, 0.06, points, profile, rng, "tacto", 0.001, 0.0, normals=normals)

    found = render(leaned)
    np.testing.assert_array_equal(found["normals"], leaned)
    assert (found["images"] != render(None)["images"]).any()
