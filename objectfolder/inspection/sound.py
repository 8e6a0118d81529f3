"""Inspection of modal: the modes, their shapes and the sound of a strike."""

from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from objectfolder.audio.spectrogram import SAMPLE_RATE, show_spectrogram
from objectfolder.audio.synthesis import gains, sinusoid_bank
from objectfolder.figures import page, page_rows, save_page, show_image
from objectfolder.inspection.record import Inspection, kilobytes, picture_path, require, span
from objectfolder.inspection.scene import draw_scene, triangles
from objectfolder.io import read_json, read_npz
from objectfolder.mesh.ply import read_surface
from objectfolder.nets.audio_gains import energy_weights
from objectfolder.workspace.layout import Build

LISTED = 12  # modes in the table
DRAWN = 6  # mode shapes in the picture
DISPLACEMENT = 0.08  # largest drawn displacement, fraction of the object's size
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
    listed = [
        (
            f"  mode {i + 1}",
            f"{frequency[i]:9.2f} Hz, T60 {decay[i]:.3g} s, Q {natural[i] / (2 * damping[i]):.4g}"
            + (f", estimated error {errors[i]:.2%}" if i < len(errors) else ""),
        )
        for i in range(min(count, LISTED))
    ]
    table = [
        ("material", f"{report['material']}, {report['mass_kg'] * 1000:.4g} g"),
        ("model", f"{report['element']}, resolution {report['resolution']}, {report['elements']:,} elements"),
        ("degrees of freedom", f"{report['degrees_of_freedom']:,}"),
        ("modes", f"{count}, of which {report['modes_below_8_kHz']} below 8 kHz"),
        (
            f"below {report['max_frequency_hz'] / 1000:g} kHz",
            ("not counted" if total is None else f"{total}")
            + (" (truncated)" if report["truncated"] else ""),
        ),
        ("frequencies", span(frequency, "Hz", ",.0f")),
        (
            "estimated error",
            f"of the lowest {len(errors)} frequencies: up to {max(errors):.2%}" if errors else "not known",
        ),
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
    show_spectrogram(
        left, sound, f"struck at {place} mm along {'xyz'[direction]}: loudest point (displacement)"
    )
    right.scatter(frequency / 1000, decay, s=18)
    right.set(title=f"all {len(frequency)} modes", xlabel="frequency [kHz]", ylabel="decay time T60 [s]")
    right.set_yscale("log")
    right.axvline(
        SAMPLE_RATE / 2000, color="grey", linestyle=":", label="Nyquist frequency of the spectrogram"
    )
    right.legend()
    right.grid(alpha=0.3, which="both")
    return save_page(figure, picture_path(build, "modal"))


def _draw_shape(vertices: np.ndarray, faces: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Draw the surface displaced by a mode shape (V, 3)."""
    amplitude = np.linalg.norm(shape, axis=1)
    largest = max(float(amplitude.max()), 1e-30)
    moved = triangles(vertices + shape * (DISPLACEMENT / largest), faces)
    moved.point_data["amplitude"] = amplitude / largest
    return draw_scene(
        lambda plotter: plotter.add_mesh(
            moved, scalars="amplitude", cmap="YlOrRd", clim=(0, 1), show_scalar_bar=False, smooth_shading=True
        )
    )


def _loudest_strike(modes: dict[str, np.ndarray]) -> tuple[int, int, np.ndarray]:
    """Return the point and axis whose unit impulse gives the most energy, and its sound (samples,)."""
    energy = modes["shapes"].astype(np.float64) ** 2 @ energy_weights(
        modes["damped_frequency"], modes["damping"]
    )
    point, axis = (int(i) for i in np.unravel_index(energy.argmax(), energy.shape))
    bank = sinusoid_bank(torch.from_numpy(modes["damped_frequency"]), torch.from_numpy(modes["damping"]))
    force = torch.eye(3)[axis][None]
    return point, axis, (gains(torch.from_numpy(modes["shapes"][[point]]), force) @ bank)[0].numpy()
