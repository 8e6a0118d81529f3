"""Commands on tactile sensors: list, fit, export."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.base.io import check_output
from objectfolder.cli.console import App, console, print_line
from objectfolder.cli.files import empty_folder

sensor_app = App(
    help="Tactile sensors: `list` profiles, `fit` a profile to photographs, `export` its colours.",
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
            metavar="IMAGE...",
            help="Photographs of a ball pressed on the sensor at different positions, or one calibration "
            "pack of Taxim (dataPack.npz).",
        ),
    ],
    radius: Annotated[float, typer.Option(metavar="METRES", help="Radius of the ball.")],
    out: Annotated[
        Path,
        typer.Option(metavar="FILE.yaml", help="Profile to write; two more files are written beside it."),
    ],
    sensor: Annotated[
        str, typer.Option(metavar="SENSOR", help="Initial profile: a name or a .yaml file.")
    ] = "digit",
    untouched: Annotated[
        Path | None,
        typer.Option(help="Photograph of the untouched sensor; without it, give 3 images or more."),
    ] = None,
    circle: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROW,COLUMN,RADIUS",
            help="Circle of an imprint, pixels of the profile's images; one per image. Default: detected.",
        ),
    ] = None,
    lights: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Fit the coating and this many lights, with position and colour; 6 suits most sensors.",
        ),
    ] = None,
    residual: Annotated[
        bool, typer.Option("--residual", help="Also fit a polynomial to the remaining error.")
    ] = False,
) -> None:
    """Fit a sensor's lights and background to photographs of a ball pressed on it.

    Press a steel ball (radius 2 to 10 mm) about 1 mm deep at three or more positions away from the border.
    Photograph each press, and the untouched sensor. The camera must be upright, without automatic exposure
    or white balance; size, field of view, gel and positions of the lights must be those of the profile
    `--sensor`. Then:

    `objectfolder sensor fit a.png b.png c.png --untouched rest.png --radius 0.004 --out mine.yaml`

    Writes mine.yaml, mine_background.png and mine_report.json. Lights of the same colour are fitted together.
    With `--lights`, only geometry and gel are taken from the profile:

    `objectfolder sensor fit dataPack.npz --radius 0.002 --lights 6 --residual --sensor my.yaml --out n.yaml`

    In Python, load it with `load_profile("mine.yaml")`. For a build, copy it to objectfolder/touch/profiles/,
    or to sensors/ of a workspace that `objectfolder init` made.
    """
    from objectfolder.touch.calibration import fit_sensor, fit_sensor_lights, save_fit
    from objectfolder.touch.photographs import read_pack, read_photograph
    from objectfolder.touch.profiles import load_profile

    if out.suffix not in (".yaml", ".yml"):
        raise ObjectFolderError(f"--out is {out}, expected the name of a .yaml file")
    check_output(out)
    profile = load_profile(sensor)
    rest = read_photograph(untouched, profile) if untouched else None
    circles = [_circle(text) for text in circle] if circle else None
    names = [str(path) for path in images]
    if len(images) == 1 and images[0].suffix == ".npz":
        pack = read_pack(images[0], profile)
        pictures, circles = pack.pictures, circles or pack.circles
        rest = pack.untouched if rest is None else rest
        names = [f"{images[0]}, picture {i}" for i in range(1, len(pictures) + 1)]
    else:
        pictures = np.stack([read_photograph(path, profile) for path in images])
    if lights is None:
        if residual:
            raise ObjectFolderError(
                "--residual corrects the error of fitted lights: give --lights, such as 6"
            )
        fit = fit_sensor(pictures, radius, profile, rest, circles, names)
        table = Table(
            title=f"{out.stem}: lights of {profile.name}, fitted to {plural(len(pictures), 'image')}"
        )
        for title in ("color", "intensity, times", "standard error"):
            table.add_column(title, justify="left" if title == "color" else "right")
        for light in fit.lights:
            color = " ".join(f"{c:g}" for c in light.color)
            table.add_row(color, f"{light.factor:.3f}", f"{light.error:.3f}")
        console.print(table)
    else:
        if rest is None:
            raise ObjectFolderError("--lights needs a photograph of the untouched sensor: give --untouched")
        fit = fit_sensor_lights(pictures, radius, profile, rest, circles, names, lights, residual)
    source = f"{profile.source.strip()} Lights and background: fitted to {plural(len(pictures), 'image')}."
    written = save_fit(fit, out, out.stem, source)
    print_line(
        f"images: {fit.psnr_before:.1f} dB with the given lights, {fit.psnr_after:.1f} dB with the "
        f"fitted; wrote {', '.join(map(str, written))}"
    )


@sensor_app.command("export")
def export_sensor(
    sensor: Annotated[
        str, typer.Argument(metavar="SENSOR", help="Profile: a name (`sensor list`) or a .yaml file.")
    ],
    taxim: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="New or empty folder for polycalib.npz, bg.jpg and real_bg.npy."),
    ] = None,
    isaac_lab: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The same, in the form that Isaac Lab reads.")
    ] = None,
) -> None:
    """Write a sensor's colours as the simulator Taxim or NVIDIA's Isaac Lab reads them.

    `objectfolder sensor export digit_real --isaac-lab digit_real/`

    Also prints the settings of Isaac Lab's GelSightRenderCfg.
    """
    from objectfolder.touch.profiles import load_profile
    from objectfolder.touch.taxim import BINS, export_taxim

    if (taxim is None) == (isaac_lab is None):
        raise ObjectFolderError("give one folder: --taxim DIR or --isaac-lab DIR")
    given = taxim or isaac_lab
    assert given is not None
    folder, profile = empty_folder(given), load_profile(sensor)
    written = export_taxim(profile, folder, isaac=isaac_lab is not None)
    print_line(
        f"wrote {', '.join(map(str, written))}\nimage_height={profile.height}, image_width={profile.width}, "
        f"num_bins={BINS}, mm_per_pixel={1000 * profile.pixel_pitch:.4g}"
    )


def _circle(text: str) -> tuple[float, float, float]:
    try:
        row, column, radius = map(float, text.split(","))
    except ValueError as error:
        raise ObjectFolderError(f"--circle {text!r} is not ROW,COLUMN,RADIUS, such as 80,60,12") from error
    return row, column, radius
