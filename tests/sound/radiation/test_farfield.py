import numpy as np
import pytest
import trimesh

from objectfolder.mesh.topology import face_areas, is_closed, signed_volume
from objectfolder.sound.click import AIR_DENSITY, SOUND_SPEED
from objectfolder.sound.radiation.boundary import Boundary
from objectfolder.sound.radiation.farfield import FarField, pack_far_field, unpack_far_field
from objectfolder.sound.radiation.harmonics import degrees
from objectfolder.sound.radiation.meshing import (
    even_surface,
    finer_surface,
    interpolate_motion,
    outward_motion,
    transfer_flow,
)
from objectfolder.sound.radiation.radiation import lagrange, radiate, radiate_motion
from objectfolder.sound.radiation.triangles import Triangles

RADIUS = 0.05


@pytest.fixture(scope="module")
def some_fields(rng_of=5):
    rng = np.random.default_rng(rng_of)
    orders = np.array([5, 9, 14, 20])
    size = (21) ** 2
    values = rng.normal(size=(4, size)) + 1j * rng.normal(size=(4, size))
    values *= (degrees(20) <= orders[:, None]) * np.array([[1e-6], [1.0], [30.0], [0.0]])
    return FarField(orders, values, RADIUS)


def test_a_stored_field_is_nearly_the_field(some_fields):
    found = unpack_far_field(pack_far_field(some_fields, 100_000), RADIUS)
    np.testing.assert_array_equal(found.orders, some_fields.orders)
    largest = abs(some_fields.coefficients).max(1, keepdims=True)
    assert (abs(found.coefficients - some_fields.coefficients) <= largest / 127).all()
    assert not found.coefficients[3].any()


@pytest.mark.parametrize("limit", [3000, 1000, 400])
def test_fewer_bytes_keep_the_power(some_fields, limit):
    packed = pack_far_field(some_fields, limit)
    assert sum(each.nbytes for each in packed.values()) <= limit
    power = (abs(unpack_far_field(packed, RADIUS).coefficients) ** 2).sum(1)
    np.testing.assert_allclose(power, (abs(some_fields.coefficients) ** 2).sum(1), rtol=0.15)


@pytest.mark.parametrize("damage", ["orders", "steps", "coefficients"])
def test_a_stream_of_another_length_is_refused(some_fields, damage):
    packed = pack_far_field(some_fields, 100_000)
    packed[damage] = packed[damage][:-1] if damage == "steps" else packed[damage].copy()
    if damage == "orders":
        packed[damage][0] += 1
    if damage == "coefficients":
        packed[damage] = pack_far_field(some_fields.truncate(7), 100_000)[damage]
    with pytest.raises(ValueError, match=r"coefficients|shape"):
        unpack_far_field(packed, RADIUS)


def test_a_swaying_sphere_at_any_distance():
    """p = -rho A cos(theta) a^3 / 2 r^2 of a slow one nearby; its exact wave otherwise."""
    ball = trimesh.creation.icosphere(4, RADIUS)
    axis = np.array([0.0, 0.6, 0.8])
    shapes = np.broadcast_to(axis[:, None], (len(ball.vertices), 3, 1))
    hertz = np.array([50.0])
    field = radiate((ball.vertices, ball.faces), ball.vertices, shapes, 2 * np.pi * hertz, 700)
    k = 2 * np.pi * hertz / SOUND_SPEED
    places = np.outer([0.06, 0.3, 30.0], axis)
    found = field.pressure(k, places)[:, 0]
    r, a = np.array([0.06, 0.3, 30.0]), RADIUS
    exact = AIR_DENSITY * a**3 * (1 - 1j * k * r) / r**2 / (2 - 2j * k * a - (k * a) ** 2)
    np.testing.assert_allclose(abs(found), abs(exact), rtol=0.03)
    assert abs(np.angle(found / exact)).max() < 0.02  # waves leave the ball at once in both


def test_a_cavity_is_not_heard():
    ball = trimesh.creation.icosphere(3, RADIUS)
    hollow = trimesh.creation.icosphere(3, 0.9 * RADIUS)
    vertices = np.concatenate([ball.vertices, hollow.vertices])
    faces = np.concatenate([ball.faces, hollow.faces[:, ::-1] + len(ball.vertices)])
    ka = np.array([0.1, 0.2, 0.4])
    breathing = np.repeat((vertices / np.linalg.norm(vertices, axis=1)[:, None])[:, :, None], len(ka), 2)
    field = radiate((vertices, faces), vertices, breathing, ka / RADIUS * SOUND_SPEED, 700)
    found = field.pressure(ka / RADIUS, np.array([[0, 0, 1.0]]))[0]
    expected = AIR_DENSITY * RADIUS**2 / (1 - 1j * ka)
    np.testing.assert_allclose(abs(found), abs(expected), rtol=0.03)


def test_modes_share_a_matrix_only_if_alike_and_fields_beyond_a_mesh_keep_their_power():
    ball = trimesh.creation.icosphere(2, RADIUS)
    boundary = Boundary(ball.vertices, ball.faces)
    motion = np.ones((len(boundary), 3))
    w = np.array([4.0, 60.0, 60.01]) / RADIUS * SOUND_SPEED
    field = radiate_motion(boundary, motion, w, RADIUS)
    power = (abs(field.coefficients) ** 2).sum(1)
    k = w / SOUND_SPEED
    exact = 4 * np.pi * AIR_DENSITY**2 * RADIUS**4 / (1 + (k * RADIUS) ** 2)
    np.testing.assert_allclose(power, exact, rtol=0.05)


@pytest.fixture
def calls(monkeypatch):
    """How many matrices were made (`system`), and how many solved (`solve`)."""
    count = {"system": 0, "solve": 0}

    def counted(name):
        method = getattr(Boundary, name)

        def call(*arguments):
            count[name] += 1
            return method(*arguments)

        monkeypatch.setattr(Boundary, name, call)

    for name in count:
        counted(name)
    return count


def hollow_ball():
    """A ball with a round cavity behind a narrow mouth."""
    ball = trimesh.creation.icosphere(3, RADIUS)
    cavity = trimesh.creation.icosphere(3, 0.8 * RADIUS)
    mouth = trimesh.creation.cylinder(0.15 * RADIUS, segment=[[0, 0, 0], [0, 0, 2 * RADIUS]])
    hollow = trimesh.boolean.difference([ball, cavity, mouth], engine="manifold")
    return even_surface(hollow.vertices, hollow.faces, 600)


@pytest.mark.parametrize(
    ("hollow", "fewest", "most", "median"), [(False, 0, 55, 0.01), (True, 60, 75, 0.002)]
)
def test_fields_of_dense_modes_are_interpolated_and_near_resonances_matrices(
    rng, calls, monkeypatch, hollow, fewest, most, median
):
    monkeypatch.setattr("objectfolder.sound.radiation.radiation._SHARED_SPAN", 1e-6)
    ball = trimesh.creation.icosphere(2, RADIUS)
    boundary = Boundary(*(hollow_ball() if hollow else (ball.vertices, ball.faces)))
    motion = rng.normal(size=(len(boundary), 60))
    w = np.sort(rng.uniform(3.5, 6.0, 60)) / RADIUS * SOUND_SPEED
    field = radiate_motion(boundary, motion, w, RADIUS)
    assert calls["system"] < 15
    assert fewest < calls["solve"] < most
    errors = []
    for mode, found in enumerate(field.coefficients):
        one = radiate_motion(boundary, motion[:, mode : mode + 1], w[mode : mode + 1], RADIUS)
        exact = np.pad(one.coefficients[0], (0, len(found) - one.coefficients.shape[1]))
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    assert np.median(errors) < median
    assert np.quantile(errors, 0.9) < 0.02  # on a narrow resonance, one may be off by a tenth


@pytest.mark.parametrize("count", [3, 4])
def test_interpolation_is_exact_for_polynomials(rng, count):
    nodes, places = np.arange(-1, count - 1), rng.uniform(0, 1, 50)
    values = np.polynomial.Polynomial(rng.normal(size=count))
    np.testing.assert_allclose(lagrange(nodes, places) @ values(nodes), values(places), atol=1e-12)


@pytest.mark.parametrize("shape", ["box", "cup"])
def test_an_even_surface_is_closed_and_keeps_its_size(shape):
    box = trimesh.creation.box((0.2, 0.1, 0.05))
    cup = trimesh.creation.annulus(0.04, 0.05, 0.1)
    mesh = {"box": box, "cup": cup}[shape]
    vertices, faces = even_surface(mesh.vertices, mesh.faces, 800)
    assert is_closed(faces)
    assert 700 < len(faces) <= 800
    assert signed_volume(vertices, faces) == pytest.approx(mesh.volume, rel=0.1)
    area = face_areas(vertices, faces)
    assert area.max() < 8 * np.median(area)


def test_interpolation_is_exact_for_rigid_motions_and_on_the_flat(rng):
    points = rng.uniform(-1, 1, (500, 3))
    points[:250, 2] = 0
    places = rng.uniform(-0.5, 0.5, (40, 3)) * [1, 1, 0]
    turn, expected = (np.cross(at, [0.3, -0.2, 0.5]) + np.array([1.0, 2.0, 3.0]) for at in (points, places))
    np.testing.assert_allclose(interpolate_motion(points, turn, places), expected, atol=0.02)


def test_a_coarse_surface_carries_all_of_the_flow_on_its_own_side(rng):
    plate = trimesh.creation.box((1.0, 0.8, 0.02))
    fine = Triangles.of(*finer_surface(plate.vertices, plate.faces, 0.05))
    coarse = Triangles.of(*finer_surface(plate.vertices, plate.faces, 0.2))
    flow = fine.normal[:, 2:] * fine.area[:, None] * [1.0, -2.0]
    found = transfer_flow(fine, flow, coarse)
    np.testing.assert_allclose(found.sum(0), flow.sum(0), atol=1e-12)
    top = coarse.normal[:, 2] > 0.5
    np.testing.assert_allclose(found[top].sum(0), [0.8, -1.6], rtol=1e-9)


def test_outward_motion_is_the_change_of_volume(rng):
    ball = trimesh.creation.icosphere(2)
    motion = rng.normal(size=(len(ball.vertices), 3, 2))
    grown = outward_motion(ball.vertices, ball.faces, motion)
    step = 1e-6
    for mode in range(2):
        volumes = [
            signed_volume(ball.vertices + sign * step * motion[..., mode], ball.faces) for sign in (1, -1)
        ]
        change = (volumes[0] - volumes[1]) / (2 * step)
        assert ball.area_faces @ grown[:, mode] == pytest.approx(change, rel=1e-6)
