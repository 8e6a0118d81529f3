import igl
import numpy as np
import pytest
import trimesh
from solids import TURN, box, flipped, join, pretzel, sphere

from objectfolder.mesh.closing import solids
from objectfolder.mesh.closing.joints import DEPTH
from objectfolder.mesh.closing.solids import bridge, drop_specks, find_gaps, label_bodies, unite, untangle
from objectfolder.mesh.scanline import winding_certificate
from objectfolder.mesh.topology import distance, is_closed, signed_volume


def test_a_body_that_overlaps_itself_encloses_space_once():
    tangled = pretzel()
    assert winding_certificate(*tangled).outside_fraction > 0.03
    vertices, faces = untangle(*tangled)
    assert is_closed(faces)
    assert winding_certificate(vertices, faces).solid
    # Reference: samples with winding number over 1/2, counted once.
    points = np.random.default_rng(0).uniform(-0.45, 0.45, (400_000, 3)) * [1, 1, 0.15]
    inside = np.asarray(igl.fast_winding_number(*tangled, points)) > 0.5
    assert signed_volume(vertices, faces) == pytest.approx(inside.mean() * 0.9**3 * 0.15, rel=0.01)
    assert distance(tangled, vertices).max() < 1e-9


def test_a_body_s_volume_is_net_of_its_cavities():
    outer, inner, apart = (
        box((0.6, 0.3, 0.3), (-0.2, 0, 0)),
        box((0.1,) * 3, (-0.3, 0, 0)),
        box((0.2,) * 3, (0.4, 0, 0)),
    )
    mesh = join(apart, flipped(inner), outer)
    label, volumes = label_bodies(*mesh)
    assert volumes == pytest.approx([0.053, 0.008])
    assert label.tolist() == [1] * 12 + [0] * 24


def test_specks_are_dropped_as_long_as_they_hold_a_thousandth_together():
    specks = [box((0.04,) * 3, (0.45, y, 0)) for y in np.linspace(-0.4, 0.4, 12)]  # 1.25e-4 each
    (vertices, faces), dropped = drop_specks(*join(box((0.8,) * 3), *specks))
    assert dropped == 8
    assert len(label_bodies(vertices, faces)[1]) == 5


def test_gaps_are_exact_and_sorted():
    pieces = [box((0.2,) * 3), box((0.2,) * 3, (0.21, 0, 0)), box((0.2,) * 3, (0, 0.205, 0.1))]
    found = find_gaps(pieces, 0.05)
    assert [gap for gap, _, _ in found] == pytest.approx([0.005, 0.01, np.hypot(0.005, 0.01)])
    assert find_gaps(pieces, 0.002) == []


@pytest.mark.parametrize("gap", [0.0, 1e-5, 1e-3, 0.01])
def test_a_bridge_joins_two_balls_near_the_gap_alone(gap):
    left, right = sphere(0.2, 4, (-0.25, 0, 0)), sphere(0.2, 4, (0.15 + gap, 0, 0))
    (vertices, faces), bridged = bridge(*join(left, right), 1 / 64)
    assert len(bridged) == 1
    assert bridged[0] == pytest.approx(gap, abs=1e-9)
    assert is_closed(faces)
    assert len(label_bodies(vertices, faces)[1]) == 1
    new = vertices[distance(join(left, right), vertices) > 1e-9]
    assert np.linalg.norm(new - [-0.05 + gap / 2, 0, 0], axis=1).max() < 0.08
    both = signed_volume(*left) + signed_volume(*right)
    assert both < signed_volume(vertices, faces) < 1.01 * both


def test_a_bridge_is_not_made_of_its_grid_s_slivers(monkeypatch):
    """A post on a plate: the same solid, in three quarters of the triangles."""
    post = trimesh.creation.cylinder(0.1, 0.3, sections=48)
    mesh = join(box((0.8, 0.8, 0.1), (0, 0, -0.2001)), (np.array(post.vertices), np.array(post.faces)))
    found, _ = bridge(*mesh, 1 / 64)
    monkeypatch.setattr(solids, "_BRIDGE_ROUGHNESS", 0.0)
    rough, _ = bridge(*mesh, 1 / 64)
    assert is_closed(found[1])
    assert len(found[1]) < 0.75 * len(rough[1])
    assert max(distance(rough, found[0]).max(), distance(found, rough[0]).max()) < 2e-7
    assert signed_volume(*found) == pytest.approx(signed_volume(*rough), rel=1e-7)


def test_wider_gaps_stay():
    apart = join(sphere(0.2, 3, (-0.25, 0, 0)), sphere(0.2, 3, (0.2, 0, 0)))
    (_, faces), bridged = bridge(*apart, 1 / 64)
    assert bridged == []
    assert faces is apart[1]


def test_a_chain_of_pieces_needs_one_bridge_fewer_than_it_has_pieces():
    chain = [box((0.2, 0.2, 0.2), (0.205 * k, 0, 0), TURN if k == 9 else None) for k in range(4)]
    mesh, bridged = bridge(*join(*chain), 1 / 64)
    assert len(bridged) == 3
    assert len(label_bodies(*mesh)[1]) == 1


@pytest.mark.parametrize("gap", [1e-6, 1e-4, 8e-4])
@pytest.mark.parametrize("turn", [None, TURN], ids=["aligned", "turned"])
def test_boards_that_touch_are_bonded_at_both_ends_over_their_whole_section(gap, turn):
    """Two sides and three shelves: six joints, each as wide as the shelf's end, and nothing beside them."""
    sides = [box((0.02, 0.3, 0.9), (x, 0, 0)) for x in (-0.31, 0.31)]
    shelves = [box((0.6 - 2 * gap, 0.25, 0.02), (0, 0, z)) for z in (-0.3, 0.05, 0.3)]
    apart = join(*sides, *shelves)
    if turn is not None:
        apart = apart[0] @ turn.T, apart[1]
    (vertices, faces), bridged = bridge(*apart, 1 / 64)
    assert bridged == pytest.approx([gap] * 6, rel=1e-3)
    assert is_closed(faces)
    volumes = label_bodies(vertices, faces)[1]
    assert volumes[0] > (1 - 1e-9) * volumes.sum()  # rounding may leave slivers of no volume
    filled = signed_volume(vertices, faces) - signed_volume(*apart)
    beads = 2 * (0.25 + 0.02) * (gap + DEPTH) ** 2  # along the edges of each joint
    assert 6 * 0.25 * 0.02 * gap * (1 - 1e-6) < filled < 6 * (0.25 * 0.02 * gap + beads)
    assert distance(apart, vertices).max() < 2 * (gap + DEPTH)


def test_boards_that_meet_at_an_edge_alone_are_joined_too():
    touching = join(box((0.4, 0.4, 0.02)), box((0.4, 0.02, 0.4), (0, 0.21, 0.21)))
    (vertices, faces), bridged = bridge(*touching, 1 / 64)
    assert bridged == pytest.approx([0.0], abs=1e-9)
    assert len(label_bodies(vertices, faces)[1]) == 1


def test_what_is_flat_does_not_take_part_in_a_union():
    flat = (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 1]]))
    mesh, cavities = unite([box((1, 1, 1)), flat])
    assert cavities == 0
    assert signed_volume(*mesh) == pytest.approx(1)
