import numpy as np
from solids import box, sphere

from objectfolder.mesh.raycast import RayCaster

UP = np.array([[0.0, 0, 1]])


def test_distances_are_in_units_of_the_direction():
    caster = RayCaster(*box((1, 1, 1)))
    origin = np.array([[0.1, 0.2, -2.0]])
    for length in (1, 2, 0.5):
        distance, face = caster.first_hit(origin, length * UP)
        assert distance.dtype == np.float32
        np.testing.assert_allclose(distance, 1.5 / length, rtol=1e-6)
        assert face[0] >= 0


def test_a_miss_and_a_ray_that_ends_before():
    caster = RayCaster(*box((1, 1, 1)))
    origins = np.array([[0.1, 0.2, -2.0], [2.0, 2, -2], [0.1, 0.2, -2]])
    distance, face = caster.first_hit(origins, UP.repeat(3, 0), np.array([1.4, 10, 1.6]))
    assert distance.tolist()[:2] == [np.inf, np.inf]
    assert face.tolist()[:2] == [-1, -1]
    assert caster.occluded(origins, UP.repeat(3, 0), np.array([1.4, 10, 1.6])).tolist() == [
        False,
        False,
        True,
    ]


def test_the_face_that_is_hit():
    vertices, faces = box((1, 1, 1))
    _, face = RayCaster(vertices, faces).first_hit(np.array([[0.1, 0.2, -2.0]]), UP)
    assert (vertices[faces[face[0]]][:, 2] == -0.5).all()


def test_no_rays():
    distance, face = RayCaster(*box((1, 1, 1))).first_hit(np.zeros((0, 3)), np.zeros((0, 3)))
    assert distance.shape == face.shape == (0,)


def test_one_origin_and_any_strides_serve_all_rays(rng):
    caster = RayCaster(*box((1, 1, 1)))
    origin = np.float32([0.3, -0.2, 2])
    directions = (rng.uniform(-0.8, 0.8, (3, 300)) - origin[:, None]).astype(np.float32).T
    origins = np.tile(origin, (300, 1))
    expected = caster.intersect(origins, np.ascontiguousarray(directions))
    assert 50 < len(expected[0]) < 250
    frozen = origin.copy()
    frozen.flags.writeable = False
    for start in (origin, frozen, np.broadcast_to(origin, (300, 3))):
        for found, known in zip(caster.intersect(start, directions), expected):
            np.testing.assert_array_equal(found, known)
    occluded = caster.occluded(origin, directions)
    assert np.flatnonzero(occluded).tolist() == expected[0].tolist()


def test_depths_are_the_distances_of_first_hits():
    caster = RayCaster(*sphere(0.4, 3))
    rng = np.random.default_rng(0)
    directions = (np.array([0, 0, -1]) + 0.4 * rng.normal(size=(300, 3))).astype(np.float32)
    limit = rng.uniform(0.4, 1.2, 300).astype(np.float32)
    given = limit.copy()
    depths = caster.depths(np.float32([0, 0, 1]), directions, limit)
    expected, face = caster.first_hit(np.tile(np.float32([0, 0, 1]), (300, 1)), directions, limit)
    assert 0.2 < (face >= 0).mean() < 0.8
    np.testing.assert_array_equal(depths, expected)
    np.testing.assert_array_equal(limit, given)
