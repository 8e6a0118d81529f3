import numpy as np
from solids import sphere

from objectfolder.mesh.topology import boundary_loops, face_components


def test_pieces_that_share_a_vertex_are_one_component():
    faces = np.array([[0, 1, 2], [2, 3, 4], [5, 6, 7]])
    labels = face_components(faces, 8)
    assert labels[0] == labels[1] != labels[2]


def test_boundary_loops_follow_the_faces():
    vertices, faces = sphere(0.5, 2)
    height = vertices[faces][:, :, 2]
    loops = boundary_loops(faces[(height.max(1) < 0.3) & (height.min(1) > -0.3)])
    assert len(loops) == 2
    for loop in loops:
        points = vertices[loop]
        area = np.cross(points, np.roll(points, -1, 0)).sum(0)
        # Outward faces lie to the left of a boundary: seen from above, the upper one runs clockwise.
        assert area[2] * points[:, 2].mean() < 0
