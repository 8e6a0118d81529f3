import numpy as np
import pytest
from solids import box, join, sphere

from objectfolder.mesh.closing.wedges import separate_wedges
from objectfolder.mesh.closing.weld import weld
from objectfolder.mesh.topology import connected_pieces, edge_defects, is_closed, signed_volume


def test_an_intact_mesh_keeps_its_vertices_and_faces():
    vertices, faces = sphere(0.5, 3)
    again, same = separate_wedges(vertices, faces)
    np.testing.assert_array_equal(again, vertices)
    np.testing.assert_array_equal(same, faces)


@pytest.mark.parametrize(
    ("place", "crowded"), [((0.2, 0.2, 0), 1), ((0.2, 0.2, 0.4), 0)], ids=["edge", "vertex"]
)
def test_boxes_that_touch_in_an_edge_or_a_vertex_are_separated(place, crowded):
    touching = weld(*join(box((0.4, 0.4, 0.4), (-0.2, -0.2, 0)), box((0.4, 0.4, 0.4), place)), 1e-9)
    assert edge_defects(touching[1]) == (0, crowded, 0)
    assert len(connected_pieces(*touching)) == 1
    apart = connected_pieces(*separate_wedges(*touching))
    assert [signed_volume(*piece) for piece in apart] == pytest.approx([0.064, 0.064])
    assert all(is_closed(faces) for _, faces in apart)


def test_hollows_that_touch_in_an_edge_are_kept_with_their_walls():
    # Around the common edge of two hollows lie two wedges of material, not two of air.
    outer = box((1, 1, 1))
    hollows = [(v, f[:, ::-1]) for v, f in (box((0.3,) * 3, (x, x, 0)) for x in (-0.15, 0.15))]
    _, faces = separate_wedges(*weld(*join(outer, *hollows), 1e-9))
    assert is_closed(faces)
    assert signed_volume(*weld(*join(outer, *hollows), 1e-9)) == pytest.approx(1 - 2 * 0.027)
