"""Inspections of render_views and render_touch: the images for training and evaluation."""

from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from objectfolder.base.arrays import read_npz
from objectfolder.base.figures import page, page_columns, page_rows, save_page, show_image
from objectfolder.base.io import read_json
from objectfolder.mesh.ply import read_surface
from objectfolder.report.inspect_scene import CLAY, VIEW_FROM, draw_scene, triangles
from objectfolder.report.inspection import Inspection, kilobytes, picture_path, require, span
from objectfolder.vision.cameras import image_intrinsics, project
from objectfolder.vision.color import MIN_FOREGROUND_ALPHA, find_lit_foreground, on_white
from objectfolder.workspace.layout import SPLITS, Build

if TYPE_CHECKING:
    import pyvista
    from matplotlib.axes import Axes

COLORS = {"train": ("blue", "#2563eb"), "val": ("orange", "#f59e0b"), "test": ("green", "#16a34a")}


def inspect_render_views(build: Build) -> Inspection:
    """Inspect the views and tiles: images with their lights, and directions of cameras and lights."""
    paths = {split: build.views(split) for split in SPLITS}
    require(build, "render_views", *paths.values(), build.views_sheet)
    names = ("rgba", "camera_to_world", "light", "focal", "center", "renderer")
    splits = {split: read_npz(path, *names) for split, path in paths.items()}
    table = [row for split in SPLITS for row in _view_rows(split, splits[split], kilobytes(paths[split]))]
    return Inspection(f"render_views@{build.key}", table, [_views_picture(build, splits), build.views_sheet])


def inspect_render_touch(build: Build) -> Inspection:
    """Inspect the contacts: tactile images with their depths, and points on the surface."""
    paths = {split: build.touch(split) for split in SPLITS}
    require(build, "render_touch", *paths.values(), build.touch_sheet, build.surface, build.normalize)
    names = ("images", "points", "normals", "depths", "angles", "obstructed")
    splits = {split: read_npz(path, *names) for split, path in paths.items()}
    table = [row for split in SPLITS for row in _contact_rows(split, splits[split], kilobytes(paths[split]))]
    return Inspection(f"render_touch@{build.key}", table, [_touch_picture(build, splits), build.touch_sheet])


def _view_rows(split: str, views: dict[str, np.ndarray], size: str) -> list[tuple[str, str]]:
    rgba = views["rgba"].astype(np.float32)
    covered, lit = rgba[..., 3] >= MIN_FOREGROUND_ALPHA, find_lit_foreground(rgba)
    broken = np.count_nonzero(~np.isfinite(rgba))
    middle, share = np.array(rgba.shape[2:0:-1]) / 2, lit.sum() / max(covered.sum(), 1)
    kind = "views" if (views["center"] == middle).all() else "tiles"
    return [
        (split, f"{len(rgba)} {kind}, {_size(rgba)} pixels RGBA {views['rgba'].dtype}, {size}"),
        ("  radiance", span(rgba[..., :3]) + (f", {broken} values are not finite" if broken else "")),
        ("  pixels", f"object covers {covered.mean():.1%} of the image; {share:.1%} of that is lit"),
        ("  camera distance", span(np.linalg.norm(views["camera_to_world"][:, :3, 3], axis=1), "sizes")),
        ("  light distance", span(np.linalg.norm(views["light"], axis=1), "sizes")),
        ("  focal length", f"{float(views['focal']):g} pixels"),
        ("  renderer", str(views["renderer"])),
    ]


def _contact_rows(split: str, contacts: dict[str, np.ndarray], size: str) -> list[tuple[str, str]]:
    images = contacts["images"]
    return [
        (split, f"{len(images)} contacts, {_size(images)} pixels RGB {images.dtype}, {size}"),
        ("  grey levels", f"{span(images)}, mean {images.mean():.1f}"),
        ("  press depths", span(contacts["depths"] * 1000, "mm")),
        ("  angles", span(np.degrees(contacts["angles"]), "°")),
        ("  from the centre", span(np.linalg.norm(contacts["points"], axis=1) * 1000, "mm")),
        ("  obstructed", f"{np.mean(contacts['obstructed'] > 0):.1%} of the contacts"),
    ]


def _views_picture(build: Build, splits: dict[str, dict[str, np.ndarray]]) -> Path:
    figure = page(15, 13, f"render_views@{build.key}")
    top, bottom = page_rows(figure, 3, 1.4)
    top.suptitle(
        "test views on white, best lit first; yellow: the light (filled: before the object, ring: "
        "behind it), at the border if it is outside"
    )
    _show_views(top.subplots(3, 6), splits["test"])
    directions = bottom.subplots(1, 2)
    for axes, name in zip(directions, ("camera", "light")):
        for split, views in splits.items():
            position = views["camera_to_world"][:, :3, 3] if name == "camera" else views["light"]
            axes.scatter(*_angles(position), s=14, color=COLORS[split][1], label=f"{split} ({len(position)})")
        axes.set(title=f"{name} directions (equal areas)", xlabel="azimuth [°]", ylabel="sine of elevation")
        axes.set(xlim=(-180, 180), ylim=(-1, 1))
        axes.grid(alpha=0.3)
    bottom.legend(*directions[0].get_legend_handles_labels(), loc="outside right center")
    return save_page(figure, picture_path(build, "render_views"))


def _touch_picture(build: Build, splits: dict[str, dict[str, np.ndarray]]) -> Path:
    figure = page(15, 10.5, f"render_touch@{build.key}")
    left, right = page_columns(figure, 2.4, 1)
    left.suptitle("training contacts: press depth [mm]; red: the object reaches behind the gel")
    _show_touches(left.subplots(4, 8).flat, splits["train"])
    surface, scale = triangles(*read_surface(build.surface)), read_json(build.normalize)["scale_m"]

    def add(plotter: "pyvista.Plotter") -> None:
        plotter.add_mesh(surface, color=CLAY)
        for split, contacts in splits.items():
            if len(contacts["points"]):
                look: dict[str, Any] = {
                    "color": COLORS[split][1],
                    "point_size": 14,
                    "render_points_as_spheres": True,
                }
                plotter.add_points(contacts["points"] / scale, **look)

    right.suptitle(", ".join(f"{split} {name}" for split, (name, _) in COLORS.items()))
    x, y, z = VIEW_FROM
    for axes, view_from in zip(right.subplots(2, 1), (VIEW_FROM, (-x, -y, -z))):
        show_image(axes, draw_scene(add, view_from))
    return save_page(figure, picture_path(build, "render_touch"))


def _show_views(panels: np.ndarray, views: dict[str, np.ndarray]) -> None:
    rgba = views["rgba"]
    intrinsics = image_intrinsics(views)
    azimuth, elevation = _angles(views["camera_to_world"][:, :3, 3])
    best_lit = np.argsort(-find_lit_foreground(rgba).mean((1, 2)), kind="stable").tolist()
    for axes, index in zip_longest(panels.flat, best_lit[: panels.size]):
        axes.set_axis_off()
        if index is None:
            continue
        image = on_white(torch.from_numpy(rgba[index].astype(np.float32))).numpy()
        pose, light = views["camera_to_world"][index], views["light"][index]
        above = np.degrees(np.arcsin(elevation[index]))
        show_image(axes, image, f"az {azimuth[index]:.0f}°, el {above:.0f}°")
        axes.set_axis_on()  # a frame shows to which view a light at the border belongs
        axes.set(xticks=[], yticks=[])
        axes.autoscale(False)  # a light at the border of a tile must not widen it
        place, depth = project(light[None], pose, intrinsics[index])
        before = depth[0] < np.linalg.norm(pose[:3, 3])
        margin = rgba.shape[1] / 64
        column, row = np.clip(place[0], margin, np.array([rgba.shape[2], rgba.shape[1]]) - margin)
        axes.scatter(column, row, s=45, facecolors="#facc15" if before else "none", edgecolors="#a16207")


def _show_touches(panels: Iterable["Axes"], contacts: dict[str, np.ndarray]) -> None:
    for index, axes in enumerate(panels):
        axes.set_axis_off()
        if index < len(contacts["images"]):
            blocked = contacts["obstructed"][index] > 0
            show_image(axes, contacts["images"][index])
            depth = f"{contacts['depths'][index] * 1000:.2f}"
            axes.set_title(depth, fontsize=10, color="#dc2626" if blocked else "black")


def _angles(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return azimuth in degrees and sine of elevation of (N, 3) positions."""
    x, y, z = positions.T
    return np.degrees(np.arctan2(y, x)), z / np.linalg.norm(positions, axis=1)


def _size(images: np.ndarray) -> str:
    return f"{images.shape[2]}x{images.shape[1]}"
