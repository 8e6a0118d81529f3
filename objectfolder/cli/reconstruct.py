"""Command that reconstructs a mesh from a photograph: reconstruct."""

from pathlib import Path
from typing import Annotated

import typer

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import check_output
from objectfolder.cli.console import print_line


def reconstruct(
    photo: Annotated[Path, typer.Argument(metavar="PHOTO", help="Image of one object.")],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Mesh to write: .obj, .ply (z up) or .glb (y up).")
    ],
    model: Annotated[
        Path, typer.Option(metavar="FILE.safetensors", help="Model that `bench reconstruct` trained.")
    ],
    mask: Annotated[Path | None, typer.Option(help="Image of the same size, white on the object.")] = None,
    background: Annotated[
        str | None, typer.Option(metavar="R,G,B", help="Colour of a plain background, 0 to 255 each.")
    ] = None,
    tolerance: Annotated[
        int, typer.Option(min=0, max=255, help="Smallest difference from the background, 0 to 255.")
    ] = 30,
    encoder: Annotated[
        str | None,
        typer.Option(metavar="FILE.py:NAME", help="Your own encoder, if the model was trained with one."),
    ] = None,
) -> None:
    """Reconstruct an object's shape from one image (unit frame: the longest side is 1).

    The background is removed with the image's transparency if it has any, else with `--mask`, else with
    `--background`. The model only handles objects like those it was trained on.
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
