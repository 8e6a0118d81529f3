"""Command that reconstructs a mesh from a photograph: reconstruct."""

from pathlib import Path
from typing import Annotated

import typer

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import check_output
from objectfolder.cli.console import print_line
from objectfolder.cli.files import bounded


def reconstruct(
    photo: Annotated[Path, typer.Argument(metavar="PHOTO", help="Image of a single object.")],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Mesh to write: .obj, .ply (z up) or .glb (y up).")
    ],
    model: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Model that `objectfolder bench reconstruct` wrote, .safetensors."),
    ],
    mask: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Image of the same size, white where the object is."),
    ] = None,
    background: Annotated[
        str | None, typer.Option(metavar="R,G,B", help="Colour of a plain background, each 0 to 255.")
    ] = None,
    tolerance: Annotated[
        int, typer.Option(**bounded(0, 255), help="Least difference from the background, 0 to 255.")
    ] = 30,
    encoder: Annotated[
        str | None,
        typer.Option(metavar="FILE.py:NAME", help="Encoder of your own, if the model was trained with it."),
    ] = None,
) -> None:
    """Reconstruct a mesh from one photograph; its longest side is 1.

    The background is removed by the image's transparency if it has any, else by `--mask`, else by
    `--background`. The model works only for objects like those it was trained on.
    """
    from objectfolder.benchmarks.models.encoders import registered
    from objectfolder.benchmarks.models.framing import frame_cutout
    from objectfolder.benchmarks.models.shape_model import load_model
    from objectfolder.benchmarks.tasks.photograph import (
        check_mesh_name,
        cut_out,
        photograph_to_mesh,
        read_picture,
        write_mesh,
    )

    check_mesh_name(out)
    check_output(out)
    colour = None if background is None else _colour(background)
    picture = read_picture(photo)
    shape = None if mask is None else read_picture(mask, "L")
    rgba = cut_out(picture, shape, colour, tolerance, str(photo))
    if encoder is not None:
        registered(encoder)
    trained = load_model(model)
    vertices, faces = photograph_to_mesh(trained, frame_cutout(rgba, trained.setup.view))
    write_mesh(out, vertices, faces)
    print_line(f"wrote {out}: {len(vertices):,} vertices, {len(faces):,} triangles")


def _colour(text: str) -> tuple[int, int, int]:
    parts = text.split(",")
    if len(parts) != 3 or not all(part.strip().isdecimal() and int(part) < 256 for part in parts):
        raise ObjectFolderError(f"--background {text!r}: expected three levels such as 255,255,255")
    red, green, blue = map(int, parts)
    return red, green, blue
