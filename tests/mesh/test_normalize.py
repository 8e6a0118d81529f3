import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from solids import box, join, sphere

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.textured import TexturedMesh


@settings(max_examples=15, deadline=None)
@given(st.floats(1e-3, 1e4), st.lists(st.floats(-100, 100), min_size=3, max_size=3))
def test_the_object_fills_the_unit_frame_and_the_transform_leads_back(size, centre):
    vertices, faces = box((0.4 * size, size, 0.2 * size), centre)
    done = normalize(TexturedMesh(vertices, faces))
    lower, upper = done.visual.bounds
    tolerance = 1e-12 * (1 + np.abs(vertices).max() / size)
    np.testing.assert_allclose(lower, -upper, atol=tolerance)
    np.testing.assert_allclose(upper - lower, [0.4, 1, 0.2], atol=tolerance)
    np.testing.assert_allclose(
        done.visual.vertices * done.source_size + done.source_centre,
        vertices,
        atol=1e-12 * np.abs(vertices).max(),
    )
    assert done.surface.volume == pytest.approx(0.08, rel=1e-6)


def bracket(flange, width=0.4):
    """A sheet bent like a Z, whose ends point up at one side and down at the other; y and x upwards."""
    x, z = np.array([(-0.5, flange), (-0.5, 0), (0.5, 0), (0.5, -flange)]).T
    vertices = np.concatenate([np.stack([x, np.full(4, y), z], 1) for y in (-width / 2, width / 2)])
    strips = [[[i, i + 4, i + 1], [i + 1, i + 4, i + 5]] for i in range(3)]
    return vertices, np.concatenate(strips)


@pytest.mark.parametrize("flange", [0.04, 0.3])
def test_walls_beyond_the_box_of_the_mesh_are_in_that_of_the_object(flange):
    done = normalize(TexturedMesh(*bracket(flange)), wall=0.01)
    lower, upper = done.surface.vertices.min(0), done.surface.vertices.max(0)
    np.testing.assert_allclose(lower, -upper, atol=1e-4)
    assert (upper - lower).max() == pytest.approx(1, abs=1e-4)
    assert done.source_size == pytest.approx(1.01, abs=1e-3)
    area = 0.4 * (1 + 2 * flange) / done.source_size**2
    assert done.surface.volume == pytest.approx(0.01 * area, rel=0.05)


def test_report_is_in_metres():
    done = normalize(TexturedMesh(*box((2, 4, 1))))
    report = done.report(0.1, "y")
    assert report["volume_m3"] == pytest.approx(8 * (0.1 / 4) ** 3)
    assert report["scale_m"] == 0.1
    assert report["solid"]["volume"] == pytest.approx(0.5 * 1 * 0.25)
    assert report["solid"]["inertia"] == pytest.approx(
        [0.125 / 12 * s for s in (1 + 0.25**2, 0.5**2 + 0.25**2, 1 + 0.5**2, 0, 0, 0)]
    )
    assert report["source_up"] == "y"
    assert report["source_size"] == 4


def test_vertices_that_no_face_uses_do_not_count():
    vertices, faces = box((1, 1, 1))
    done = normalize(TexturedMesh(np.concatenate([vertices, [[50.0, 50, 50]]]), faces))
    assert done.source_size == 1


TRIANGLE = (np.array([[0, 0, 0], [5e-5, 0, 0], [0, 5e-5, 0]]), np.array([[0, 1, 2]]))


@pytest.mark.parametrize(
    ("stray", "share"), [(TRIANGLE, "21.0%"), (box((2e-3,) * 3), "20.9%")], ids=["triangle", "speck"]
)
def test_a_dropped_piece_that_set_the_size_is_refused_with_its_place(stray, share):
    ball = sphere(0.05, 3)
    volume = normalize(TexturedMesh(*join(ball, (stray[0] + [0, 0.02, 0.05], stray[1])))).surface.volume
    assert volume == pytest.approx(0.52, rel=0.05)  # it set nothing, so it goes without a word
    place = r"at \(\S+, \S+, 0\.42\d*\) of the mesh"
    with pytest.raises(ObjectFolderError, match=rf"^jar: .*{place}.* has {share} of the mesh's size"):
        normalize(TexturedMesh(*join(ball, (stray[0] + [0, 0.02, 0.427], stray[1]))), "jar")
