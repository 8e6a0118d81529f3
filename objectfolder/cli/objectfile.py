"""Commands on an Object File: info, query."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

from objectfolder.cli.console import console
from objectfolder.errors import ObjectFolderError
from objectfolder.io import read_rows
from objectfolder.objectfile.header import PARTS, known_kinds

if TYPE_CHECKING:
    from objectfolder.objectfile.file import ObjectFile

query_app = typer.Typer(no_args_is_help=True, help="Ask an Object File: `vision`, `audio` or `touch`.")

#: What `query touch` can write, and columns of its contacts.csv.
TOUCH_OUTPUTS = ("image", "mask", "height", "displacement", "pressure", "normals")
TOUCH_COLUMNS = {
    "force": "force_N",
    "area": "area_m2",
    "max_penetration": "max_penetration_m",
    "mean_penetration": "mean_penetration_m",
    "obstructed": "obstructed",
}

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="An ObjectFile.safetensors.")]
OutArgument = Annotated[Path, typer.Argument(metavar="OUT", help="Folder for 1.png, 2.png ... or 1.wav ...")]


def info(file: FileArgument) -> None:
    """Show what an Object File holds."""
    from objectfolder.objectfile.file import ObjectFile

    obj = ObjectFile.load(file)
    table = Table(title=f"{obj.key} ({file.stat().st_size / 1000:.0f} KB)", show_header=False)
    rows = {"material": obj.material, "longest side": f"{obj.scale:g} m"}
    rows |= {part: _summary_of(obj, part) for part in PARTS}
    rows["format"] = obj.header["format"]
    for name, value in rows.items():
        table.add_row(name, escape(value))
    console.print(table)


@query_app.command()
def vision(
    file: FileArgument,
    queries: Annotated[Path, typer.Argument(metavar="QUERIES.npy", help="(N, 6): camera xyz, light xyz.")],
    out: OutArgument,
    resolution: Annotated[int, typer.Option(min=1, help="Pixels along a side.")] = 256,
    buffers: Annotated[
        bool, typer.Option("--buffers", help="Also 1.npz ...: linear rgba, depth (metres), normals.")
    ] = False,
    supersample: Annotated[bool, typer.Option(help="Take more samples at edges; without, faster.")] = True,
) -> None:
    """Render views. Positions are in the unit frame: the object's longest side is 1."""
    from objectfolder.io import write_npz, write_png
    from objectfolder.objectfile.file import ObjectFile

    obj, rows = ObjectFile.load(file), read_rows(queries, 6)
    for i, row in enumerate(rows, 1):
        views = obj.render(row[:3], row[3:], resolution, supersample=supersample)
        write_png(out / f"{i}.png", (views.rgb[0] * 255).round().astype(np.uint8))
        if buffers:
            write_npz(out / f"{i}.npz", rgba=views.rgba[0], depth=views.depth[0], normals=views.normals[0])
    console.print(f"{len(rows)} views in {out}/")


@query_app.command()
def audio(
    file: FileArgument,
    vertices: Annotated[Path, typer.Argument(metavar="VERTICES.npy", help="(N, 3) metres, or (N, 6).")],
    out: OutArgument,
    forces: Annotated[Path | None, typer.Option(help="(N, 3) impulses; else columns 4 to 6.")] = None,
    sample_rate: Annotated[int, typer.Option(min=1, help="Hz.")] = 16000,
    duration: Annotated[float, typer.Option(help="Seconds.")] = 2.0,
    response: Annotated[str, typer.Option(help="displacement, velocity or acceleration.")] = "displacement",
    contact_time: Annotated[
        float,
        typer.Option(help="Seconds that the strike lasts; 0 is an instant, wood on metal about 0.0003."),
    ] = 0.0,
    material: Annotated[
        str | None, typer.Option(help="Of which the struck object is made; default: its own.")
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(
            help="Longest side of the struck object in metres, also for VERTICES; default: its own."
        ),
    ] = None,
    normalize: Annotated[bool, typer.Option(help="Scale all sounds by their common peak.")] = False,
) -> None:
    """Strike the object; writes float WAV at absolute, tiny amplitude: --normalize makes it audible."""
    import soundfile

    from objectfolder.io import atomic
    from objectfolder.objectfile.file import ObjectFile

    points = read_rows(
        vertices, 3 if forces else 6, "" if forces else " (points and impulses), or give --forces"
    )
    impulse = read_rows(forces, 3) if forces else points[:, 3:]
    obj = ObjectFile.load(file)
    sounds = obj.impact(
        points[:, :3],
        impulse,
        sample_rate,
        duration,
        response,
        contact_time=contact_time,
        material=material,
        scale=scale,
    )
    own = material is None and scale is None
    frequencies = obj.frequencies if own else obj.tuning(material, scale).frequencies.numpy()
    above = int((frequencies >= sample_rate / 2).sum())
    peak = float(np.abs(sounds).max(initial=0))
    if normalize and peak > 0:
        sounds = sounds / peak * 0.9
    for i, sound in enumerate(sounds, 1):
        with atomic(out / f"{i}.wav") as path:
            soundfile.write(path, sound, sample_rate, subtype="FLOAT")
    console.print(
        f"{len(sounds)} sounds in {out}/, peak {peak:.3g}"
        + ("" if peak else ": silent")
        + f"; {len(frequencies)} modes"
        + (f", {above} left out above the Nyquist frequency of {sample_rate / 2:g} Hz" if above else ""),
        highlight=False,
        soft_wrap=True,
    )


@query_app.command()
def touch(
    file: FileArgument,
    vertices: Annotated[Path, typer.Argument(metavar="VERTICES.npy", help="(N, 3) contact points, metres.")],
    out: OutArgument,
    gelinfo: Annotated[
        Path | None, typer.Option(help="(N, 3): tilt theta, its direction phi (radians), depth (metres).")
    ] = None,
    depth: Annotated[float, typer.Option(help="Press depth in metres, without --gelinfo.")] = 0.001,
    sensor: Annotated[
        str | None, typer.Option(help="Another sensor: a name (`sensor list`) or a .yaml file.")
    ] = None,
    outputs: Annotated[
        str, typer.Option(metavar="NAME,...", help=f"What to write: {', '.join(TOUCH_OUTPUTS)}.")
    ] = "image",
) -> None:
    """Press a tactile sensor on the object.

    Writes 1.png ... (image), 1_mask.png ... (mask: where gel and object touch) and 1.npz ... (height and
    displacement in metres, pressure in Pa, normals of the gel); and contacts.csv: force, area, penetration
    and obstruction of each contact. docs/touch.md defines them.
    """
    from objectfolder.io import write_npz, write_png, write_table
    from objectfolder.objectfile.file import ObjectFile

    wanted = [name.strip() for name in outputs.split(",")]
    unknown = [name for name in wanted if name not in TOUCH_OUTPUTS]
    if unknown:
        raise ObjectFolderError(f"--outputs {unknown[0]!r} is not one of {', '.join(TOUCH_OUTPUTS)}")
    points = read_rows(vertices, 3)
    tilt, azimuth, depths = read_rows(gelinfo, 3).T if gelinfo else (0.0, 0.0, depth)
    obj = ObjectFile.load(file)
    query: dict[str, Any] = {"depth": depths, "tilt": tilt, "azimuth": azimuth, "sensor": sensor}
    if obj.header.get("touch", {}).get("kind") in ("image", "released_image") and wanted == ["image"]:
        images = obj.touch(points, **query)
        for i, image in enumerate(images, 1):
            write_png(out / f"{i}.png", image)
        console.print(f"{len(images)} tactile images in {out}/")
        return
    rows: list[list[float]] = []
    for part in obj.touches(points, **query):
        arrays = {"height": part.height, "displacement": part.displacement, "pressure": part.pressure}
        arrays = {name: array for name, array in arrays.items() if name in wanted}
        if "normals" in wanted:
            arrays["normals"] = part.normals
        for i, image in enumerate(part.images):
            name = len(rows) + 1
            if "image" in wanted:
                write_png(out / f"{name}.png", image)
            if "mask" in wanted:
                write_png(out / f"{name}_mask.png", part.mask[i].astype(np.uint8) * 255)
            if arrays:
                write_npz(out / f"{name}.npz", **{key: array[i] for key, array in arrays.items()})
            rows.append([name, *(float(getattr(part, column)[i]) for column in TOUCH_COLUMNS)])
    write_table(out / "contacts.csv", ["contact", *TOUCH_COLUMNS.values()], rows)
    console.print(
        f"{len(rows)} contacts in {out}/{_summary(np.array(rows))}", highlight=False, soft_wrap=True
    )


def _summary(rows: np.ndarray) -> str:
    if not len(rows):
        return ""
    columns = dict(zip(TOUCH_COLUMNS, rows.T[1:]))
    force, area = columns["force"], columns["area"] * 1e6
    text = "" if np.isnan(force).any() else f"; force {force.min():.3g} to {force.max():.3g} N"
    text += f", area {area.min():.3g} to {area.max():.3g} mm2"
    blocked = int((columns["obstructed"] > 0).sum())
    return text + (f"; {blocked} obstructed: a real sensor would not get there" if blocked else "")


def _summary_of(obj: "ObjectFile", part: str) -> str:
    """What a part holds, in a line; nothing is read for it but the modes."""
    if part not in obj.header:
        return "none"
    kind = obj.header[part]["kind"]
    if kind not in known_kinds(part):
        return f"{kind}, which this version does not know"
    if part == "geometry":
        return f"{kind}, {obj.header[part]['resolution']}^3"
    if part == "touch":
        return f"{kind}, sensor {obj.sensor}"
    if part == "vision":
        return kind
    if kind == "released_spectrogram":
        return kind
    frequencies = obj.frequencies
    if not len(frequencies):
        return f"{kind}, no modes: silent"
    return f"{kind}, {len(frequencies)} modes from {frequencies.min():.0f} to {frequencies.max():.0f} Hz"
