"""Commands that add objects to a workspace: add, fetch."""

import re
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer
from rich.text import Text

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.base.materials import material_names
from objectfolder.base.terminal import Terminal
from objectfolder.cli.console import console, print_line, track_progress

if TYPE_CHECKING:
    from objectfolder.workspace.examine import Candidate, Examination


def as_metres(text: str) -> float:
    """Parse a number of metres that an option is given."""
    from objectfolder.workspace.examine import UNITS

    try:
        return float(text)
    except ValueError:
        number = re.fullmatch(rf"([0-9]+(?:\.[0-9]+)?) *({'|'.join(UNITS)})", text)
        example = float(number[1]) * UNITS[number[2]] if number else 0.112
        raise typer.BadParameter(f"{text!r} is not a number of metres, such as {example:g}") from None


def as_kilograms(text: str) -> float:
    """Parse a number of kilograms that an option is given."""
    try:
        return float(text)
    except ValueError:
        number = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *(k?g)", text)
        example = float(number[1]) / (1 if number[2] == "kg" else 1000) if number else 0.118
        raise typer.BadParameter(f"{text!r} is not a number of kilograms, such as {example:g}") from None


MaterialOption = Annotated[
    str | None,
    typer.Option(
        metavar="MATERIAL", help=f"{', '.join(material_names())}, or a YAML file (docs/conventions.md)."
    ),
]
ScaleOption = Annotated[
    float | None,
    typer.Option(
        metavar="METRES", parser=as_metres, help="Longest side in metres; default: the size of the mesh."
    ),
]
UpOption = Annotated[str | None, typer.Option(metavar="y|z", help="Up axis; default: y for glTF, else z.")]
UnitOption = Annotated[str, typer.Option(metavar="m|cm|mm", help="Unit of the mesh coordinates.")]
WallOption = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        parser=as_metres,
        help="Thickness of open sheets in metres; default: 2 % of the size.",
    ),
]
MassOption = Annotated[
    float | None,
    typer.Option(
        metavar="KG",
        parser=as_kilograms,
        help="Mass of the real object, for simulations; default: volume of the solid times density.",
    ),
]


def add(
    mesh: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Mesh (.obj, .glb, .gltf, .ply, .stl, .off), folder of meshes, or catalogue (.yaml).",
        ),
    ],
    name: Annotated[
        str | None, typer.Option(metavar="NAME", help="Key of the object, such as `blue_mug`.")
    ] = None,
    material: MaterialOption = None,
    scale: ScaleOption = None,
    up: UpOption = None,
    unit: UnitOption = "m",
    wall: WallOption = None,
    bridge: Annotated[
        str,
        typer.Option(
            metavar="all|fem|off",
            help="Fill gaps narrower than half a cell of the sound grid; fem: for sound only.",
        ),
    ] = "all",
    mass: MassOption = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show the examined meshes; add nothing.")
    ] = False,
) -> None:
    """Add a mesh, a folder of meshes, or a catalogue of objects to the workspace.

    Each mesh is first loaded and closed; meshes that cannot be built are refused. Accepted meshes are copied
    with their referenced files to data/objects/NAME, tracked with DVC and entered in params.yaml. Next:
    `objectfolder build NAME`.

    In a folder, each mesh file and each subfolder with a mesh is an object. Options apply to all;
    materials.csv in the folder overrides them by object: its first line names its columns, any of `name`,
    `material`, `size`, `up`, `wall`, `mass`, `licence`, `author` and `source`. A SOURCE.txt beside a mesh
    is copied with it.
    """
    from objectfolder.workspace.discover import discover
    from objectfolder.workspace.examine import Candidate

    if mesh.suffix in (".yaml", ".yml"):
        for_meshes = {
            "--name": name,
            "--material": material,
            "--scale": scale,
            "--up": up,
            "--unit": None if unit == "m" else unit,
            "--wall": wall,
            "--bridge": None if bridge == "all" else bridge,
            "--mass": mass,
            "--dry-run": dry_run or None,
        }
        return _add_catalogue(mesh, [option for option, value in for_meshes.items() if value is not None])
    check_options(scale, up, unit, wall, bridge, mass)
    options = {"up": up, "unit": unit, "wall": wall, "bridge": bridge}
    values = _read_params()
    if not mesh.exists():
        raise ObjectFolderError(f"{mesh} does not exist; expected a mesh, a folder of meshes, or a catalogue")
    if not mesh.is_dir():
        if name is None or material is None:
            raise ObjectFolderError(
                f"{mesh}: a mesh needs --name and --material; see objectfolder add --help"
            )
        return _add_one(Candidate(name, mesh, material, mass=mass), values, scale, options, dry_run)
    if name is not None or scale is not None or mass is not None:
        raise ObjectFolderError(
            f"{mesh} is a folder; --name, --scale and --mass are for one mesh, such as "
            f"{discover(mesh)[0].mesh}"
        )
    raise typer.Exit(not _add_folder(mesh, values, material, options, dry_run))


def check_options(
    scale: float | None, up: str | None, unit: str, wall: float | None, bridge: str, mass: float | None
) -> None:
    """Raise ObjectFolderError if an option about a mesh is impossible."""
    from objectfolder.workspace.examine import UNITS
    from objectfolder.workspace.params import Bridge

    if unit not in UNITS:
        raise ObjectFolderError(f"unit {unit!r} is not one of {', '.join(UNITS)}")
    if up not in (None, "y", "z"):
        raise ObjectFolderError(f"up axis {up!r} is neither 'y' nor 'z'")
    if bridge not in get_args(Bridge):
        raise ObjectFolderError(f"bridge {bridge!r} is not one of {', '.join(get_args(Bridge))}")
    if wall is not None and not 0 < wall < inf:
        raise ObjectFolderError(f"wall is {wall:g}, expected a thickness in metres")
    if mass is not None and not 0 < mass < inf:
        raise ObjectFolderError(
            f"mass is {mass:g}, expected kilograms above 0; leave it out if it is not known"
        )
    if scale is not None and unit != "m":
        raise ObjectFolderError(
            f"--scale {scale:g} is in metres, not in the unit of the mesh's coordinates; give --scale, or "
            f"--unit {unit}, not both"
        )


def _read_params() -> dict[str, Any]:
    """Read the parameters of a workspace that a build would accept."""
    from objectfolder.workspace import params
    from objectfolder.workspace.check import check_entries
    from objectfolder.workspace.installed import check_installed

    check_installed()
    values = params.read()
    check_entries(values)
    return values


def _add_catalogue(catalogue: Path, options: list[str]) -> None:
    from objectfolder.workspace.objects import add_catalogue

    if options:
        verb = "applies" if len(options) == 1 else "apply"
        raise ObjectFolderError(
            f"{catalogue} is a catalogue, whose entries set these; {' and '.join(options)} {verb} to meshes "
            "only"
        )
    _read_params()
    added = add_catalogue(catalogue)
    console.print(f"added {', '.join(added) or 'nothing new'}; next: objectfolder build")


def _add_one(
    candidate: "Candidate",
    values: dict[str, Any],
    scale: float | None,
    options: dict[str, Any],
    dry_run: bool,
) -> None:
    from objectfolder.workspace.examine import examine

    finding = examine(candidate, values, scale, **options)
    _print_findings([finding], options)
    if not dry_run:
        entry = _add_examined(finding, options)
        weighed = f"{entry['mass']:.4g} kg, " if "mass" in entry else ""
        console.print(
            f"added {candidate.key}: {entry['material']}, {weighed}longest side {entry['scale']:.4g} m, "
            f"{entry['up']} up; next: objectfolder build {candidate.key}",
            soft_wrap=True,
        )


def _add_folder(
    folder: Path, values: dict[str, Any], material: str | None, options: dict[str, Any], dry_run: bool
) -> bool:
    """Examine and add the objects in a folder; return whether all were accepted."""
    from objectfolder.workspace.discover import FORMATS, discover, passed_over
    from objectfolder.workspace.examine import examine_all

    candidates = discover(folder, material)
    examined = examine_all(candidates, values, **options)
    findings = list(track_progress(examined, "examining", len(candidates)))
    _print_findings(findings, options)
    refused = [(f.candidate.key, f.refusal) for f in findings if f.refusal is not None]
    accepted = [f for f in findings if f.refusal is None]
    added = 0
    for finding in track_progress([] if dry_run else accepted, "adding", len(accepted)):
        try:
            _add_examined(finding, options)
            added += 1
        except ObjectFolderError as error:
            refused.append((finding.candidate.key, str(error)))
    for key, reason in dict.fromkeys(refused):
        refusal = f" {key}: {reason.removeprefix(f'{key}: ')}"
        console.print(Text.assemble(("refused", "bold red"), refusal), soft_wrap=True)
    if skipped := passed_over(folder):
        names = [str(path.relative_to(folder)) for path in skipped[:4]]
        more = ", ..." if len(skipped) > 4 else ""
        expected = ", ".join(FORMATS)
        print_line(f"{plural(len(skipped), 'file')} skipped: {', '.join(names)}{more}; expected {expected}")
    text = f"{len(accepted)} can be added" if dry_run else f"{added} added"
    text += f", {len(refused)} refused" if refused else ""
    console.print(text + ("; next: objectfolder build" if added else ""), highlight=False)
    return not refused


def _print_findings(findings: "list[Examination]", options: dict[str, Any]) -> None:
    from objectfolder.workspace.examine import examination_table

    console.print(examination_table(findings, options["up"] is not None))
    for finding in findings:
        if finding.notes:
            text = f"{finding.candidate.key}: {'; '.join(finding.notes)}"
            console.print(text, soft_wrap=True, highlight=False)


def _add_examined(finding: "Examination", options: dict[str, Any]) -> dict[str, Any]:
    """Add an accepted mesh, which is not loaded again; return its entry."""
    from objectfolder.engine.dvc.repository import track
    from objectfolder.hub.release.notices import SOURCE, notice_text
    from objectfolder.workspace.objects import add_mesh

    candidate = finding.candidate
    with TemporaryDirectory() as scratch:
        notice = Path(scratch, SOURCE)
        if text := notice_text(candidate.mesh, candidate.licence, candidate.author, candidate.source):
            notice.write_text(text, encoding="utf-8")
        return add_mesh(
            candidate.mesh,
            candidate.key,
            candidate.material or "",
            finding.scale,
            candidate.up or options["up"],
            attachments=[notice] if text else [],
            wall=candidate.wall or options["wall"],
            bridge=options["bridge"],
            examined=True,
            mass=candidate.mass,
            track=track,
        )


def fetch(
    objects: Annotated[
        list[str] | None, typer.Argument(metavar="[OBJECT]...", help="Object keys or published names.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Fetch every object.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="List the catalogue and exit.")] = False,
    catalogue: Annotated[Path, typer.Option(help="Catalogue of published objects.")] = Path(
        "catalogs/objectfolder1.yaml"
    ),
    directory: Annotated[
        Path | None,
        typer.Option("--from", metavar="DIR", help="Use archives or folders in DIR instead of downloads."),
    ] = None,
    url: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SOURCE=TEMPLATE", help="Another URL for a source; {model} stands for the model id."
        ),
    ] = None,
    accept_changed: Annotated[
        bool, typer.Option("--accept-changed", help="Accept files that differ from their recorded checksum.")
    ] = False,
) -> None:
    """Download published meshes of the paper's objects and add them to the workspace.

    Examples: `objectfolder fetch --list`, `objectfolder fetch ycb_mug 024_bowl`,
    `objectfolder fetch --all --from ~/meshes`. Run the same command again to resume an
    interrupted download. Each mesh has its own licence, stored next to it in SOURCE.txt.
    """
    from objectfolder.hub.fetch import report
    from objectfolder.hub.fetch.catalogue import read_catalogue, select_objects
    from objectfolder.hub.fetch.files import check_directory
    from objectfolder.hub.fetch.run import FetchStatus, fetch_all
    from objectfolder.workspace import params

    present = params.read()["objects"]
    published = read_catalogue(catalogue, url or ())
    if listing:
        report.print_catalogue(published, present, console)
        return
    keys = list(published.objects) if everything else select_objects(published, objects or ())
    if not keys:
        report.print_overview(published, present, console)
        raise ObjectFolderError("no objects given: name some (--list shows them), or use --all")
    report.print_licences(published, [key for key in keys if key not in present], console)
    if directory is not None:
        check_directory(directory)
    with report.download_progress(Terminal(stderr=True)) as progress:
        results = fetch_all(
            keys,
            published,
            directory,
            accept_changed,
            progress=progress,
            on_result=lambda result: report.print_result(result, console),
        )
    report.print_totals(results, console)
    raise typer.Exit(any(result.status is FetchStatus.FAILED for result in results))
