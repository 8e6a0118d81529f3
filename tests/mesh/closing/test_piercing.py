import pytest
from solids import TURN, box, join, sphere

from objectfolder.mesh.closing.piercing import self_intersections
from objectfolder.mesh.closing.solids import unite


@pytest.mark.parametrize("turn", [None, TURN], ids=["aligned", "turned"])
def test_edges_that_pierce_are_counted(turn):
    """A post through a slab: four edges and four diagonals of its sides pierce both faces of the slab."""
    slab, post = box((0.8, 0.7, 0.1)), box((0.1, 0.12, 0.6), (0.25, 0.02, 0.05))
    vertices, faces = join(slab, post)
    vertices = vertices if turn is None else vertices @ turn.T
    assert self_intersections(vertices, faces) == 8
    (vertices, faces), _ = unite([slab, post])
    assert self_intersections(vertices if turn is None else vertices @ turn.T, faces) == 0


def test_what_touches_or_bends_does_not_pierce():
    assert self_intersections(*sphere(0.4, 5)) == 0
    assert self_intersections(*join(box((0.4,) * 3), box((0.4,) * 3, (0.4, 0.1, 0)))) == 0


def test_balls_are_pierced_along_the_circle_where_they_meet():
    """Every edge that crosses the circle; their number grows as the edges get shorter."""
    counts = [self_intersections(*join(sphere(0.3, n), sphere(0.3, n, (0.2, 0.11, 0.05)))) for n in (2, 3, 4)]
    assert counts[0] > 20
    assert 1.7 < counts[1] / counts[0] < 2.3
    assert 1.7 < counts[2] / counts[1] < 2.3
