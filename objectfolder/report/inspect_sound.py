"""Inspections of modal and radiation: the modes, how a strike sounds, and in which directions it is heard."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from objectfolder.base.arrays import read_npz, read_safetensors
from objectfolder.base.figures import page, page_rows, save_page, show_image
from objectfolder.base.io import read_json
from objectfolder.mesh.ply import read_surface
from objectfolder.report.comparison import SHOWN_RATE, show_sound
from objectfolder.report.inspect_scene import draw_scene, triangles
from objectfolder.report.inspection import Inspection, kilobytes, picture_path, require, span
from objectfolder.sound.gains_net import energy_weights
from objectfolder.sound.radiation.farfield import FarField, unpack_far_field
from objectfolder.sound.radiation.harmonics import real_harmonics
from objectfolder.sound.synthesis import gains, sinusoid_bank
from objectfolder.workspace.layout import Build

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

LISTED = 12  # modes in the table
DRAWN = 6  # mode shapes in the picture
DISPLACEMENT = 0.08  # largest drawn displacement, fraction of the object's size
MAPS = 6  # modes whose directivity is drawn
RANGE = 30.0  #: of a directivity, dB
_HEIGHTS, _TURNS = 46, 91  # directions of a map
LN_1000 = float(np.log(1000))  # 60 dB in amplitude


def inspect_modal(build: Build) -> Inspection:
    """Inspect the modes: frequencies and decay, first mode shapes, and the spectrogram of one strike."""
    require(build, "modal", build.modes, build.modal, build.surface)
    report = read_json(build.modal)
    modes = read_npz(build.modes, "points", "split", "eigenvalues", "damping", "damped_frequency", "shapes")
    natural, damping = np.sqrt(modes["eigenvalues"]), modes["damping"]
    frequency, decay = modes["damped_frequency"] / (2 * np.pi), LN_1000 / damping
    count, total = len(damping), report["count_below_max_frequency"]
    errors = report.get("discretisation_error") or []
    splits = np.bincount(modes["split"], minlength=3)
    quality = natural / (2 * damping)
    listed = []
    for i in range(min(count, LISTED)):
        error = f", estimated error {errors[i]:.2%}" if i < len(errors) else ""
        text = f"{frequency[i]:9.2f} Hz, T60 {decay[i]:.3g} s, Q {quality[i]:.4g}{error}"
        listed.append((f"  mode {i + 1}", text))
    worst = f"of the lowest {len(errors)} frequencies: up to {max(errors):.2%}" if errors else "not known"
    below = "not counted" if total is None else f"{total}"
    table = [
        ("material", f"{report['material']}, {report['mass_kg'] * 1000:.4g} g"),
        ("model", f"{report['element']}, resolution {report['resolution']}, {report['elements']:,} elements"),
        ("degrees of freedom", f"{report['degrees_of_freedom']:,}"),
        ("modes", f"{count}, of which {report['modes_below_8_kHz']} below 8 kHz"),
        (f"below {report['max_frequency_hz'] / 1000:g} kHz", below + " (truncated)" * report["truncated"]),
        ("frequencies", span(frequency, "Hz", ",.0f")),
        ("estimated error", worst),
        ("decay times T60", span(decay, "s")),
        *listed,
        *([("  ...", f"{count - LISTED} more")] if count > LISTED else []),
        ("largest residual", f"{report['residual_max']:.2g}"),
        ("rigid modes", f"at most {max(report['rigid_hz'], default=0.0):.3g} Hz (0 in theory)"),
        ("dropped pieces", f"{report['dropped_volume_share']:.4%} of the volume"),
        ("points", f"{len(modes['points']):,}: train {splits[0]:,}, val {splits[1]:,}, test {splits[2]:,}"),
        *([("solved", "no: scaled from an earlier solve")] if report.get("reused") else []),
        ("files", kilobytes(build.modes, build.modal)),
    ]
    pictures = [_modal_picture(build, modes, frequency, decay, report["scale_m"])] if count else []
    return Inspection(f"modal@{build.key}", table, pictures)


def _modal_picture(
    build: Build, modes: dict[str, np.ndarray], frequency: np.ndarray, decay: np.ndarray, scale: float
) -> Path:
    vertices, faces = read_surface(build.surface)
    near = cKDTree(modes["points"]).query(vertices)[1]  # the vertex itself, unless its surface has too many
    figure = page(15, 13.5, f"modal@{build.key}: first mode shapes, exaggerated (colour: amplitude)")
    top, bottom = page_rows(figure, 2, 1)
    for mode, axes in enumerate(top.subplots(2, DRAWN // 2).flat):
        axes.set_axis_off()
        if mode < len(frequency):
            image = _draw_shape(vertices, faces, modes["shapes"][near, :, mode])
            show_image(axes, image, f"mode {mode + 1}: {frequency[mode]:.1f} Hz, T60 {decay[mode]:.2g} s")
    left, right = bottom.subplots(1, 2)
    point, direction, sound = _loudest_strike(modes)
    place = np.array2string(modes["points"][point] * scale * 1000, precision=1, suppress_small=True)
    struck = f"struck at {place} mm along {'xyz'[direction]}"
    show_sound(left, sound, SHOWN_RATE, f"{struck}: loudest point (displacement)")
    right.scatter(frequency / 1000, decay, s=18)
    right.set(title=f"all {len(frequency)} modes", xlabel="frequency [kHz]", ylabel="decay time T60 [s]")
    right.set_yscale("log")
    right.grid(alpha=0.3, which="both")
    return save_page(figure, picture_path(build, "modal"))


def _draw_shape(vertices: np.ndarray, faces: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Draw the surface displaced by a mode shape (V, 3)."""
    amplitude = np.linalg.norm(shape, axis=1)
    largest = max(float(amplitude.max()), 1e-30)
    moved = triangles(vertices + shape * (DISPLACEMENT / largest), faces)
    moved.point_data["amplitude"] = amplitude / largest
    look: dict[str, Any] = {"cmap": "YlOrRd", "clim": (0, 1), "smooth_shading": True}
    return draw_scene(
        lambda plotter: plotter.add_mesh(moved, scalars="amplitude", show_scalar_bar=False, **look)
    )


def _loudest_strike(modes: dict[str, np.ndarray]) -> tuple[int, int, np.ndarray]:
    """Return the point and axis whose unit impulse gives the most energy, and its sound (samples,)."""
    tuning = modes["damped_frequency"], modes["damping"]
    energy = modes["shapes"].astype(np.float64) ** 2 @ energy_weights(*tuning)
    point, axis = (int(i) for i in np.unravel_index(energy.argmax(), energy.shape))
    damped, damping = map(torch.from_numpy, tuning)
    bank = sinusoid_bank(damped, damping, SHOWN_RATE)
    force = torch.eye(3)[axis][None]
    return point, axis, (gains(torch.from_numpy(modes["shapes"][[point]]), force) @ bank)[0].numpy()


def inspect_radiation(build: Build) -> Inspection:
    """Inspect the far fields: their detail, their power, and maps of the loudest modes."""
    require(build, "radiation", build.radiation, build.modes)
    tensors, header = read_safetensors(build.radiation)
    modes = read_npz(build.modes, "damped_frequency")
    hertz = modes["damped_frequency"] / (2 * np.pi)
    field = unpack_far_field(tensors, header["radius"])
    power = 10 * np.log10(np.maximum((abs(field.coefficients) ** 2).sum(1) / (4 * np.pi), 1e-30))
    rows = [
        ("modes", f"{len(hertz)}"),
        ("orders of harmonics", span(field.orders)),
        ("level at 1 m per unit of modal acceleration", span(power, "dB re 1 Pa")),
        ("ball that holds the surface", f"{header['radius']:.4f} of the longest side"),
        ("file", kilobytes(build.radiation)),
    ]
    figure = page(15, 9, f"radiation@{build.key}: levels of modes over directions")
    upper, lower = page_rows(figure, 2, 1)
    chosen = sorted({int(mode) for mode in np.linspace(0, len(hertz) - 1, MAPS) if len(hertz)})
    panels = upper.subplots(2, MAPS // 2)
    maps = [show_directivity(axes, field, n, f"{hertz[n]:.0f} Hz") for axes, n in zip(panels.flat, chosen)]
    if maps:
        upper.colorbar(maps[0], ax=panels, label="dB relative to the loudest direction")
    for axes in panels.flat[len(maps) :]:
        axes.set_axis_off()
    axes = lower.subplots()
    axes.scatter(hertz / 1000, power, s=18)
    axes.set(xlabel="frequency [kHz]", ylabel="dB re 1 Pa at 1 m", title="per unit of modal acceleration")
    axes.grid(alpha=0.3)
    picture = save_page(figure, picture_path(build, "radiation"))
    return Inspection(f"radiation@{build.key}", rows, [picture])


def show_directivity(axes: "Axes", field: FarField, mode: int, title: str) -> "AxesImage":
    """Show a mode's level far away, over azimuth and elevation, in dB below the loudest direction."""
    heights, turns = np.linspace(np.pi / 2, -np.pi / 2, _HEIGHTS), np.linspace(-np.pi, np.pi, _TURNS)
    up, turn = np.meshgrid(heights, turns, indexing="ij")
    flat = np.cos(up)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(up)], 2).reshape(-1, 3)
    order = int(np.sqrt(field.coefficients.shape[1])) - 1
    level = abs(real_harmonics(directions, order) @ field.coefficients[mode]).reshape(up.shape)
    decibels = 20 * np.log10(np.maximum(level / max(level.max(), 1e-30), 10 ** (-RANGE / 20)))
    axes.set(title=title, xlabel="azimuth from x [°]", ylabel="elevation [°]", xticks=[-180, -90, 0, 90, 180])
    axes.set_yticks([-90, 0, 90])
    return axes.imshow(decibels, extent=(-180, 180, -90, 90), vmin=-RANGE, vmax=0, cmap="magma")
