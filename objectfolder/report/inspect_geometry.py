"""Inspections of normalize and voxelize: the meshes, the solid and the distance grid."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import igl
import numpy as np
import trimesh

from objectfolder.base.arrays import read_npz
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.figures import page, page_rows, save_page, show_image
from objectfolder.base.io import atomic, read_json
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.ply import read_surface
from objectfolder.mesh.reading.load import AS_STORED, load_mesh
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.mesh.topology import signed_volume
from objectfolder.report.inspect_scene import CLAY, VIEW_FROM, add_textured, draw_scene, hexahedra, triangles
from objectfolder.report.inspection import Inspection, kilobytes, picture_path, require, span
from objectfolder.sound.fem.cutcell import CutCells
from objectfolder.sound.fem.elements import solid_from_arrays
from objectfolder.workspace.layout import Build

if TYPE_CHECKING:
    import pyvista
    from matplotlib.figure import SubFigure

FULL = 0.999  # fill from which a cell counts as full
CUT_FROM = (0.35, -1.0, 0.45)  # view direction onto the cut through y = 0


def inspect_normalize(build: Build) -> Inspection:
    """Inspect the visual mesh and the closed surface, whole and cut open."""
    require(build, "normalize", build.visual, build.surface, build.normalize)
    report = read_json(build.normalize)
    scale, far = report["scale_m"], report["deviation_max_m"]
    visual = load_mesh(build.visual, "y", AS_STORED)  # as render_views reads it
    vertices, faces = read_surface(build.surface)
    sides = np.ptp(vertices, axis=0) * scale * 1000
    mesh = trimesh.Trimesh(vertices * scale, faces, process=False)
    edges = mesh.edges_unique_length
    # A closed surface has 3/2 edges per face; Euler's formula then counts its handles.
    holes = report["components"] + report["cavities"] - (len(vertices) - len(faces) / 2) / 2
    table = [
        ("size", f"{sides[0]:.2f} x {sides[1]:.2f} x {sides[2]:.2f} mm (x, y, z)"),
        ("source", f"longest side {report['source_size']:.6g} of its units, {report['source_up']} up"),
        ("closed by", _history(report["rungs"])),
        *[("warning", warning) for warning in report["warnings"]],
        ("deviation from source", f"max {far * 1e6:.3g} µm, mean {report['deviation_mean_m'] * 1e6:.3g} µm"),
        ("volume", f"{report['volume_m3'] * 1e6:.4f} cm³"),
        ("area", f"{mesh.area * 1e4:.3f} cm²"),
        ("surface", f"{len(vertices):,} vertices, {len(faces):,} faces, {_bodies(report)}"),
        ("holes through it", f"{holes:g}"),
        ("edges", f"{span(edges * 1000, 'mm')}, median {np.median(edges) * 1000:.4g} mm"),
        ("visual mesh", f"{len(visual.faces):,} faces, {_appearance(visual)}"),
        ("visual to surface", f"at most {_distance(visual, vertices, faces) * scale * 1000:.3g} mm apart"),
        ("files", kilobytes(build.visual, build.surface, build.normalize)),
    ]
    picture = _normalize_picture(build, visual, vertices, faces, sides)
    return Inspection(f"normalize@{build.key}", table, [picture])


def inspect_voxelize(build: Build) -> Inspection:
    """Inspect the cut cells, coloured by fill, and slices through the distance grid."""
    cells, scale = _solid(build)
    require(build, "voxelize", build.sdf)
    vertices, faces = read_surface(build.surface)
    grid = DistanceGrid.from_arrays(read_npz(build.sdf, "values", "band"))
    fill, volume = cells.fill, signed_volume(vertices, faces)
    inside = grid.values < 0
    inside_volume = np.count_nonzero(inside) * grid.spacing**3
    in_band = np.count_nonzero(np.abs(grid.values) < 127)
    counts, edges = np.histogram(fill, np.linspace(0, 1, 6))
    width, cubic = cells.cell_size * scale * 1000, scale**3 * 1e6  # mm; cm³ per unit
    error, excess = cells.volume_error, inside_volume / volume - 1
    table = [
        ("cells", f"{len(cells.index):,} of {cells.resolution}^3, {width:.3f} mm wide"),
        ("occupancy", f"{' x '.join(map(str, cells.occupancy.shape[1:]))} Legendre moments per cell"),
        ("degrees of freedom", f"{cells.degrees_of_freedom:,}"),
        ("full cells", f"{np.count_nonzero(fill >= FULL):,}"),
        ("cut cells", f"{np.count_nonzero(fill < FULL):,}, fill {span(fill[fill < FULL])}"),
        *(
            (f"  fill {low:.1f} to {high:.1f}", f"{count:,}")
            for low, high, count in zip(edges[:-1], edges[1:], counts)
        ),
        ("volume of the surface", f"{volume * cubic:.4f} cm³"),
        ("volume of the cells", f"{cells.volume * cubic:.4f} cm³ ({error:+.3%} before it was corrected)"),
        ("dropped pieces", f"{cells.dropped_volume:.4%} of the volume"),
        ("distance grid", f"{len(grid.values)}^3 samples, {grid.spacing * scale * 1000:.4f} mm apart"),
        ("distance band", f"±{grid.band * scale * 1000:.4f} mm, {in_band:,} samples in it"),
        ("inside samples", f"{inside.sum():,}: {inside_volume * cubic:.4f} cm³ ({excess:+.3%})"),
        ("files", f"solid {kilobytes(build.solid)}, sdf {kilobytes(build.sdf)}"),
    ]
    picture = _voxelize_picture(build, cells, grid, scale)
    return Inspection(f"voxelize@{build.key}", table, [picture])


def export_vtu(build: Build) -> Path:
    """Write the solid as hexahedra in the object frame (metres), with ``fill`` per cell, for ParaView."""
    cells, scale = _solid(build)
    grid = hexahedra(cells.index, cells.lower * scale, cells.cell_size * scale, cells.width)
    grid.cell_data["fill"] = cells.fill
    path = build.inspections / "solid.vtu"
    with atomic(path) as temporary:
        grid.save(temporary)
    return path


def _solid(build: Build) -> tuple[CutCells, float]:
    """Read the cut cells, and the scale in metres."""
    require(build, "voxelize", build.solid, build.surface, build.normalize)
    cells = solid_from_arrays(read_npz(build.solid, "kind"))
    if not isinstance(cells, CutCells):
        other = f"{build.key}: solid.npz holds {cells.name}, but only cut cells can be inspected"
        raise ObjectFolderError(f"{other}: set voxelize.element to cut_cell_hex20")
    return cells, read_json(build.normalize)["scale_m"]


def _normalize_picture(
    build: Build, visual: TexturedMesh, vertices: np.ndarray, faces: np.ndarray, sides: np.ndarray
) -> Path:
    surface = triangles(vertices, faces)
    opened = surface.clip(normal="-y", origin=(0, 0, 0))
    lines: dict[str, Any] = {"show_edges": True, "edge_color": "#34495e", "line_width": 0.5}
    red: dict[str, Any] = {"backface_params": {"color": "#d9534f"}}
    images = {
        "visual.glb": draw_scene(lambda plotter: add_textured(plotter, visual)),
        f"surface.ply: {len(faces):,} faces": draw_scene(
            lambda plotter: plotter.add_mesh(surface, color=CLAY, **lines)
        ),
        "cut at y = 0; red is the inside": draw_scene(
            lambda plotter: plotter.add_mesh(opened, color=CLAY, **red), CUT_FROM
        ),
    }
    title = f"normalize@{build.key}: {sides[0]:.1f} x {sides[1]:.1f} x {sides[2]:.1f} mm (x, y, z; z up)"
    figure = page(15, 5.6, title)
    for axes, (name, image) in zip(figure.subplots(1, 3), images.items()):
        show_image(axes, image, name)
    return save_page(figure, picture_path(build, "normalize"))


def _voxelize_picture(build: Build, cells: CutCells, grid: DistanceGrid, scale: float) -> Path:
    from matplotlib import colormaps

    middle = (cells.index[:, 1].min() + cells.index[:, 1].max()) / 2
    figure = page(14, 9.5, f"voxelize@{build.key}")
    top, bottom = page_rows(figure, 1, 1)
    left, centre, right = top.subplots(1, 3)
    for axes, keep, view_from, name in (
        (left, slice(None), VIEW_FROM, "solid.npz: cells by fill"),
        (centre, cells.index[:, 1] >= middle, CUT_FROM, "the half behind y = 0"),
    ):
        part = hexahedra(cells.index[keep], cells.lower, cells.cell_size, cells.width[keep])
        part.cell_data["fill"] = cells.fill[keep]
        show_image(axes, draw_scene(partial(_add_cells, part), view_from), name)
    _, bins, bars = right.hist(cells.fill, bins=20, range=(0, 1))
    for low, bar in zip(bins, bars.patches):
        bar.set_facecolor(colormaps["viridis"](low + 0.025))
    right.set(title=f"fill of {len(cells.index):,} cells", ylabel="cells")
    right.set_xlabel("fill (colour as on the left)")
    _show_slices(bottom, grid, scale)
    return save_page(figure, picture_path(build, "voxelize"))


def _add_cells(cells: "pyvista.UnstructuredGrid", plotter: "pyvista.Plotter") -> None:
    look: dict[str, Any] = {"cmap": "viridis", "clim": (0, 1), "show_edges": True, "line_width": 0.5}
    plotter.add_mesh(cells, scalars="fill", show_scalar_bar=False, ambient=0.45, diffuse=0.6, **look)


def _show_slices(figure: "SubFigure", grid: DistanceGrid, scale: float) -> None:
    """Show the middle slices of the distance grid; axes in mm."""
    count = len(grid.values)
    half, limit = BOUND * scale * 1000, grid.band * scale * 1000
    axis = np.linspace(-half, half, count)
    panels = figure.subplots(1, 3)
    for normal, axes in enumerate(panels):
        across, up = (n for n in range(3) if n != normal)
        distance = grid.values.take(count // 2, axis=normal).T * (limit / 127)
        where: dict[str, Any] = {"origin": "lower", "extent": (-half, half, -half, half)}
        image = axes.imshow(distance, cmap="RdBu", vmin=-limit, vmax=limit, **where)
        if distance.min() < 0 < distance.max():
            axes.contour(axis, axis, distance, levels=[0], colors="black", linewidths=0.8)
        axes.set(title=f"sdf.npz: slice {'xyz'[normal]} = 0")
        axes.set(xlabel=f"{'xyz'[across]} [mm]", ylabel=f"{'xyz'[up]} [mm]")
    figure.colorbar(image, ax=panels, label="signed distance [mm]", shrink=0.9)


def _distance(visual: TexturedMesh, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the largest distance of a visual vertex from the surface; large if their frames differ."""
    points = np.ascontiguousarray(visual.vertices[np.unique(visual.faces)])
    return float(np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0].max()))


def _appearance(mesh: TexturedMesh) -> str:
    look = "no colour" if mesh.vertex_colors is None else "colours at vertices"
    if mesh.texture is not None:
        look = f"texture {mesh.texture.shape[1]}x{mesh.texture.shape[0]}"
    known = {"roughness": mesh.roughness, "metallic": mesh.metallic}
    return ", ".join([look, *(f"{name} {value:.3g}" for name, value in known.items() if value is not None)])


def _history(rungs: list[dict[str, Any]]) -> str:
    """Describe how a surface was closed, with the change of volume by each step."""
    lines = []
    for rung in rungs:
        before, after = rung["volume_before_m3"], rung["volume_after_m3"]
        change = f" (volume {after / before - 1:+.2%})" if before and after and before != after else ""
        lines.append(f"{rung['name']}: {rung['detail']}{change}")
    return "; ".join(lines)


def _bodies(report: dict[str, Any]) -> str:
    bodies, cavities = report["components"], report["cavities"]
    text = "1 body" if bodies == 1 else f"{bodies} bodies"
    return text + (f", {cavities} cavit{'y' if cavities == 1 else 'ies'}" if cavities else "")
