"""The command `import` for released ObjectFolder files."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import check_output
from objectfolder.cli.console import print_line


def import_released(
    file: Annotated[Path, typer.Argument(metavar="FILE.pth", help="A released ObjectFile.pth.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Object File to write: NAME.safetensors.")],
    key: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Object key; default: from the name of the file's folder."),
    ] = None,
    material: Annotated[str, typer.Option(metavar="MATERIAL", help="Material of the object.")] = "unknown",
    scale: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Longest side; default: of the mesh or the bounds, or as stored in a 2.0 file.",
        ),
    ] = None,
    bounds: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option(
            metavar="XMIN YMIN ZMIN XMAX YMAX ZMAX",
            help="Bounds of the object in the file's coordinates. Touch of a 1.0 file needs them or --mesh.",
        ),
    ] = None,
    mesh: Annotated[
        Path | None,
        typer.Option(
            help="Mesh of the object in the file's coordinates: provides bounds, and the surface of contacts."
        ),
    ] = None,
    sensor: Annotated[
        str,
        typer.Option(
            metavar="SENSOR", help="Sensor that renders the depth maps of a 2.0 file (`sensor list`)."
        ),
    ] = "gelsight_r15",
    gel: Annotated[
        Path | None, typer.Option(help="The released code's calibs/depth_bg.npy; default: estimated.")
    ] = None,
    crop: Annotated[
        float | None,
        typer.Option(help="Render only [-CROP, CROP]^3 of the unit frame; 0.6 takes two fifths of the time."),
    ] = None,
) -> None:
    """Convert a released ObjectFolder 1.0 or 2.0 file without executing pickled code.

    Converts VisionNet (NeRF or KiloOSF), AudioNet and TouchNet. A part that cannot be converted is left out
    with a warning. docs/released.md lists the differences from the released code.

    `objectfolder import Objects/25/ObjectFile.pth bowl.safetensors --bounds -0.1 -0.1 -0.05 0.1 0.1 0.05`
    """
    from objectfolder.hub.importer.convert import ImportOptions, convert
    from objectfolder.workspace.layout import MODALITIES

    if out.suffix != ".safetensors":
        raise ObjectFolderError(
            f"{out}: expected the name of an Object File to write, such as bowl.safetensors"
        )
    check_output(out)
    box = None if bounds is None else np.reshape(bounds, (2, 3))
    options = ImportOptions(key, material, scale, box, mesh, sensor, gel, crop)
    obj = convert(file, options)
    obj.save(out)
    held = [f"{m} ({obj.header[m]['kind']})" for m in ("geometry", *MODALITIES) if m in obj.header]
    print_line(
        f"{out}: {obj.header['imported']['release']}, {', '.join(held)}; {out.stat().st_size / 1e6:.1f} MB, "
        f"longest side {obj.scale:g} m"
    )
