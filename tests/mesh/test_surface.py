import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from solids import TURN, box, flipped, join, sphere

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.surface import (
    close_surface,
    face_components,
    is_closed,
    read_surface,
    signed_volume,
    write_surface,
)


def remeshed(surface):
    return any("remeshed" in step for step in surface.steps)


def test_a_closed_mesh_is_kept_as_it_is():
    vertices, faces = box((1, 0.5, 0.3), turn=TURN)
    surface = close_surface(vertices, faces)
    assert surface.deviation_max == 0
    assert len(surface.vertices) == 8
    assert len(surface.faces) == 12
    assert surface.volume == pytest.approx(0.15)
    assert surface.components == 1


def test_a_flipped_mesh_is_turned_outward():
    surface = close_surface(*flipped(sphere(0.5, 2)))
    assert surface.volume == pytest.approx(signed_volume(*sphere(0.5, 2)))
    assert surface.deviation_max == 0


def soup(solid):
    """Every face with vertices of its own, as at texture seams."""
    vertices, faces = solid
    return vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


def test_vertices_split_at_seams_are_welded():
    surface = close_surface(*soup(sphere(0.5, 3)))
    assert len(surface.vertices) == 642
    assert is_closed(surface.faces)
    assert surface.deviation_max == 0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_a_soup_of_randomly_oriented_faces_becomes_the_solid(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = soup(box(rng.uniform(0.2, 1, 3), turn=Rotation.random(random_state=seed).as_matrix()))
    volume = signed_volume(vertices, faces)
    turned = np.where(rng.random((len(faces), 1)) < 0.5, faces[:, ::-1], faces)
    surface = close_surface(vertices, rng.permutation(turned))
    assert surface.volume == pytest.approx(volume)
    assert surface.deviation_max < 1e-12


def test_seams_that_are_slightly_open_are_welded_with_the_least_tolerance(rng):
    vertices, faces = soup(sphere(0.5, 2))
    surface = close_surface(vertices + rng.uniform(-1, 1, vertices.shape) * 2e-6, faces)
    assert is_closed(surface.faces)
    assert surface.weld_tolerance == 1e-5
    assert len(surface.vertices) == 162
    assert surface.volume == pytest.approx(signed_volume(*sphere(0.5, 2)), rel=1e-4)


def test_faces_given_twice_are_kept_once_and_opposite_copies_cancel():
    vertices, faces = sphere(0.5, 2)
    twice = close_surface(vertices, np.concatenate([faces, faces[5:30]]))
    assert len(twice.faces) == len(faces)
    # A sheet inside, seen from both sides, encloses nothing.
    sheet = np.array([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0, 0.2, 0]])
    both = join((vertices, faces), (sheet, np.array([[0, 1, 2], [0, 2, 1]])))
    assert close_surface(*both).volume == pytest.approx(twice.volume)
    with pytest.raises(ObjectFolderError, match="cancelled"):
        close_surface(vertices, np.concatenate([faces, faces[:, ::-1]]))


def test_degenerate_faces_are_dropped():
    vertices, faces = box((1, 1, 1))
    surface = close_surface(vertices, np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]]))
    assert len(surface.faces) == 12


@pytest.mark.parametrize("turn", [False, True])
def test_a_hole_is_capped(turn):
    vertices, faces = sphere(0.5, 5)
    height = vertices[faces][:, :, 2].max(1)
    open_faces = faces[height < 0.3]
    solid = (vertices, open_faces)
    surface = close_surface(*(flipped(solid) if turn else solid))
    assert not remeshed(surface)
    assert any(step.startswith("cap") for step in surface.steps)
    top = vertices[np.unique(open_faces)][:, 2].max()
    cap = np.pi * (0.5 - top) ** 2 * (1.5 - 0.5 + top) / 3
    assert surface.volume == pytest.approx(4 / 3 * np.pi * 0.125 - cap, rel=0.03)
    assert surface.vertices[:, 2].max() <= top + 1e-12
    assert 0 < surface.deviation_max < 0.5


def test_an_open_tube_gets_two_caps():
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.stack([0.3 * np.cos(angle), 0.3 * np.sin(angle)], 1)
    vertices = np.concatenate([np.column_stack([ring, np.full(40, z)]) for z in (-0.5, 0.5)])
    i, j = np.arange(40), np.roll(np.arange(40), -1)
    faces = np.concatenate([np.stack([i, j, j + 40], 1), np.stack([i, j + 40, i + 40], 1)])
    surface = close_surface(vertices, faces)
    assert surface.volume == pytest.approx(20 * 0.09 * np.sin(2 * np.pi / 40))
    assert not remeshed(surface)


def test_overlapping_boxes_are_united():
    a, b = box((0.6, 0.4, 0.4), (-0.2, 0, 0)), box((0.6, 0.2, 0.2), (0.2, 0.013, 0.017))
    surface = close_surface(*join(a, b))
    overlap = 0.2 * 0.2 * 0.2
    assert surface.volume == pytest.approx(0.096 + 0.024 - overlap)
    assert surface.components == 1
    assert surface.deviation_max < 1e-9


@pytest.mark.parametrize("turned", [(0,), (1,), (0, 1)])
def test_overlapping_pieces_are_united_however_they_are_oriented(turned):
    pieces = [box((0.6, 0.4, 0.4), (-0.2, 0, 0)), box((0.6, 0.2, 0.2), (0.25, 0.013, 0.017))]
    mixed = [flipped(p) if i in turned else p for i, p in enumerate(pieces)]
    assert close_surface(*join(*mixed)).volume == pytest.approx(0.096 + 0.024 - 0.15 * 0.04)


def test_a_cavity_is_subtracted():
    outer, inner = sphere(0.5, 3), sphere(0.3, 3, (0.1, 0, 0))
    surface = close_surface(*join(outer, flipped(inner)))
    assert surface.volume == pytest.approx(signed_volume(*outer) - signed_volume(*inner))
    assert is_closed(surface.faces)
    assert surface.components == 2
    assert surface.deviation_max < 1e-9


def test_a_mesh_that_is_inside_out_keeps_its_cavity():
    outer, inner = sphere(0.5, 3), sphere(0.3, 3, (0.1, 0, 0))
    surface = close_surface(*join(flipped(outer), inner))
    assert surface.volume == pytest.approx(signed_volume(*outer) - signed_volume(*inner))


def test_two_cavities_and_a_separate_solid():
    outer, separate = box((0.6, 0.3, 0.3), (-0.2, 0, 0)), box((0.2, 0.2, 0.2), (0.4, 0, 0))
    cavities = [box((0.1, 0.1, 0.1), (x, 0, 0)) for x in (-0.35, -0.05)]
    surface = close_surface(*join(outer, *map(flipped, cavities), separate))
    assert surface.volume == pytest.approx(0.054 - 0.002 + 0.008)
    assert surface.components == 4


def test_a_solid_inside_another_vanishes():
    assert close_surface(*join(box((1, 1, 1)), box((0.2, 0.2, 0.2)))).volume == pytest.approx(1)


def test_specks_are_dropped():
    surface = close_surface(*join(box((0.8, 0.8, 0.8)), box((0.01, 0.01, 0.01), (0.45, 0, 0))))
    assert surface.volume == pytest.approx(0.512)
    assert surface.components == 1


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        (np.eye(3), [[0, 1, 2]]),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]),
        ([[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], [[0, 1, 2]]),
        (np.zeros((3, 3)), [[0, 1, 2]]),
    ],
    ids=["triangle", "square", "line", "point"],
)
def test_what_encloses_nothing_is_refused_by_name(monkeypatch, vertices, faces):
    monkeypatch.setattr("objectfolder.mesh.surface.GRID_RESOLUTION", 24)
    with pytest.raises(ObjectFolderError, match=r"^lamp: .*expected a mesh"):
        close_surface(np.asarray(vertices, float), np.asarray(faces), "lamp")


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31))
def test_garbage_is_refused_or_becomes_a_closed_outward_surface(seed):
    rng = np.random.default_rng(seed)
    vertices = rng.uniform(-0.5, 0.5, (6, 3))
    faces = np.stack([rng.permutation(6)[:3] for _ in range(8)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("objectfolder.mesh.surface.GRID_RESOLUTION", 24)
        try:
            surface = close_surface(vertices, faces)
        except ObjectFolderError:
            return
    assert is_closed(surface.faces)
    assert surface.volume > 0


def test_pieces_that_share_a_vertex_are_one_component():
    faces = np.array([[0, 1, 2], [2, 3, 4], [5, 6, 7]])
    labels = face_components(faces, 8)
    assert labels[0] == labels[1] != labels[2]


def test_a_written_surface_is_read_back(tmp_path):
    surface = close_surface(*sphere(0.5, 2))
    path = tmp_path / "surface.ply"
    write_surface(path, surface)
    vertices, faces = read_surface(path)
    np.testing.assert_array_equal(faces, surface.faces)
    np.testing.assert_allclose(vertices, surface.vertices, atol=1e-7)
    first = path.read_bytes()
    write_surface(path, surface)
    assert path.read_bytes() == first


@pytest.mark.parametrize("content", [b"", b"ply garbage", b"\x00\xff" * 50])
def test_a_damaged_surface_file_is_named(tmp_path, content):
    path = tmp_path / "surface.ply"
    with pytest.raises(ObjectFolderError, match=r"surface\.ply does not exist"):
        read_surface(path)
    path.write_bytes(content)
    with pytest.raises(ObjectFolderError, match=r"surface\.ply is damaged"):
        read_surface(path)
