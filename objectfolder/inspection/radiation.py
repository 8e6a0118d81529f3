"""Inspection of radiation: how loud modes are, and in which directions."""

from typing import TYPE_CHECKING

import numpy as np

from objectfolder.acoustics.farfield import FarField, unpack_far_field
from objectfolder.acoustics.harmonics import real_harmonics
from objectfolder.figures import page, page_rows, save_page
from objectfolder.inspection.record import Inspection, kilobytes, picture_path, require, span
from objectfolder.io import read_npz, read_safetensors
from objectfolder.workspace.layout import Build

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

DRAWN = 6  # modes in the picture
RANGE = 30.0  #: displayed, dB
_HEIGHTS, _TURNS = 46, 91  # directions of a map


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
    chosen: list[int] = np.unique(np.linspace(0, max(len(hertz) - 1, 0), DRAWN).astype(int))[
        : len(hertz)
    ].tolist()
    panels = upper.subplots(2, DRAWN // 2)
    maps = [
        show_directivity(axes, field, mode, f"{hertz[mode]:.0f} Hz")
        for axes, mode in zip(panels.flat, chosen)
    ]
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
    up, turn = np.meshgrid(
        np.linspace(np.pi / 2, -np.pi / 2, _HEIGHTS), np.linspace(-np.pi, np.pi, _TURNS), indexing="ij"
    )
    flat = np.cos(up)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(up)], 2).reshape(-1, 3)
    order = int(np.sqrt(field.coefficients.shape[1])) - 1
    level = abs(real_harmonics(directions, order) @ field.coefficients[mode]).reshape(up.shape)
    decibels = 20 * np.log10(np.maximum(level / max(level.max(), 1e-30), 10 ** (-RANGE / 20)))
    axes.set(title=title, xlabel="azimuth from x [°]", ylabel="elevation [°]", xticks=[-180, -90, 0, 90, 180])
    axes.set_yticks([-90, 0, 90])
    return axes.imshow(decibels, extent=(-180, 180, -90, 90), vmin=-RANGE, vmax=0, cmap="magma")
