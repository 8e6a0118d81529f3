"""Walls that pass between the samples of a distance grid."""

import igl
import numpy as np
import pytest
from refusals import refused
from solids import TURN, box, isosurface, join, sharp_isosurface, sphere

from objectfolder.mesh.features import find_features
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.sdf import distance_grid
from objectfolder.mesh.topology import is_closed, signed_volume

RESOLUTION = 64
VOXEL = 2 * BOUND / (RESOLUTION - 1)
TILT = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])


def wedge(length, depth, thick, turn):
    """A blade: a prism on a narrow triangle, whose edge is the line x = depth / 2."""
    profile = np.array([[-depth / 2, -thick / 2], [depth / 2, 0], [-depth / 2, thick / 2]])
    vertices = np.array([[x, y, z] for y in (-length / 2, length / 2) for x, z in profile])
    sides = [[i, (i + 1) % 3, (i + 1) % 3 + 3] for i in range(3)] + [
        [i, (i + 1) % 3 + 3, i + 3] for i in range(3)
    ]
    faces = np.array([[0, 2, 1], [3, 4, 5], *sides])
    faces = faces if signed_volume(vertices, faces) > 0 else faces[:, ::-1]
    return vertices @ turn.T + [0.003, 0.001, 0.002], faces


CASES = {
    "sheet": box((0.8, 0.6, 0.4 * VOXEL), centre=(0.003, 0.001, 0.1 * VOXEL)),
    "tilted sheet": box((0.8, 0.6, 0.4 * VOXEL), turn=TILT),
    "turned sheet": box((0.8, 0.6, 0.6 * VOXEL), turn=TURN),
    "blade": wedge(0.7, 0.6, 4 * VOXEL, TURN),
}


def apart(points, surface):
    """Distances of points from a surface, voxels."""
    return np.sqrt(igl.point_mesh_squared_distance(points, *surface)[0]) / VOXEL


def both_ways(solid, stored):
    """Distances, voxels, of the solid's points from a stored surface, and of its points from the solid."""
    own = stored.vertices, stored.faces
    rng = np.random.default_rng(0)
    return apart(sample_surface(*solid, 4000, rng), own), apart(sample_surface(*own, 4000, rng), solid)


@pytest.mark.parametrize("name", CASES)
def test_walls_under_a_voxel_are_kept(name):
    solid = CASES[name]
    kept = both_ways(solid, sharp_isosurface(solid, RESOLUTION))
    for distance in kept:
        # What a rim reaches into a cell without crossing one of its edges is cut off.
        assert np.quantile(distance, 0.9) < 0.02
        assert distance.max() < 1
    if name == "sheet":
        refused("holds no surface: .*build the object again", isosurface, solid, RESOLUTION)
    else:
        assert (both_ways(solid, isosurface(solid, RESOLUTION))[0] > 0.5).mean() > 0.05


@pytest.mark.parametrize("name", CASES)
def test_walls_under_a_voxel_are_closed_and_hold_their_volume(name):
    surface = sharp_isosurface(CASES[name], RESOLUTION)
    assert is_closed(surface.faces)
    volume = signed_volume(surface.vertices, surface.faces)
    assert volume == pytest.approx(signed_volume(*CASES[name]), rel=0.1)
    assert np.isfinite(surface.shading.normals).all()


def test_sheets_face_outwards():
    """Rays from both sides meet the sheet on the side that they come from."""
    surface = sharp_isosurface(CASES["tilted sheet"], RESOLUTION)
    normal = TILT @ [0, 0, 1]
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(-0.35, 0.35, 400), rng.uniform(-0.25, 0.25, 400), np.zeros(400)])
    for side in (1, -1):
        start = (places @ TILT.T + 0.1 * side * normal).astype(np.float32)
        along = np.broadcast_to(-side * normal, start.shape).astype(np.float32)
        distance, face = surface.caster.first_hit(start, along)
        np.testing.assert_allclose(distance, 0.1 - 0.2 * VOXEL, atol=0.1 * VOXEL)
        shown = surface.shading.normals[surface.shading.faces[face]].mean(1) @ (side * normal)
        assert np.quantile(shown, 0.02) > 0.95


@pytest.mark.parametrize("name", CASES)
def test_points_on_walls_under_a_voxel_stay_where_they_are(name):
    """The distance that the grid interpolates there is off by up to half a voxel."""
    solid = CASES[name]
    surface = sharp_isosurface(solid, RESOLUTION)
    points = sample_surface(*solid, 2000, np.random.default_rng(0))
    nearest, distance = surface.nearest(points)
    on = apart(points, (surface.vertices, surface.faces)) < 0.02  # where the wall is kept whole
    assert on.mean() > 0.9
    np.testing.assert_allclose(distance, np.linalg.norm(nearest - points, axis=1))
    near = on if name != "blade" else on & (points @ TURN[:, 0] > 0.2)  # the thick end has ordinary edges
    assert np.quantile(distance[near], 0.99) < 0.03 * VOXEL
    assert apart(nearest[near], (surface.vertices, surface.faces)).max() < 0.1


def test_a_gap_under_a_voxel_between_thick_boards_is_no_wall():
    boards = join(
        box((0.3, 0.4, 0.6), centre=(-0.15 - 0.2 * VOXEL, 0, 0)),
        box((0.3, 0.4, 0.6), centre=(0.15 + 0.2 * VOXEL, 0, 0)),
    )
    features = find_features(distance_grid(*boards, RESOLUTION)[0], *boards)
    assert features.counts["sheets"] == features.counts["moved"] == 0


def test_a_ball_has_no_sheets():
    ball = sphere(0.45, 5)
    assert not len(find_features(distance_grid(*ball, RESOLUTION)[0], *ball).sheets)
