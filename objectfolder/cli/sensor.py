"""Commands on tactile sensors: list, fit."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from objectfolder.cli.console import console
from objectfolder.errors import ObjectFolderError

sensor_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Tactile sensors: `list` profiles, `fit` a profile to pictures.",
)


@sensor_app.command("list")
def list_sensors() -> None:
    """List the sensor profiles of the package; docs/sensors.md explains their fields."""
    from objectfolder.touch.profiles import available_profiles, load_profile

    table = Table()
    for title in ("profile", "pixels", "mm", "gel", "lights"):
        table.add_column(title, justify="left" if title in ("profile", "gel") else "right")
    for profile in map(load_profile, available_profiles()):
        size = [1000 * profile.pixel_pitch * n for n in (profile.width, profile.height)]
        pixels, extent = f"{profile.width} x {profile.height}", "{:.1f} x {:.1f}".format(*size)
        table.add_row(profile.name, pixels, extent, profile.gel, str(len(profile.lights)))
    console.print(table)


@sensor_app.command("fit")
def fit_sensor_profile(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...", help="Pictures of a ball pressed on the sensor in different places."
        ),
    ],
    radius: Annotated[float, typer.Option(help="Radius of the ball, metres.")],
    out: Annotated[Path, typer.Option(help="Profile to write, .yaml; two more files are written beside it.")],
    sensor: Annotated[str, typer.Option(help="Initial profile: a name or a .yaml file.")] = "digit",
    untouched: Annotated[
        Path | None, typer.Option(help="Picture of the untouched sensor; without it, give 3 images or more.")
    ] = None,
    circle: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROW,COLUMN,RADIUS",
            help="Circle of an imprint, pixels of the profile's images; one per image. Default: detected.",
        ),
    ] = None,
) -> None:
    """Fit a sensor's light intensities and background to pictures of a ball pressed on it.

    Press a steel ball of 3 to 10 mm radius about 1 mm deep in at least three places away from the border, and
    take a picture of each, and one of the untouched sensor. The camera must be upright, without automatic
    exposure or white balance; size, field of view, gel and positions of the lights must be those of the
    profile `--sensor`. Then:

    `objectfolder sensor fit a.png b.png c.png --untouched rest.png --radius 0.004 --out mine.yaml`

    Writes mine.yaml, mine_background.png and mine_report.json. Lights of the same colour are fitted together.
    In Python, load it with `load_profile("mine.yaml")`. For a build, copy it to objectfolder/touch/profiles/.
    """
    from objectfolder.touch.calibration import fit_sensor, save_fit
    from objectfolder.touch.photographs import read_photograph
    from objectfolder.touch.profiles import load_profile

    if out.suffix not in (".yaml", ".yml"):
        raise ObjectFolderError(f"--out is {out}, expected the name of a .yaml file")
    profile = load_profile(sensor)
    pictures = np.stack([read_photograph(path, profile) for path in images])
    rest = read_photograph(untouched, profile) if untouched else None
    circles = [_circle(text) for text in circle] if circle else None
    fit = fit_sensor(pictures, radius, profile, rest, circles, [str(path) for path in images])
    table = Table(title=f"{out.stem}: lights of {profile.name}, fitted to {len(images)} images")
    for title in ("color", "intensity, times", "standard error"):
        table.add_column(title, justify="left" if title == "color" else "right")
    for light in fit.lights:
        color = " ".join(f"{c:g}" for c in light.color)
        table.add_row(color, f"{light.factor:.3f}", f"{light.error:.3f}")
    console.print(table)
    source = f"{profile.source.strip()} Light intensities and background: fitted to {len(images)} images."
    written = save_fit(fit, out, out.stem, source)
    console.print(
        f"images: {fit.psnr_before:.1f} dB with the given intensities, {fit.psnr_after:.1f} dB with the "
        f"fitted; wrote {', '.join(map(str, written))}",
        highlight=False,
        soft_wrap=True,
    )


def _circle(text: str) -> tuple[float, float, float]:
    try:
        row, column, radius = map(float, text.split(","))
    except ValueError as error:
        raise ObjectFolderError(f"--circle {text!r} is not ROW,COLUMN,RADIUS, such as 80,60,12") from error
    return row, column, radius
