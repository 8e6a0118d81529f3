"""Commands on tactile sensors: list, fit, export."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.base.io import check_output
from objectfolder.cli.console import Commands, console, print_line
from objectfolder.cli.files import bounded, empty_folder

sensor_app = Commands(
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
            metavar="IMAGE",
            help="Photographs of a ball pressed on the sensor in different places, or one Taxim calibration "
            "pack (dataPack.npz).",
        ),
    ],
    radius: Annotated[float, typer.Option(metavar="METRES", help="Radius of the ball.")],
    out: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Profile to write, .yaml; two more files are written beside it."),
    ],
    sensor: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Initial profile: a name or a .yaml file.")
    ] = "digit",
    untouched: Annotated[
        Path | None,
        typer.Option(
            metavar="IMAGE", help="Photograph of the untouched sensor; without it, give at least 3 images."
        ),
    ] = None,
    circle: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROW,COLUMN,RADIUS",
            help="Circle of an imprint, in pixels of the profile's images; one per image; default: detected.",
        ),
    ] = None,
    lights: Annotated[
        int | None,
        typer.Option(
            **bounded(1),
            help="Fit this many lights, with position and colour, and the coating; 6 suits most sensors.",
        ),
    ] = None,
    residual: Annotated[
        bool, typer.Option("--residual", help="With --lights, also fit a polynomial to the remaining error.")
    ] = False,
) -> None:
    """Fit a sensor's lights and background to photographs of a ball pressed on it.

    Press a steel ball (radius 2 to 10 mm) about 1 mm deep in three or more places away from the border. Take
    a photograph of each press and one of the untouched sensor. Keep the camera upright; turn off automatic
    exposure and white balance. Size, field of view, gel and positions of the lights must match the profile
    `--sensor`. Then:

    `objectfolder sensor fit a.png b.png c.png --untouched rest.png --radius 0.004 --out mine.yaml`

    This writes mine.yaml, mine_background.png and mine_report.json. Lights of the same colour are fitted
    together. With `--lights`, only geometry and gel are taken from the profile:

    `objectfolder sensor fit dataPack.npz --radius 0.002 --lights 6 --residual --sensor my.yaml --out n.yaml`

    In Python, load it with `load_profile("mine.yaml")`. For a build, copy it to sensors/ of your workspace,
    or in a clone to objectfolder/touch/profiles/.
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
            raise ObjectFolderError("--residual is what fitted lights leave over: give --lights, such as 6")
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
            raise ObjectFolderError("--lights needs a picture of the untouched sensor: give --untouched")
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
        str,
        typer.Argument(
            metavar="SENSOR", help="Profile: a name (`objectfolder sensor list`) or a .yaml file."
        ),
    ],
    taxim: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="New or empty folder for polycalib.npz, bg.jpg and real_bg.npy."),
    ] = None,
    isaac_lab: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="The same, with the slopes that Isaac Lab looks up.")
    ] = None,
) -> None:
    """Write a sensor's colours for the simulator Taxim or NVIDIA's Isaac Lab.

    `objectfolder sensor export digit_real --isaac-lab digit_real/`

    Prints what else Isaac Lab's GelSightRenderCfg needs.
    """
    from objectfolder.touch.profiles import load_profile
    from objectfolder.touch.taxim import BINS, export_taxim

    if (taxim is None) == (isaac_lab is None):
        raise ObjectFolderError("give one folder: --taxim FOLDER or --isaac-lab FOLDER")
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
