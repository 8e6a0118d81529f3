import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from scipy.spatial.transform import Rotation
from solids import TURN, box, flipped, join, pretzel, sphere

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.closing.solids import to_manifold
from objectfolder.mesh.closing.surface import BRIDGED_GAP, _Repair, close_surface
from objectfolder.mesh.closing.weld import clean
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.ply import read_surface, write_surface
from objectfolder.mesh.reading.load import default_up, load_mesh
from objectfolder.mesh.topology import is_closed, signed_volume
from objectfolder.shapes import generate

OBJECTS = Path(__file__).parents[4] / "shared" / "objects"
QUICK = ("gso_salad_plate", "polyhaven_wooden_table", "ycb_bowl", "ycb_skillet_lid")
SEEDS = st.integers(0, 2**31)


@pytest.fixture(scope="module")
def mug():
    """A real shape, 18,000 faces, in the unit frame."""
    mesh = generate("mug", texture_size=64)
    lower, upper = mesh.bounds
    return clean((mesh.vertices - (lower + upper) / 2) / (upper - lower).max(), mesh.faces)[0]


def remeshed(surface):
    return surface.last_step == "grid"


def test_a_closed_mesh_is_kept_as_it_is():
    vertices, faces = box((1, 0.5, 0.3), turn=TURN)
    surface = close_surface(vertices, faces)
    assert surface.last_step == "keep"
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


@settings(max_examples=5, deadline=None)
@given(SEEDS)
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


def two_sided(mesh):
    vertices, faces = mesh
    return vertices, np.concatenate([faces, faces[:, ::-1]])


@pytest.mark.parametrize("solid", [box((1, 0.5, 0.3), turn=TURN), sphere(0.5, 2)], ids=["box", "sphere"])
def test_a_mesh_that_is_two_sided_throughout_is_its_first_copy(solid):
    surface = close_surface(*two_sided(solid))
    np.testing.assert_array_equal(surface.mesh[1], close_surface(*solid).mesh[1])
    assert surface.volume == pytest.approx(signed_volume(*solid))
    assert surface.deviation_max == 0
    assert surface.warnings == []


def test_a_two_sided_sheet_gets_a_wall_like_a_one_sided_one():
    vertices, faces = sphere(0.5, 4)
    bowl = (vertices, faces[vertices[faces].mean(1)[:, 2] < 0])
    one, both = close_surface(*bowl, wall=0.05), close_surface(*two_sided(bowl), wall=0.05)
    assert both.last_step == "thicken"
    assert both.volume == pytest.approx(one.volume)
    assert both.warnings == []


def test_a_two_sided_part_of_a_solid_stays_and_one_inside_vanishes():
    base, arm = box((0.6, 0.6, 0.1)), box((0.1, 0.1, 0.4), (0.1, 0.13, 0.24))
    hidden = box((0.1, 0.1, 0.05), (-0.2, 0, 0))
    alike = close_surface(*join(base, arm))
    for parts in ((base, two_sided(arm)), (flipped(base), two_sided(arm), two_sided(hidden))):
        surface = close_surface(*join(*parts))
        assert surface.volume == pytest.approx(alike.volume)
        assert surface.deviation_max < 1e-9
        assert surface.warnings == []


def test_a_two_sided_fin_on_an_edge_of_a_solid_is_noted():
    vertices, faces = box((0.6, 0.6, 0.1))
    edge = np.flatnonzero((vertices[:, 0] > 0) & (vertices[:, 2] > 0))
    fin = np.array([[*edge, 8], [edge[1], 9, 8]])
    vertices = np.concatenate([vertices, vertices[edge] + [0, 0, 0.3]])
    surface = close_surface(vertices, np.concatenate([faces, fin, fin[:, ::-1]]))
    assert surface.volume == pytest.approx(0.036)
    assert surface.deviation_max == pytest.approx(0.3, rel=0.02)
    assert surface.repairs[-1].name == "clean"
    (warning,) = surface.warnings
    assert re.match(r"faces up to (29|30)\.\d\d% of the size from .* delete the copies in the mesh", warning)


def test_degenerate_faces_are_dropped():
    vertices, faces = box((1, 1, 1))
    surface = close_surface(vertices, np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]]))
    assert len(surface.faces) == 12


@pytest.mark.parametrize("turn", [False, True])
def test_a_hole_is_capped(turn):
    vertices, faces = sphere(0.5, 5)
    open_faces = faces[vertices[faces][:, :, 2].max(1) < 0.485]
    solid = (vertices, open_faces)
    surface = close_surface(*(flipped(solid) if turn else solid))
    assert surface.last_step == "cap"
    top = vertices[np.unique(open_faces)][:, 2].max()
    cap = np.pi * (0.5 - top) ** 2 * (1.5 - 0.5 + top) / 3
    assert surface.volume == pytest.approx(4 / 3 * np.pi * 0.125 - cap, rel=0.01)
    assert surface.vertices[:, 2].max() <= top + 1e-12
    assert surface.deviation_max == pytest.approx(np.sqrt(0.25 - top**2), rel=0.1)  # the rim
    assert surface.warnings == []


def test_a_visible_sheet_gets_the_wall_that_is_asked_for_else_two_percent_and_a_warning():
    vertices, faces = sphere(0.5, 5)
    bowl = (vertices, faces[vertices[faces].mean(1)[:, 2] < 0])
    asked, default = close_surface(*bowl, wall=0.05), close_surface(*bowl)
    for surface, wall in ((asked, 0.05), (default, 0.02)):
        assert surface.last_step == "thicken"
        assert surface.volume == pytest.approx(2 / 3 * np.pi * (0.125 - (0.5 - wall) ** 3), rel=0.01)
        assert surface.deviation_max == pytest.approx(wall, rel=0.02)
    assert asked.warnings == []
    assert default.warnings[0].endswith(
        "; set `wall` in metres, or close the hole in the mesh, if it is solid"
    )
    (warning,) = close_surface(*bowl, scale=0.3).warnings
    assert warning.startswith("1 open sheet got a wall of 2% of the size (0.006 m); set")


def bottle(mouth):
    """A sheet around a body with a mouth on top, in the unit frame."""
    radii, heights = np.array([(0.17, 0), (0.17, 0.6), (mouth, 0.8), (mouth, 1)]).T
    turn = np.arange(48) * 2 * np.pi / 48
    rings = np.stack([np.outer(radii, np.cos(turn)), np.outer(radii, np.sin(turn))], 2)
    vertices = np.concatenate([rings, np.broadcast_to(heights[:, None, None], (4, 48, 1))], 2).reshape(-1, 3)
    a, b = np.arange(48), np.roll(np.arange(48), -1)
    walls = [np.c_[a + k, b + k, b + k + 48, a + k, b + k + 48, a + k + 48] for k in (0, 48, 96)]
    floor = np.c_[b, a, np.full(48, len(vertices))]
    faces = np.concatenate([*(wall.reshape(-1, 3) for wall in walls), floor])
    return np.concatenate([vertices, [[0, 0, 0]]]) - [0, 0, 0.5], faces


def test_a_narrow_mouth_is_an_opening_if_a_wall_is_asked_for_and_noted_else():
    shell, solid = (close_surface(*bottle(0.05), wall=wall) for wall in (0.01, None))
    assert (shell.last_step, shell.warnings, shell.holes) == ("thicken", [], 0)
    assert 0.06 * solid.volume < shell.volume < 0.25 * solid.volume
    assert (solid.last_step, solid.warnings, solid.holes) == ("cap", [], 1)
    wide = close_surface(*bottle(0.16))
    assert (wide.last_step, wide.holes) == ("thicken", 0)


def test_a_wall_that_is_asked_for_goes_to_one_piece_if_none_is_a_sheet():
    legs = [
        (vertices * [0.3, 0.3, 0.6] + [x, 0, 0], faces)
        for x, (vertices, faces) in ((-0.3, bottle(0.05)), (0.3, bottle(0.06)))
    ]
    board = box((0.8, 0.3, 0.05), (0, 0, -0.32))
    surface = close_surface(*join(board, *legs), wall=0.01)
    (step,) = (step for step in surface.repairs if step.name == "thicken")
    assert step.detail == "1 holes capped, 1 sheets given a wall of 1.00% of the size in 2 open of 3 pieces"


@pytest.mark.parametrize("faces", [[[0, 1, 2], [0, 2, 3]], [[0, 1, 2]]], ids=["square", "triangle"])
def test_the_simplest_sheets_get_a_wall(faces):
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) - [0.5, 0.5, 0]
    asked, default = (close_surface(square, np.array(faces), wall=wall) for wall in (0.01, None))
    for surface, wall in ((asked, 0.01), (default, 0.02)):
        assert surface.last_step == "thicken"
        assert surface.volume == pytest.approx(wall * len(faces) / 2)
    assert asked.warnings == []
    assert "set `wall`" in default.warnings[0]


@pytest.mark.parametrize(
    ("faces", "count"),
    [
        ([[0, 1, 2]], "1 face, without any area; expected a mesh that"),
        ([[0, 1, 1], [0, 3, 3]], "2 faces, 0 of them not degenerate, without any area"),
        ([[0, 0, 0]], "1 face, 0 of them not degenerate, without any area; expected a mesh"),
    ],
)
def test_a_mesh_without_area_is_refused_with_the_faces_that_welding_drops(faces, count):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0, 1, 0]], float)
    refused(rf"^flat: the mesh has {count}", close_surface, corners, np.array(faces), "flat")


@settings(max_examples=1, deadline=None)
@given(SEEDS)
@pytest.mark.parametrize("share", [pytest.param(0.002, marks=pytest.mark.slow), 0.02])
def test_deleted_faces_are_closed_again(mug, share, seed):
    vertices, faces = mug
    kept = np.random.default_rng(seed).random(len(faces)) >= share
    surface = close_surface(vertices, faces[kept])
    assert surface.last_step in ("cap", "union")  # some faces are left alone, and vanish
    assert surface.volume == pytest.approx(signed_volume(*mug), rel=2e-3)
    assert surface.components == 1
    assert surface.deviation_max < 0.03  # the mug's longest edges


@settings(max_examples=2, deadline=None)
@given(SEEDS)
def test_flipped_faces_are_turned_back(mug, seed):
    vertices, faces = mug
    turned = np.random.default_rng(seed).random(len(faces)) < 0.05
    surface = close_surface(vertices, np.where(turned[:, None], faces[:, ::-1], faces))
    assert surface.last_step == "keep"
    assert surface.volume == pytest.approx(signed_volume(*mug))


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [1e-6, 1e-5])
def test_a_jittered_soup_is_welded(mug, rng, jitter):
    vertices, faces = soup(mug)
    surface = close_surface(vertices + rng.normal(size=vertices.shape) * jitter, faces)
    assert surface.last_step == "keep"
    assert surface.volume == pytest.approx(signed_volume(*mug), rel=1e-3)
    assert jitter < surface.deviation_max < 100 * jitter


@pytest.mark.slow
def test_a_soup_that_welding_cannot_close_is_remeshed_with_a_warning(mug, rng, monkeypatch):
    monkeypatch.setattr("objectfolder.mesh.closing.contour.RESOLUTION", 64)
    vertices, faces = soup(mug)
    surface = close_surface(vertices + rng.normal(size=vertices.shape) * 1e-3, faces)
    assert surface.last_step == "grid"
    assert "remeshed" in surface.warnings[0]
    assert surface.volume == pytest.approx(signed_volume(*mug), rel=0.05)
    assert surface.components == 1


def test_an_inside_out_soup_that_is_remeshed_is_turned_outward(rng, monkeypatch):
    monkeypatch.setattr("objectfolder.mesh.closing.contour.RESOLUTION", 32)
    vertices, faces = soup(sphere(0.5, 2))
    torn = vertices + rng.normal(size=vertices.shape) * 1e-3
    surface, same = (close_surface(torn, way) for way in (faces[:, ::-1], faces))
    assert surface.last_step == same.last_step == "grid"
    assert surface.volume == pytest.approx(same.volume)
    assert surface.volume == pytest.approx(signed_volume(*sphere(0.5, 2)), rel=0.05)


def test_coincident_copies_are_one(mug):
    vertices, faces = mug
    twice = close_surface(*join(mug, mug))
    assert len(twice.faces) == len(faces)
    shifted = close_surface(*join(mug, (vertices + 1e-5, faces)))
    assert shifted.components == 1
    assert shifted.volume == pytest.approx(signed_volume(*mug), rel=1e-3)


def test_slivers_that_hang_on_a_closed_surface_are_dropped(mug):
    vertices, faces = mug
    middle = vertices[faces[:50, :2]].mean(1)
    slivers = np.column_stack([faces[:50, :2], len(vertices) + np.arange(50)])
    surface = close_surface(np.concatenate([vertices, middle]), np.concatenate([faces, slivers]))
    assert surface.last_step == "keep"
    assert len(surface.faces) == len(faces)


def test_a_piece_that_overlaps_itself_encloses_space_once():
    surface = close_surface(*pretzel())
    assert surface.last_step == "untangle"
    assert surface.certificate.solid
    assert surface.volume == pytest.approx(0.96 * signed_volume(*pretzel()), rel=0.01)


def test_every_repair_is_recorded_with_what_it_changed():
    left, right = (box((0.3, 0.3, 0.3), (x, 0, 0)) for x in (-0.155, 0.155))
    bottomless = (right[0], right[1][right[0][right[1]][:, :, 2].max(1) > -0.1])
    lid = box((0.32, 0.32, 0.1), (0.165, 0, -0.19))
    surface = close_surface(*join(left, bottomless, lid))
    assert [step.name for step in surface.repairs] == ["clean", "cap", "union", "bridge"]
    clean_, cap, union, bridged = surface.repairs
    assert (clean_.volume_after, cap.volume_before) == (None, None)
    assert cap.components_after == union.components_before == 3
    assert cap.volume_after == pytest.approx(2 * 0.027 + 0.01024)
    assert union.components_after == 2
    assert (
        union.volume_after == bridged.volume_before == pytest.approx(2 * 0.027 + 0.01024 - 0.3 * 0.3 * 0.01)
    )
    assert bridged.components_after == 1
    assert bridged.deviation_max < BRIDGED_GAP
    assert surface.unbridged is not None
    assert signed_volume(*surface.unbridged) == pytest.approx(union.volume_after)


def test_pieces_that_are_too_far_apart_are_named_with_volumes_and_gaps():
    pieces = join(box((0.4, 0.4, 0.4), (-0.25, 0, 0)), box((0.2, 0.4, 0.4), (0.1, 0, 0)))
    with pytest.raises(ObjectFolderError) as caught:
        close_surface(*pieces, "lamp")
    text = str(caught.value)
    assert text.startswith("lamp: 2 separate pieces")
    assert "66.7% of the volume, 5.00% of the size away from piece 2" in text
    assert "33.3% of the volume, 5.00% of the size away from piece 1" in text


@pytest.mark.slow
def test_bridging_can_be_switched_off():
    pieces = join(box((0.4, 0.4, 0.4), (-0.205, 0, 0)), box((0.4, 0.4, 0.4), (0.205, 0, 0)))
    assert close_surface(*pieces).components == 1
    refused("bridging is off", close_surface, *pieces, bridging=False)


@pytest.mark.slow
def test_two_million_faces():
    mesh = trimesh.creation.torus(0.35, 0.14, 1000, 1000)
    surface = close_surface(*soup((np.array(mesh.vertices), np.array(mesh.faces, np.int64))))
    assert len(surface.faces) == 2_000_000
    assert surface.volume == pytest.approx(2 * np.pi**2 * 0.35 * 0.14**2, rel=1e-4)


@pytest.mark.parametrize(
    "folder",
    [
        pytest.param(folder, marks=[] if folder.name in QUICK else [pytest.mark.slow])
        for folder in sorted(OBJECTS.glob("*_*"))
    ]
    or [pytest.param(None, marks=pytest.mark.skip(reason="needs the shared objects"))],
    ids=lambda folder: getattr(folder, "name", "none"),
)
def test_real_objects_become_one_solid(folder):
    (path,) = (p for p in folder.glob("mesh.*") if p.suffix in (".obj", ".gltf"))
    mesh = load_mesh(path, default_up(path), 16)
    if folder.name == "ycb_skillet_lid":  # a scan without the glass
        refused(r"2 separate pieces.*17\.21% of the size away", normalize, mesh, folder.name)
        return
    surface = normalize(mesh, folder.name).surface
    assert surface.components == 1
    assert surface.certificate.solid
    bridged = folder.name == "gso_bunny_racer"
    assert (surface.last_step == "bridge") == bridged
    assert surface.deviation_max < (0.01 if bridged else 1e-8)


@pytest.mark.parametrize("turned", [(), (0,), (1,), (0, 1)])
def test_overlapping_pieces_are_united_however_they_are_oriented(turned):
    pieces = [box((0.6, 0.4, 0.4), (-0.2, 0, 0)), box((0.6, 0.2, 0.2), (0.25, 0.013, 0.017))]
    mixed = [flipped(p) if i in turned else p for i, p in enumerate(pieces)]
    surface = close_surface(*join(*mixed))
    assert surface.volume == pytest.approx(0.096 + 0.024 - 0.15 * 0.04)
    assert surface.components == 1
    assert surface.deviation_max < 1e-9


@pytest.mark.parametrize("turned", [False, True])
def test_a_cavity_is_subtracted_also_from_a_mesh_that_is_inside_out(turned):
    outer, inner = sphere(0.5, 3), sphere(0.3, 3, (0.1, 0, 0))
    surface = close_surface(*join(*((flipped(outer), inner) if turned else (outer, flipped(inner)))))
    assert surface.volume == pytest.approx(signed_volume(*outer) - signed_volume(*inner))
    assert is_closed(surface.faces)
    assert (surface.components, surface.cavities) == (1, 1)
    assert surface.deviation_max < 1e-9


def test_a_solid_inside_a_cavity_is_kept():
    shells = [
        sphere(0.5, 2),
        flipped(sphere(0.4, 2)),
        sphere(0.3, 2),
        flipped(sphere(0.2, 2)),
        sphere(0.1, 2),
    ]
    rod = box((0.9, 0.06, 0.06))
    a, b, c, d, e, r = (to_manifold(s if signed_volume(*s) > 0 else flipped(s)) for s in (*shells, rod))
    truth = (a - b + (c - d) + e + r).volume()
    for mesh in (join(*shells, rod), flipped(join(rod, *shells[::-1]))):
        surface = close_surface(*mesh)
        assert surface.volume == pytest.approx(truth)
        assert (surface.components, surface.cavities) == (1, 2)
    with pytest.raises(ObjectFolderError, match="3 separate pieces"):  # a rattle
        close_surface(*join(*shells))


def plates(*counts, turn):
    """A cube of six separate faces, each of another tessellation."""
    faces = []
    for count, normal in zip(counts, (*np.eye(3), *-np.eye(3))):
        i, j = np.indices((count, count + 1)).reshape(2, -1)
        x, y = np.indices((count + 1, count + 2)).reshape(2, -1)
        points = np.stack([x / count - 0.5, y / (count + 1) - 0.5, np.full(len(x), 0.5)], 1)
        a, b, c, d = ((i + di) * (count + 2) + j + dj for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
        u = np.roll(normal, 1)
        side = np.stack([u, np.cross(normal, u), normal], 1)
        faces.append((points @ (turn @ side).T, np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])))
    return join(*faces)


@pytest.mark.parametrize("turn", [np.eye(3), TURN], ids=["aligned", "turned"])
def test_cracks_between_faces_of_different_tessellation_are_stitched(turn):
    vertices, faces = soup(plates(1, 2, 3, 5, 7, 11, turn=turn))
    surface = close_surface(vertices.astype(np.float32), faces)
    assert surface.last_step == "keep"
    assert surface.volume == pytest.approx(1, rel=1e-6)
    assert surface.components == 1
    assert surface.deviation_max < 1e-5


@pytest.mark.parametrize("turn", [np.eye(3), TURN], ids=["aligned", "turned"])
def test_boxes_that_touch_in_faces_become_one(turn):
    bricks = join(*[box((0.5,) * 3, np.multiply(place, 0.5)) for place in np.ndindex(2, 2, 2)])
    surface = close_surface(bricks[0] @ turn.T, bricks[1])
    assert surface.volume == pytest.approx(1)
    assert surface.components == 1
    assert surface.deviation_max < 1e-9


def test_a_wall_without_room_fills_the_sheet_and_says_so():
    vertices, faces = sphere(0.5, 4)
    bowl = (vertices, faces[vertices[faces].mean(1)[:, 2] < 0])
    filled = close_surface(*bowl, wall=0.49).volume
    for wall in (0.6, 1.5):
        surface = close_surface(*bowl, wall=wall)
        assert surface.last_step == "cap"
        assert surface.volume == pytest.approx(filled, rel=0.03)
        assert surface.vertices.max(0) == pytest.approx(bowl[0][np.unique(bowl[1])].max(0))
        assert surface.warnings[0].endswith(f"a wall of {wall:.2%} of the size: `wall` is not used")
    (warning,) = close_surface(*bowl, wall=0.6, scale=0.5).warnings
    assert warning.endswith("a wall of 0.3 m: `wall` is not used")


def test_a_needle_that_no_grid_resolves_is_refused_as_too_thin():
    vertices, faces = box((1, 0.001, 0.001))
    refused(r"needle: .* thinner than 0\.8% of its size everywhere", close_surface, vertices, faces, "needle")


def test_a_crowd_of_pieces_is_refused_without_bridging_it():
    crowd = [box((0.05,) * 3, np.multiply(place, 0.051)) for place in np.ndindex(6, 6, 4)]
    refused(r"144 separate pieces.*more than 128 pieces are not bridged", close_surface, *join(*crowd))


def test_a_solid_inside_another_vanishes():
    assert close_surface(*join(box((1, 1, 1)), box((0.2, 0.2, 0.2)))).volume == pytest.approx(1)


def test_specks_are_dropped():
    surface = close_surface(*join(box((0.8, 0.8, 0.8)), box((0.01, 0.01, 0.01), (0.45, 0, 0))))
    assert surface.volume == pytest.approx(0.512)
    assert surface.components == 1


def test_small_parts_within_reach_of_a_bridge_are_kept_and_others_dropped():
    """Two knobs of a ten-thousandth of the volume each, one by the body and one far off, and a crumb."""
    body, side = box((0.8, 0.4, 0.8)), 0.03
    knobs = [box((side,) * 3, (x, 0.2 + side / 2 + gap, 0)) for x, gap in ((-0.2, 0.002), (0.2, 0.1))]
    crumb = box((0.004,) * 3, (0, 0.203, 0.2))
    surface = close_surface(*join(body, *knobs, crumb))
    assert [step.name for step in surface.repairs[-3:]] == ["specks", "bridge", "specks"]
    assert surface.components == 1
    v = surface.vertices[surface.vertices[:, 1] > 0.21]
    assert (v[:, 0] < -0.17).all()
    assert v[:, 1].max() == pytest.approx(0.2 + side + 0.002)
    assert surface.volume - 0.256 == pytest.approx(side**3, rel=0.25)  # and the bridge


@pytest.mark.slow
@settings(max_examples=2, deadline=None)
@given(SEEDS)
def test_garbage_is_refused_or_becomes_a_closed_outward_surface(seed):
    rng = np.random.default_rng(seed)
    vertices = rng.uniform(-0.5, 0.5, (6, 3))
    faces = np.stack([rng.permutation(6)[:3] for _ in range(8)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("objectfolder.mesh.closing.contour.RESOLUTION", 24)
        try:
            surface = close_surface(vertices, faces)
        except ObjectFolderError:
            return
    assert is_closed(surface.faces)
    assert surface.volume > 0


def test_a_written_surface_is_read_back(tmp_path):
    surface = sphere(0.5, 2)
    path = tmp_path / "surface.ply"
    write_surface(path, surface)
    vertices, faces = read_surface(path)
    np.testing.assert_array_equal(faces, surface[1])
    np.testing.assert_allclose(vertices, surface[0], atol=1e-7)
    first = path.read_bytes()
    write_surface(path, surface)
    assert path.read_bytes() == first


@pytest.mark.parametrize("content", [b"", b"ply garbage", b"\x00\xff" * 50])
def test_a_damaged_surface_file_is_named(tmp_path, content):
    path = tmp_path / "surface.ply"
    refused(r"surface\.ply does not exist", read_surface, path)
    path.write_bytes(content)
    refused(r"surface\.ply is damaged", read_surface, path)


def test_a_step_that_leaves_nothing_is_told_in_words():
    repair = _Repair("thing", *box((1, 1, 1)))
    repair.mesh = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    refused("thing: encloses nothing .*expected a mesh that encloses a volume", repair.drop_specks)
