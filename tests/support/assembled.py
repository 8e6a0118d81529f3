"""Checks for all assembled objects."""

from typing import Any

import igl
import numpy as np
import trimesh


def welded(mesh: Any) -> trimesh.Trimesh:
    """The surface with vertices merged by exact position."""
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(vertices, index.ravel()[mesh.faces], process=False)


def check_solid(mesh: Any) -> None:
    """Check for one closed manifold component, wound once, that stands on z = 0."""
    surface = welded(mesh)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.body_count == 1
    assert surface.volume > 0
    edges = np.sort(surface.edges, axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2), "each edge has two faces"
    # A manifold vertex has one fan: as many edges as faces about it, all connected; split fans add up.
    assert surface.euler_number % 2 == 0
    assert abs(mesh.bounds[0, 2]) < 1e-9
    rng = np.random.default_rng(0)
    points = mesh.bounds[0] + rng.random((200, 3)) * np.ptp(mesh.bounds, axis=0)
    winding = np.asarray(
        igl.winding_number(np.array(surface.vertices), np.array(surface.faces, np.int64), points)
    )
    np.testing.assert_allclose(winding, np.round(winding), atol=1e-6)
    assert set(np.round(winding)) <= {0.0, 1.0}


def check_charts(mesh: Any) -> None:
    """Check that no face spans a seam, is mirrored, or is far from the common texel density."""
    assert mesh.uv is not None
    assert mesh.uv.min() >= 0
    assert mesh.uv.max() <= 1
    corners, uv = mesh.vertices[mesh.faces], mesh.uv[mesh.faces]
    (a, b), (p, q) = np.diff(corners, axis=1).swapaxes(0, 1), np.diff(uv, axis=1).swapaxes(0, 1)
    area = np.linalg.norm(np.cross(a, b), axis=1) / 2
    uv_area = (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]) / 2
    share = area / area.sum()
    density = np.sqrt(np.abs(uv_area) / np.maximum(area, 1e-300))
    median = np.median(density)
    assert share[(density < median / 2.2) | (density > median * 2.2)].sum() < 0.01
    assert share[uv_area <= 0].sum() < 1e-3
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    uv_longest = np.linalg.norm(uv - np.roll(uv, 1, axis=1), axis=2).max(1)
    assert np.all(uv_longest <= 2.2 * median * longest + 1e-9)


def check_charts_apart(mesh: Any, texels: int = 400) -> None:
    """Check that no texel belongs to two places of the surface: charts cover exactly their own area."""
    u, v = (k.ravel() for k in np.meshgrid(*[(np.arange(texels) + 0.5) / texels] * 2))
    flat = np.column_stack([mesh.uv, np.zeros(len(mesh.uv))])
    layout = trimesh.Trimesh(flat, mesh.faces, process=False)
    rays = np.column_stack([u, v, np.ones_like(u)])
    covered = (layout.ray.intersects_first(rays, np.broadcast_to([0, 0, -1.0], rays.shape)) >= 0).mean()
    p, q = np.diff(mesh.uv[mesh.faces], axis=1).swapaxes(0, 1)
    total = np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum() / 2
    assert abs(total - covered) < 0.01


def check_texture(mesh: Any, colours: int = 15) -> None:
    """Check that the surface shows a painted texture."""
    assert mesh.texture.dtype == np.uint8
    height, width = mesh.texture.shape[:2]
    texel = np.clip(np.round(mesh.uv * [width, height] - 0.5), 0, [width - 1, height - 1]).astype(int)
    shown = mesh.texture[::-1][texel[:, 1], texel[:, 0]]
    assert len(np.unique(shown, axis=0)) > colours
    assert 0 < mesh.roughness < 1


def crossings(mesh: Any, origin: tuple, direction: tuple) -> np.ndarray:
    """Distances from `origin`, sorted, at which a ray crosses the surface."""
    surface = welded(mesh)
    hits, _, _ = surface.ray.intersects_location([origin], [direction], multiple_hits=True)
    return np.unique(np.round(np.sort((hits - origin) @ np.asarray(direction, float)), 9))
