import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from scipy.optimize import brentq
from touch_solids import caster, slab

from objectfolder.base.errors import ObjectFolderError
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.contact import UP, contact_normals, heightmaps, probe_directions, sensor_frames
from objectfolder.touch.gel import GAP

MM = 1e-3


def units(n, seed=0):
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def degrees_between(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))


def box_distance(p, half=1.0):
    q = np.abs(p) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


long_vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)
unit_vectors = long_vectors.map(lambda v: v / np.linalg.norm(v))
angles = st.floats(-10, 10)

# --- contact normals


def test_probe_directions_are_symmetric_and_balanced():
    u = probe_directions()
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1, atol=1e-12)
    np.testing.assert_array_equal(u[:32], -u[32:])
    np.testing.assert_allclose(u.T @ u, np.eye(3) * 64 / 3, atol=1e-9)
    nearest = np.sort(u @ u.T, axis=1)[:, -2]
    assert np.degrees(np.arccos(nearest)).min() > 10  # quasi-uniform: 64 caps of this radius would be 14°


@settings(deadline=None)
@given(unit_vectors, st.floats(-1, 1))
def test_normal_of_a_plane_is_exact(normal, offset):
    points = np.array([normal * offset])
    found = contact_normals(lambda p: p @ normal - offset, points, 0.3)
    assert degrees_between(found, normal)[0] < 1e-6


def test_normal_of_a_sphere_is_radial():
    n = units(500)
    found = contact_normals(lambda p: np.linalg.norm(p, axis=1) - 1, n, 0.05)
    assert degrees_between(found, n).max() < 0.05


def test_normal_at_an_edge_and_a_corner_is_the_bisector():
    points = np.array([[1, 1, 0.2], [1, 0.1, -1], [0.3, -1, 1], [1, 1, 1], [-1, 1, 1]], float)
    expected = np.where(np.abs(points) == 1, points, 0)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert degrees_between(contact_normals(box_distance, points, 0.1), expected).max() < 1.5
    refused("no contact normal", contact_normals, box_distance, np.zeros((1, 3)), 0.1)


def test_normal_turns_gradually_across_an_edge():
    x = np.linspace(0.7, 1, 61)
    points = np.stack([x, np.ones_like(x), np.full_like(x, 0.2)], axis=1)
    found = contact_normals(box_distance, points, 0.1)
    assert degrees_between(found[:1], np.array([0, 1, 0])).max() < 1e-6
    assert degrees_between(found[1:], found[:-1]).max() < 3


# --- frames


@settings(deadline=None)
@given(unit_vectors, angles)
def test_frames_are_right_handed_and_look_into_the_object(normal, angle):
    frame = sensor_frames(normal, angle)[0]
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-9)
    assert np.linalg.det(frame) == pytest.approx(1)
    np.testing.assert_array_equal(frame[:, 0], -normal)


@settings(deadline=None)
@given(unit_vectors, angles, angles)
def test_angle_turns_about_the_outward_normal(normal, first, second):
    cross = np.cross(np.eye(3), normal)  # rows e_i × n, so that cross.T... v -> n × v is -cross.T @ v
    turn = np.eye(3) - np.sin(second) * cross.T + (1 - np.cos(second)) * (cross.T @ cross.T)
    composed = turn @ sensor_frames(normal, first)[0]
    np.testing.assert_allclose(composed, sensor_frames(normal, first + second)[0], atol=1e-9)


def test_angle_is_anticlockwise_seen_from_outside():
    normal = np.array([[0, 0, 1.0]])
    before, after = sensor_frames(normal, 0.0)[0, :, 2], sensor_frames(normal, 0.1)[0, :, 2]
    np.testing.assert_allclose(before, np.array([1, 2, 0]) / np.sqrt(5), atol=1e-12)
    assert np.cross(before, after)[2] == pytest.approx(np.sin(0.1))


def test_frames_are_continuous_away_from_the_oblique_direction():
    n = units(4000)
    n = n[np.abs(n @ UP) < 0.995]
    near = n + 1e-6 * units(len(n), seed=1)
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    # The projection is at least 0.1 long, so a change of 1e-6 in n cannot turn z by more than 2e-5.
    assert np.abs(sensor_frames(n, 0.0) - sensor_frames(near, 0.0)).max() < 2e-5


@pytest.mark.parametrize("normal", [UP, -UP])
def test_frame_at_the_oblique_direction_is_still_a_frame(normal):
    frame = sensor_frames(normal, 0.3)[0]
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-9)


# --- heightmaps

TOP = np.array([[0, 0, 10 * MM]])
Z = np.array([[0, 0, 1.0]])


@settings(deadline=None, max_examples=15)
@given(depth=st.floats(0.2 * MM, 2 * MM))
def test_ball_in_a_flat_gel_leaves_a_centred_disc(flat, ball, depth):
    penetration, obstructed, _ = heightmaps(ball, TOP, Z, 0.0, depth, flat)
    rows, columns = np.nonzero(penetration[0] > 0)
    y = (columns - (flat.width - 1) / 2) * flat.pixel_pitch
    z = (rows - (flat.height - 1) / 2) * flat.pixel_pitch
    expected = np.sqrt(2 * 10 * MM * depth - depth**2)
    assert np.hypot(y, z).max() == pytest.approx(expected, abs=flat.pixel_pitch)
    assert np.sqrt(len(y) * flat.pixel_pitch**2 / np.pi) == pytest.approx(expected, abs=flat.pixel_pitch)
    assert abs(y.mean()) < 0.1 * flat.pixel_pitch
    assert abs(z.mean()) < 0.1 * flat.pixel_pitch
    assert penetration.max() == pytest.approx(depth, abs=0.01 * MM)
    assert obstructed[0] == 0


@pytest.mark.parametrize("normal", [[0, 0, 1.0], [0, 0, -1.0]])
def test_plate_in_a_flat_gel_is_constant(flat, normal):
    plate = caster(slab(-2 * MM, 2 * MM))
    point = 2 * MM * np.array([normal])
    penetration, obstructed, _ = heightmaps(plate, point, np.array([normal]), 0.7, 1 * MM, flat)
    np.testing.assert_allclose(penetration, 1 * MM, atol=1e-7)
    assert obstructed[0] == 0


@pytest.mark.parametrize("depth", [0.1 * MM, 0.3 * MM, 0.7 * MM, 1.2 * MM, 2 * MM])
@pytest.mark.parametrize("radius", [3 * MM, 8 * MM, np.inf])
def test_imprint_of_a_ball_is_the_circle_where_it_cuts_the_dome(digit, depth, radius):
    """In pixels, through the pinhole; a ball of infinite radius is a plate."""
    mesh = slab(-2 * MM, 0)
    if not np.isinf(radius):
        mesh = trimesh.creation.icosphere(6, radius=radius)
        mesh.apply_translation([0, 0, -radius])
    height, *_ = heightmaps(caster(mesh), 0 * TOP, Z, 0.3, depth, digit)

    def sag(r):
        dome = digit.gel_dome_radius
        return digit.gel_curvature * dome * (dome - np.sqrt(dome**2 - r**2))

    def overlap(r):
        return depth - sag(r) - (0 if np.isinf(radius) else radius - np.sqrt(radius**2 - r**2))

    r = brentq(overlap, 0, min(radius, 12 * MM))
    seen = r / (digit.camera_to_gel - sag(r)) / digit.half_extent[0] * digit.height / 2
    if seen < digit.width / 2:
        assert np.sqrt((height[0] > 0).sum() / np.pi) == pytest.approx(seen, abs=0.3)
    rows, _ = np.nonzero(height[0] > 0)
    if seen < digit.height / 2:
        assert (rows.max() - rows.min() + 1) / 2 == pytest.approx(seen, abs=0.8)  # to whole pixels


def test_image_axes(flat):
    """The image's up is the frame's z, its right the frame's -y."""
    depth, shift = 1 * MM, 4 * MM
    frame = sensor_frames(Z, 0.0)[0]
    for axis, expected in ((frame[:, 2], (-1, 0)), (-frame[:, 1], (0, 1))):
        ball = trimesh.creation.icosphere(4, radius=5 * MM)
        ball.apply_translation(shift * axis - [0, 0, 5 * MM])
        penetration, *_ = heightmaps(caster(ball), 0 * TOP, Z, 0.0, depth, flat)
        rows, columns = np.nonzero(penetration[0] > 0)
        moved = np.array([rows.mean() - 79.5, columns.mean() - 59.5]) * flat.pixel_pitch
        np.testing.assert_allclose(moved, shift * np.array(expected), atol=0.25 * MM)


def test_wall_behind_the_gel_does_not_intrude(digit):
    wall = slab(-4 * MM, 0)
    alone, free, _ = heightmaps(caster(wall), 0 * TOP, Z, 0.0, 1 * MM, digit)
    more = caster(wall, slab(12 * MM, 15 * MM), slab(-14 * MM, -9 * MM))
    both, obstructed, _ = heightmaps(more, 0 * TOP, Z, 0.0, 1 * MM, digit)
    np.testing.assert_allclose(both, alone, atol=1e-8)  # rays that restart round differently
    assert (free[0], obstructed[0]) == (0, 1)


def test_small_thing_behind_the_gel_obstructs_its_pixels_only(digit):
    thing = trimesh.creation.box((2 * MM, 2 * MM, 2 * MM))
    thing.apply_translation((0, 0, 11 * MM))
    wall = slab(-4 * MM, 0)
    both, obstructed, _ = heightmaps(caster(wall, thing), 0 * TOP, Z, 0.0, 1 * MM, digit)
    alone, *_ = heightmaps(caster(wall), 0 * TOP, Z, 0.0, 1 * MM, digit)
    np.testing.assert_allclose(both, alone, atol=1e-8)
    # Its near face, 9 mm from the camera, is 2 mm wide.
    pitch = digit.pixel_pitch * 9 / 22
    assert obstructed[0] * digit.height * digit.width == pytest.approx((2 * MM / pitch) ** 2, rel=0.06)


def test_post_through_the_gel_stops_the_body(flat):
    """A post 6.5 mm past the gel: 2.5 mm past its base. The gel bears the post alone, up to its base."""
    post = trimesh.creation.box((4 * MM, 4 * MM, 2 * 6.5 * MM))
    both = caster(slab(-4 * MM, 0), post)
    height, obstructed, _ = heightmaps(both, 0 * TOP, Z, 0.0, 0.0, flat)
    assert 0.01 < obstructed[0] < 0.2
    assert height.max() == np.float32(flat.max_indentation)
    assert np.median(height) == np.float32(-GAP * flat.elastomer_thickness)  # the wall is out of reach
    # The same as a post that just reaches the base, in front of a wall as far away.
    stub = trimesh.creation.box((4 * MM, 4 * MM, 2 * 4 * MM))
    expected, free, _ = heightmaps(caster(slab(-6 * MM, -2.5 * MM), stub), 0 * TOP, Z, 0.0, 0.0, flat)
    assert free[0] == 0
    np.testing.assert_allclose(height, expected, atol=1e-7)


def test_body_that_stops_a_little_short_still_presses_the_wall(flat):
    post = trimesh.creation.box((1 * MM, 1 * MM, 2 * 3.3 * MM))
    height, obstructed, _ = heightmaps(caster(slab(-4 * MM, 0), post), 0 * TOP, Z, 0.0, 1 * MM, flat)
    assert obstructed[0] > 0
    assert np.median(height) == pytest.approx((1 - 0.3) * MM, abs=1e-7)


def test_gel_is_not_touched_where_the_body_cannot_go(flat):
    """Within a block, and at the foot of a wall along the optical axis, 4 mm beside it."""
    floor, wall = slab(-4 * MM, 0), slab(-4 * MM, 60 * MM)
    floor.apply_translation((0, -36 * MM, 0))
    wall.apply_translation((0, 44 * MM, 0))
    for solid in (caster(slab(-40 * MM, 40 * MM)), caster(floor, wall)):
        height, obstructed, _ = heightmaps(solid, 0 * TOP, Z, 0.0, 1 * MM, flat)
        assert obstructed[0] > 0.1
        np.testing.assert_array_equal(height, np.float32(-GAP * flat.elastomer_thickness))


def test_scale_is_metres_per_unit(digit, ball):
    expected, *_ = heightmaps(ball, TOP, Z, 0.4, 1 * MM, digit)
    mesh = trimesh.creation.icosphere(5, radius=0.25)
    found, *_ = heightmaps(caster(mesh), TOP, Z, 0.4, 1 * MM, digit, scale=0.04)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("normal", [[0, 0, 1.0], [0.16, 0, np.sqrt(1 - 0.16**2)]])
def test_gap_beside_the_contact_is_negative_height(digit, normal):
    """A plate that the apex does not reach yet: the gap is what the dome and the tilt leave."""
    plate = caster(slab(-4 * MM, 0))
    normal = np.array([normal])
    point = -0.2 * MM * normal / normal[0, 2]  # 0.2 mm in the plate, so that depth 0 presses it
    height, *_ = heightmaps(plate, point, normal, 0.0, 0.0, digit)
    frame = sensor_frames(normal, 0.0)[0]
    on_gel = gel_depth(digit)[..., None] * ray_directions(digit) - [digit.camera_to_gel, 0, 0]
    above = (on_gel @ frame.T + point)[..., 2]  # of the gel's points over the plate
    along = above / -(ray_directions(digit) @ frame.T)[..., 2]
    expected = -along.clip(-digit.max_indentation, GAP * digit.elastomer_thickness)
    assert (expected > 0).any()
    assert (expected < -0.1 * MM).any()
    np.testing.assert_allclose(height[0], expected, atol=1e-7)


def test_sensor_does_not_fit_into_a_narrow_cavity(digit):
    wall, hollow = trimesh.creation.box((60 * MM,) * 3), trimesh.creation.box((12 * MM,) * 3)
    hollow.invert()
    floor, up = np.array([[0, 0, -6 * MM]]), Z
    height, obstructed, _ = heightmaps(caster(wall, hollow), floor, up, 0.0, 1 * MM, digit)
    assert obstructed[0] == 1
    np.testing.assert_array_equal(height, np.float32(-GAP * digit.elastomer_thickness))


@pytest.mark.parametrize("depth", [-1e-9, 3.01 * MM, 10 * MM, np.nan, -np.inf])
def test_impossible_depth_is_an_error(digit, ball, depth):
    with pytest.raises(ObjectFolderError, match=r"contact 1: press depth .* from 0 to 0\.003 m.*'digit'"):
        heightmaps(ball, np.tile(TOP, (2, 1)), np.tile(Z, (2, 1)), 0.0, np.array([1 * MM, depth]), digit)


@pytest.mark.parametrize("name", ["point", "normal", "angle"])
def test_values_that_are_not_finite_are_named(digit, ball, name):
    for value in (np.nan, np.inf):
        contact = {"point": np.tile(TOP, (2, 1)), "normal": np.tile(Z, (2, 1)), "angle": np.zeros(2)}
        contact[name][1] = value
        refused(f"contact 1: {name} .* must be finite", heightmaps, ball, *contact.values(), 1 * MM, digit)
