"""Command that turns meshes into assets for simulators without a build: asset."""

import csv
import io
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from objectfolder.base.errors import ObjectFolderError, plural, quoted
from objectfolder.cli.console import console, print_line, print_wide, track_progress
from objectfolder.cli.export import SIMULATION, HullsOption, require_libraries
from objectfolder.cli.files import folder_to_write
from objectfolder.cli.objects import (
    MassOption,
    MaterialOption,
    ScaleOption,
    UnitOption,
    UpOption,
    WallOption,
    check_options,
)

if TYPE_CHECKING:
    from objectfolder.sim.assets import AssetOutcome
    from objectfolder.workspace.examine import Candidate

FORMATS = ("mjcf", "urdf", "usd", "glb")
TABLE = "assets.csv"  #: in the folder of the assets
COLUMNS = ("object", "mesh", "material", "size_m", "mass_kg", "mass_from", "low_kg", "high_kg", "hulls")


def _millimetres(text: str) -> float:
    try:
        return float(text.removesuffix("mm").strip())
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number of millimetres, such as 0.5") from None


def _formats(text: str) -> str:
    wrong = [name for name in text.split(",") if name not in FORMATS]
    if wrong:
        raise typer.BadParameter(f"{quoted(wrong[0])} is not one of {', '.join(FORMATS)}")
    return text


def asset(
    mesh: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Mesh (.obj, .glb, .gltf, .ply, .stl, .off), folder of meshes, or table of objects (.csv).",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the assets.", callback=folder_to_write)],
    material: MaterialOption = None,
    scale: ScaleOption = None,
    mass: MassOption = None,
    shell: Annotated[
        float | None,
        typer.Option(
            metavar="MM",
            parser=_millimetres,
            help="Wall in millimetres of a hollow object whose mesh is closed: bottles, cans, boxes.",
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Option(metavar="NAME", help="Key of the object; default: from the file's name.")
    ] = None,
    formats: Annotated[
        str,
        typer.Option(
            "--format", metavar="LIST", parser=_formats, help="Of mjcf, urdf, usd and glb, joined by commas."
        ),
    ] = "mjcf,urdf,glb",
    up: UpOption = None,
    unit: UnitOption = "m",
    wall: WallOption = None,
    hulls: HullsOption = 16,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Objects at a time; default: one per core.")
    ] = None,
) -> None:
    """Turn a mesh into an asset for simulators: mass, inertia, hulls, look, friction. No build.

    Writes DIR/NAME/ with NAME.xml (MuJoCo), NAME.urdf, NAME.glb or usd/NAME.usd, the convex hulls, the
    textured surface, thumbnail.png, and asset.json, which says where the mass is from and how sure it is.
    Takes 10 to 30 seconds, or minutes for furniture of many parts. `objectfolder export` of the built object
    gives the same body.

    `objectfolder asset can.obj --material steel --scale 0.102 --shell 0.3 --out assets`

    A scan of a closed thing is solid: a warning says so where its mass is not plausible. Give --mass if you
    know it, --shell if you know the wall, or both.

    In a folder, each mesh file and each subfolder with a mesh is an object; materials.csv may say of each its
    `material`, `size`, `up`, `wall`, `mass` and `shell`, all in metres and kg. A table (.csv) lists objects
    of its folder in such columns. Run the same command again to go on after an interruption. assets.csv in
    DIR lists what was made, and what was refused and why.
    """
    check_options(scale, up, unit, wall, "all", mass)
    chosen = tuple(dict.fromkeys(formats.split(",")))
    if "usd" in chosen:
        require_libraries("usd", "pxr")
    require_libraries("rl", *SIMULATION)
    from objectfolder.sim.assets import AssetOptions, make_assets

    own = {"--name": name, "--scale": scale, "--mass": mass, "--shell": shell}
    metres = None if shell is None else shell / 1000
    candidates = [
        replace(found, size=found.size or scale, up=found.up or up, wall=found.wall or wall)
        for found in _candidates(mesh, material, name, mass, metres, own)
    ]
    options = AssetOptions(out, chosen, hulls, unit)
    count = min(jobs or os.cpu_count() or 1, len(candidates))
    if count > 1:
        os.environ["OMP_NUM_THREADS"] = "1"  # of the processes, each of which has a core
    made = track_progress(make_assets(candidates, options, count), "making assets", len(candidates))
    places = {candidate.key: number for number, candidate in enumerate(candidates)}
    outcomes = sorted(made, key=lambda outcome: places[outcome.candidate.key])
    _report(outcomes, out)
    raise typer.Exit(any(outcome.refusal for outcome in outcomes))


def _candidates(
    mesh: Path,
    material: str | None,
    name: str | None,
    mass: float | None,
    shell: float | None,
    own: dict[str, Any],
) -> "list[Candidate]":
    """Return the meshes that a path stands for."""
    from objectfolder.sim.asset import default_key
    from objectfolder.workspace.discover import discover, discover_listed
    from objectfolder.workspace.examine import Candidate
    from objectfolder.workspace.params import check_slug

    if not mesh.exists():
        raise ObjectFolderError(f"{mesh} does not exist; expected a mesh, a folder of meshes, or a table")
    table = mesh.suffix.lower() == ".csv"
    if not mesh.is_dir() and not table:
        if material is None:
            raise ObjectFolderError(f"{mesh}: a mesh needs --material; see objectfolder asset --help")
        key = check_slug(default_key(mesh) if name is None else name, "--name")
        return [Candidate(key, mesh, material, mass=mass, shell=shell)]
    if given := [option for option, value in own.items() if value is not None]:
        where = "its columns" if table else "columns of materials.csv in it"
        raise ObjectFolderError(
            f"{mesh} is of several objects; for one mesh alone: {', '.join(given)}; use {where}"
        )
    return discover_listed(mesh, material) if table else discover(mesh, material)


def _report(outcomes: "Sequence[AssetOutcome]", out: Path) -> None:
    """Print the table of what was made, then warnings and refusals; write `TABLE`."""
    table = Table(box=SIMPLE_HEAD, show_edge=False, padding=0)
    for heading in ("object", "material", "size\nm", "mass\nkg", "as", "hulls", "CPU\ns"):
        table.add_column(heading, justify="left" if heading in ("object", "material", "as") else "right")
    for outcome in outcomes:
        found, candidate = outcome.report, outcome.candidate
        if found is None:
            cells: list[str | Text] = ["", "", Text("refused", style="bold red"), "", ""]
        else:
            seconds = f"{outcome.seconds:.1f}" if outcome.made else "there"
            sure = found["weight"]["source"] + ("?" if found["warnings"] else "")
            cells = [f"{found['size']:.4g}", f"{found['mass']:.4g}", sure, str(found["hulls"]), seconds]
        table.add_row(candidate.key, candidate.material or "?", *cells)
    print_wide(table)
    for outcome in outcomes:
        key = outcome.candidate.key
        for kind, texts in (("warnings", "bold yellow"), ("notes", "")):
            for text in (outcome.report or {}).get(kind, ()):
                label = "warning" if kind == "warnings" else "note"
                console.print(Text.assemble((label, texts), f" {key}: {text}"), soft_wrap=True)
        if outcome.refusal:
            text = outcome.refusal.removeprefix(f"{key}: ")
            console.print(Text.assemble(("refused", "bold red"), f" {key}: {text}"), soft_wrap=True)
    made = [outcome for outcome in outcomes if outcome.report is not None]
    if len(outcomes) > 1:
        _write_table(outcomes, out)
    refused = f", {len(outcomes) - len(made)} refused" if len(made) < len(outcomes) else ""
    print_line(f"{plural(len(made), 'asset')} in {out}/{refused}")


def _write_table(outcomes: "Sequence[AssetOutcome]", out: Path) -> None:
    from objectfolder.base.io import write_text

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*COLUMNS, "warning", "refusal"])
    for outcome in outcomes:
        candidate, found = outcome.candidate, outcome.report
        facts: list[Any] = [""] * 6
        if found is not None:
            weight = found["weight"]
            facts = [found["size"], found["mass"], weight["source"], weight["low"], weight["high"]]
            facts.append(found["hulls"])
        warning = "; ".join((found or {}).get("warnings", ()))
        row = [candidate.key, candidate.mesh, candidate.material or "", *facts, warning, outcome.refusal]
        writer.writerow(row)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / TABLE, text.getvalue())
