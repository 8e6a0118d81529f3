"""A wooden die with rounded edges and drilled pips, in metres, standing on z = 0."""

import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.atlas import Chart, pack_charts
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.revolution import arc, disc
from objectfolder.shapes.solid import Patch, bake_mesh, weld_patches
from objectfolder.shapes.texture import over, rgb, smoothstep, wood

SEED = 6
PIP_RADIUS = 0.088  #: of the dent's rim, in edges of the die
PIP_DEPTH = 0.036  #: in edges of the die
PIP_PITCH = 0.24  #: from the middle of a face to its outer pips, in edges of the die
FLAT_CELLS, FILLET_CELLS = 18, 5  #: across the flat of a face, and from there to the middle of an edge

#: Right, up and outward axis of each face, as columns; opposite faces sum to seven.
FACES: dict[int, np.ndarray] = {
    1: np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]]).T,
    2: np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]).T,
    3: np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]).T,
    4: np.array([[0, -1, 0], [0, 0, 1], [-1, 0, 0]]).T,
    5: np.array([[-1, 0, 0], [0, 0, 1], [0, 1, 0]]).T,
    6: np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]]).T,
}
#: Places of the pips in units of the pitch.
PIPS: dict[int, list[tuple[int, int]]] = {
    1: [(0, 0)],
    2: [(-1, -1), (1, 1)],
    3: [(-1, 1), (0, 0), (1, -1)],
    4: [(-1, -1), (-1, 1), (1, -1), (1, 1)],
    5: [(-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0)],
    6: [(-1, -1), (-1, 0), (-1, 1), (1, -1), (1, 0), (1, 1)],
}


@generator()
def die(order: Order, edge: Size = 0.05, fillet: Size = 0.006) -> TexturedMesh:
    """Build a wooden die.

    One closed surface of genus 0; x and y from -edge / 2 to edge / 2, z from 0 to edge.

    Parameters
    ----------
    edge : float
        Edge of the bounding cube, m.
    fillet : float
        Radius of the rounded edges and corners, m.
    """
    room = 0.5 - PIP_PITCH - 1.08 * PIP_RADIUS
    order.between(0.01 * edge, room * edge, "so that the pips stay on the flat", fillet=fillet)

    block, charts = [], []
    lift = np.array([0, 0, edge / 2])
    flat, border = edge / 2 - fillet, edge / 2 - fillet + fillet * np.pi / 4
    pips = _pip_centres(edge)

    def paint(points: np.ndarray) -> np.ndarray:
        nearest = np.min([np.sum((points - centre) ** 2, axis=1) for centre in pips], axis=0)
        distance = np.sqrt(nearest) / (PIP_RADIUS * edge)
        grain = wood(points - lift, edge, SEED)
        burnt = over(grain, grain * rgb("c9a98c"), 0.7 * smoothstep(1.22, 1.0, distance))
        return over(burnt, rgb("2a1a12") * (0.8 + 0.4 * grain), smoothstep(1.02, 0.97, distance))

    for k, axes in enumerate(FACES.values()):

        def locate(xy: np.ndarray, axes: np.ndarray = axes) -> np.ndarray:
            return lift + _rounded_face(xy - border, flat, fillet) @ axes.T

        rounded = np.linspace(-border, -flat, FILLET_CELLS, endpoint=False)
        level = np.linspace(-flat, flat, FLAT_CELLS, endpoint=False)
        lines = np.concatenate([rounded, level, np.linspace(flat, border, FILLET_CELLS + 1)])
        n = len(lines)
        xy = np.stack(np.meshgrid(lines, lines, indexing="ij"), 2).reshape(-1, 2) + border
        i, j = (m.ravel() for m in np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij"))
        a, b = i * n + j, (i + 1) * n + j
        faces = np.concatenate([np.stack([a, b, b + 1], 1), np.stack([a, b + 1, a + 1], 1)])
        block.append(Patch(locate(xy), faces, xy, k))
        charts.append(Chart((2 * border, 2 * border), locate, paint))

    atlas = pack_charts(charts, order.texture_size)
    solid = weld_patches(block, atlas)
    for k, (value, axes) in enumerate(FACES.items()):
        for place in PIPS[value]:
            solid -= weld_patches(_drill(edge, np.multiply(place, PIP_PITCH * edge), axes, border, k), atlas)
    return bake_mesh(solid, atlas, roughness=0.55)


def _rounded_face(xy: np.ndarray, flat: float, fillet: float) -> np.ndarray:
    """Map `xy` (N, 2), arc lengths from the centre, to the +z face of a rounded cube; (N, 3).

    Edges are split at 45 degrees, where the maps of both faces have the same spacing.
    """
    core = np.clip(xy, -flat, flat)
    angle = np.clip((xy - core) / fillet, -1.4, 1.4)
    direction = np.concatenate([np.tan(angle), np.ones((len(xy), 1))], 1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.concatenate([core, np.full((len(xy), 1), flat)], 1) + fillet * direction


def _pip_centres(edge: float) -> np.ndarray:
    """Return the centres (21, 3) of the pips' rims, m."""
    places = [(axes, x, y) for value, axes in FACES.items() for x, y in PIPS[value]]
    pitch, half = PIP_PITCH * edge, edge / 2
    return np.array([axes @ [pitch * x, pitch * y, half] + [0, 0, half] for axes, x, y in places])


def _drill(edge: float, place: np.ndarray, axes: np.ndarray, border: float, chart: int) -> list[Patch]:
    """Build the closed tool that cuts one pip: a spherical cap below the face, a flat lid above it.

    It is projected to the chart of the face, so that the rim of the pip has no seam.
    """
    rim, depth = PIP_RADIUS * edge, PIP_DEPTH * edge
    ball = (rim**2 + depth**2) / (2 * depth)
    opening = np.arcsin(rim / ball)
    # Seven steps to the rim and one past it, above the face.
    cap = arc((0.0, ball - depth), ball, -np.pi / 2, -np.pi / 2 + opening * 8 / 7, 8)
    cap[0, 0] = 0.0
    lid = np.array([cap[-1], [0.0, cap[-1, 1]]])
    tool = []
    for profile in (cap, lid):
        patch, _ = disc(profile, chart, lambda points: points, segments=32)
        local = patch.vertices + np.append(place, edge / 2)
        xy = local[:, :2] + border
        tool.append(Patch(local @ axes.T + [0, 0, edge / 2], patch.faces, xy, chart))
    return tool
