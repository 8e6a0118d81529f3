import numpy as np
from solids import box

from objectfolder.benchmarks.reporting.shape_pictures import SIDE, render_shaded, sheet


def test_a_box_is_drawn_in_the_middle_on_white_brighter_where_it_faces_the_camera():
    picture = render_shaded(*box((0.6, 0.6, 0.6)), side=64)
    drawn = (picture < 250).any(-1)
    rows, columns = np.nonzero(drawn)
    assert 0.15 < drawn.mean() < 0.6
    assert not drawn[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    assert abs(rows.mean() - 31.5) < 4
    assert abs(columns.mean() - 31.5) < 4
    # Of three visible faces, two are mirror images: two shades.
    assert 2 <= len(np.unique(picture[drawn].sum(-1) // 12)) <= 12


def test_a_mesh_without_triangles_is_white():
    assert (render_shaded(np.zeros((0, 3)), np.zeros((0, 3), int)) == 255).all()


def test_sheet_has_a_row_of_each_view():
    views = np.zeros((2, 16, 16, 3), np.uint8)
    page = sheet(views, [[box((1, 1, 1))] * 3] * 2)
    assert page.shape == (2 * SIDE + 12, 4 * SIDE + 20, 3)
    assert (page[4 : 4 + SIDE, 4 : 4 + SIDE] == 0).all()
