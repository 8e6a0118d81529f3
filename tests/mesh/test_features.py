"""Sharp edges beside a distance grid: found, encoded, and put into the mesh."""

import numpy as np
import pytest
from solids import TURN, box, isosurface, join, sharp_isosurface, sphere

from objectfolder.mesh.featurecodec import Features, pack_features, unpack_features
from objectfolder.mesh.features import find_features
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.normals import area_vectors, unit_vectors
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.sdf import distance_grid
from objectfolder.mesh.topology import distance, is_closed, signed_volume

RESOLUTION = 64
VOXEL = 2 * BOUND / (RESOLUTION - 1)
SIDES = (0.8, 0.5, 0.3)
ALIGNED = tuple(2 * VOXEL * np.array([20, 15, 9]))  # with the two lowest samples' plane in the middle
CASES = {
    "turned": box(SIDES, turn=TURN),
    "upright": box(SIDES, centre=(0.003, 0.001, -0.002)),
    "on samples": box(ALIGNED, centre=(VOXEL / 2,) * 3),
    "board": box((0.9, 0.6, 2.3 * VOXEL), turn=TURN),
    "post": box((1.4 * VOXEL, 1.7 * VOXEL, 0.9), centre=(0.004, 0.001, 0)),
}


def distances(solid, surface):
    """Distances, voxels, of points of a solid's surface, edges and corners from a stored surface."""
    vertices, faces = solid
    corners = vertices[faces]
    along = np.linspace(0, 1, 40)[:, None, None, None]
    edges = (corners * along + np.roll(corners, 1, axis=1) * (1 - along)).reshape(-1, 3)
    points = np.concatenate([edges, sample_surface(*solid, 4000, np.random.default_rng(0))])
    return distance((surface.vertices, surface.faces), points) / VOXEL


@pytest.mark.parametrize("name", CASES)
def test_boxes_keep_their_edges(name):
    solid = CASES[name]
    surface, rounded = sharp_isosurface(solid, RESOLUTION), isosurface(solid, RESOLUTION)
    apart = distances(solid, surface)
    # A cell whose corner an edge cuts off, without a crossing on its far side, keeps a notch.
    assert np.quantile(apart, 0.95) < 0.05
    if name != "on samples":  # where interpolation is exact
        assert np.quantile(distances(solid, rounded), 0.95) > 0.3
    assert is_closed(surface.faces)
    volume = signed_volume(*solid)
    assert signed_volume(surface.vertices, surface.faces) == pytest.approx(volume, rel=0.02)


@pytest.mark.parametrize("name", ["turned", "upright", "on samples", "board"])
def test_faces_are_shaded_flat_up_to_their_edges(name):
    """Normals of shading are those of the faces on both sides of an edge, and copies only lie on edges."""
    surface = sharp_isosurface(CASES[name], RESOLUTION)
    shading = surface.shading
    np.testing.assert_array_equal(shading.vertices[shading.faces], surface.vertices[surface.faces])
    true = unit_vectors(area_vectors(*CASES[name]))
    areas = area_vectors(shading.vertices, shading.faces)
    corner = shading.normals[shading.faces]
    off = np.arccos(np.clip((corner @ true.T).max(2), -1, 1)).max(1)
    share = np.linalg.norm(areas, axis=1)
    assert share[off > np.deg2rad(10)].sum() < 0.02 * share.sum()
    assert len(surface.vertices) < len(shading.vertices) < 1.5 * len(surface.vertices)


def test_a_smooth_body_has_no_sharp_cells_and_keeps_its_mesh():
    ball = sphere(0.45, 5)
    values, band = distance_grid(*ball, RESOLUTION)
    features = find_features(values, *ball)
    assert len(features.cells) == 0
    assert len(features.edges) < 0.03 * len(isosurface(ball, RESOLUTION).vertices)
    plain = Isosurface(DistanceGrid(values, band))
    assert plain.shading.vertices is plain.vertices


def lost(surface, solid):
    return 1 - signed_volume(surface.vertices, surface.faces) / signed_volume(*solid)


def test_volume_lost_at_edges_is_a_small_part_of_what_a_grid_loses():
    """A grid loses a volume along the edges that shrinks with the square of the voxel."""
    solid = box(SIDES, turn=TURN)
    for resolution in (32, 64, 128):
        rounded = lost(isosurface(solid, resolution), solid)
        assert abs(lost(sharp_isosurface(solid, resolution), solid)) < 0.2 * rounded


def test_two_boards_with_a_gap_keep_the_gap():
    gap = 1.5 * VOXEL
    boards = join(
        box((0.3, 0.05, 0.6), centre=(-0.15 - gap / 2, 0, 0)),
        box((0.3, 0.05, 0.6), centre=(0.15 + gap / 2, 0, 0)),
    )
    surface = sharp_isosurface(boards, RESOLUTION)
    ray = np.array([[-0.2, 0.004, 0.01]])
    wall = []
    for direction, start in (([1.0, 0, 0], ray), ([-1.0, 0, 0], -ray * [1, -1, -1])):
        distance, _ = surface.caster.first_crossing(start, np.array([direction]))
        wall.append(start[0, 0] + direction[0] * distance[0])
    assert wall[1] - wall[0] == pytest.approx(gap, abs=0.05 * VOXEL)


def test_the_encoding_is_exact_and_short():
    solid = CASES["turned"]
    values, _ = distance_grid(*solid, RESOLUTION)
    features = find_features(values, *solid)
    stream = pack_features(features)
    assert stream.nbytes < 0.6 * (5 * len(features.edges) + 7 * len(features.cells))
    again = unpack_features(stream, features.counts, RESOLUTION)
    for name, value in vars(features).items():
        np.testing.assert_array_equal(getattr(again, name), value)
        assert getattr(again, name).dtype == value.dtype


def features_of(**lists):
    numbers, places, points = np.zeros(0, np.int64), np.zeros(0, np.uint8), np.zeros((0, 3), np.uint8)
    empty = {"edges": numbers, "places": places, "cells": numbers, "points": points}
    return Features(**empty | {"sheets": numbers, "moved": numbers, "offsets": points} | lists)


def test_streams_of_another_length_or_order_are_refused():
    points = np.zeros((2, 3), np.uint8)
    stream = pack_features(features_of(cells=np.array([3, 9]), points=points))
    with pytest.raises(ValueError, match="expected 21"):
        unpack_features(stream, {"cells": 3}, 4)
    with pytest.raises(ValueError, match="expected 7"):
        unpack_features(stream, {"cells": 1}, 4)
    with pytest.raises(ValueError, match="outside the grid"):
        unpack_features(stream, {"cells": 2}, 2)
    twice = pack_features(features_of(cells=np.array([3, 3]), points=points))
    with pytest.raises(ValueError, match="out of order"):
        unpack_features(twice, {"cells": 2}, 4)
    beyond = pack_features(features_of(sheets=np.array([3, 64])))
    with pytest.raises(ValueError, match="outside the grid"):
        unpack_features(beyond, {"sheets": 2}, 4)
    for on_border in (23, 20, 5, 29, 53):
        stream = pack_features(features_of(sheets=np.array([on_border])))
        with pytest.raises(ValueError, match="leave the grid"):
            unpack_features(stream, {"sheets": 1}, 4)
    within = pack_features(features_of(sheets=np.array([21, 42])))
    np.testing.assert_array_equal(unpack_features(within, {"sheets": 2}, 4).sheets, [21, 42])


def test_features_of_no_surface_do_no_harm():
    """A file may claim anything: points in cells without faces are ignored."""
    values, band = distance_grid(*CASES["turned"], RESOLUTION)
    rng = np.random.default_rng(0)
    cells = np.unique(rng.integers(0, RESOLUTION**3, 5000))
    edges = np.unique(rng.integers(0, 3 * RESOLUTION**3, 5000))
    points, places = rng.integers(0, 256, (len(cells), 3)), rng.integers(0, 256, len(edges))
    moved = np.unique(rng.integers(0, 3 * RESOLUTION**3, 5000))
    offsets = rng.integers(0, 256, (len(moved), 3)).astype(np.uint8)
    sheets = np.unique(rng.integers(1, RESOLUTION - 1, (300, 3)) @ [RESOLUTION**2, RESOLUTION, 1])
    lists = edges, places.astype(np.uint8), cells, points.astype(np.uint8), sheets, moved, offsets
    features = Features(*lists)
    surface = Isosurface(DistanceGrid(values, band, features))
    assert is_closed(surface.faces)
    assert np.isfinite(surface.shading.normals).all()
    apart = distances(CASES["turned"], surface)
    assert apart.max() < 3
