"""The `objectfolder` command."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from objectfolder.errors import ObjectFolderError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Build and query **Object Files**: objects that can be seen, struck and touched.\n\n"
    "In a workspace (a folder with dvc.yaml): `objectfolder add MESH ...`, then `objectfolder build`.\n\n"
    "Anywhere: `objectfolder info FILE`, `objectfolder query vision|audio|touch FILE QUERIES.npy OUT/`.",
)
query_app = typer.Typer(no_args_is_help=True, help="Ask an Object File: `vision`, `audio` or `touch`.")
app.add_typer(query_app, name="query")
sensor_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode="markdown", help="Tactile sensors: `list` profiles, `fit` one."
)
app.add_typer(sensor_app, name="sensor")
console = Console()

#: What `query touch` can write, and columns of its contacts.csv.
TOUCH_OUTPUTS = ("image", "mask", "height", "displacement", "pressure", "normals")
TOUCH_COLUMNS = {
    "force": "force_N",
    "area": "area_m2",
    "max_penetration": "max_penetration_m",
    "mean_penetration": "mean_penetration_m",
    "obstructed": "obstructed",
}


class Engine(StrEnum):
    """Where a build runs its stages."""

    LOCAL = "local"
    RAY = "ray"


FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="An ObjectFile.safetensors.")]
OutArgument = Annotated[Path, typer.Argument(metavar="OUT", help="Folder for 1.png, 2.png ... or 1.wav ...")]


def main() -> None:
    """Run the command line; user errors are one line, not a traceback."""
    try:
        app()
    except ObjectFolderError as error:
        # Escaped: messages hold lists in brackets, which rich would take for markup.
        Console(stderr=True).print(
            f"[bold red]error:[/] {escape(str(error))}", highlight=False, soft_wrap=True
        )
        sys.exit(1)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] == "objectfolder":
            raise
        sys.exit(f"error: {error.name} is not installed; this needs: pip install -e '.[build]' (make setup)")


@app.command()
def build(
    targets: Annotated[
        list[str] | None,
        typer.Argument(metavar="[TARGET]...", help="`modal@mug`, `train_audio` or `mug`; default: all."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", "-j", min=1, help="Cores to use; default: all (--engine ray: of the cluster)."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", "-f", help="Run even what is up to date.")] = False,
    keep_going: Annotated[
        bool,
        typer.Option("--keep-going/--fail-fast", help="After a failure, go on with what does not need it."),
    ] = True,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0, help="Seconds after which a stage is killed; 0: never. Default: hours, by stage."
        ),
    ] = None,
    engine: Annotated[
        Engine, typer.Option(help="Run stages on this machine, or on the nodes of a Ray cluster.")
    ] = Engine.LOCAL,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="Head of the Ray cluster; default: auto, the one this machine is in."
        ),
    ] = None,
    pull: Annotated[
        bool, typer.Option("--pull", help="First fetch what is built from DVC's default remote.")
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="If another process uses the workspace, wait; else refuse.")
    ] = False,
) -> None:
    """Build what is out of date, in parallel, through DVC's graph and cache.

    Examples: `objectfolder build -j 2`, `objectfolder build mug`, `objectfolder build modal@mug`,
    `objectfolder build --engine ray` (docs/pipeline.md: what a cluster must share).
    Logs of stages are in build/.logs. `dvc status`, `dvc repro` and `dvc metrics show` work as usual.
    """
    from objectfolder import params
    from objectfolder.artifacts import check_writable
    from objectfolder.engine.build import Options, local_workers
    from objectfolder.engine.build import build as run_build
    from objectfolder.engine.progress import Progress, print_summary
    from objectfolder.engine.ray import ray_workers
    from objectfolder.touch.profiles import load_profile, require_renderer

    if address is not None and engine is Engine.LOCAL:
        raise ObjectFolderError(f"--address {address} is for --engine ray; give both")
    values = params.read()
    params.check_all(values)
    require_renderer(load_profile(values["sensor"]), values["render_touch"]["renderer"])
    check_writable(Path("build"))
    with Progress() as progress:
        summary = run_build(
            targets or (),
            Options(jobs, force, keep_going, timeout, pull, wait),
            on_event=progress,
            make_workers=ray_workers(address or "auto") if engine is Engine.RAY else local_workers,
        )
    print_summary(summary)
    evaluated = [a.partition("@")[2] for a in summary.stages if a.startswith("evaluate@")]
    if summary.ok and evaluated:
        _print_metrics(sorted(evaluated))
    raise typer.Exit(not summary.ok)


@app.command()
def add(
    mesh: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help=".obj, .glb, .gltf, .ply, .stl or .off; a folder of them; or a catalogue (.yaml).",
        ),
    ],
    name: Annotated[str | None, typer.Option(help="Object key, such as `blue_mug`.")] = None,
    material: Annotated[str | None, typer.Option(help="ceramic, glass, wood, plastic, iron, ...")] = None,
    scale: Annotated[
        float | None, typer.Option(help="Longest side in metres; default: the mesh's own size.")
    ] = None,
    up: Annotated[str | None, typer.Option(help="Up axis, y or z; default: y for glTF, else z.")] = None,
    unit: Annotated[str, typer.Option(help="Of the mesh's coordinates: m, cm or mm.")] = "m",
    wall: Annotated[
        float | None, typer.Option(help="Thickness that open sheets get, metres; default: 2 % of the size.")
    ] = None,
    bridge: Annotated[
        str, typer.Option(help="Fill gaps under half an FEM cell: all, fem (for sound alone) or off.")
    ] = "all",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what was understood; add nothing.")
    ] = False,
) -> None:
    """Add your own mesh, a folder of meshes, or a catalogue of objects, to the workspace.

    Each mesh is loaded and closed first: what cannot be built is refused here. It is copied with the files
    that it refers to to data/objects/NAME, tracked with DVC and entered in params.yaml. Then: `objectfolder
    build NAME`.

    In a folder, each mesh file is an object, and each subfolder that holds one. --material is that of all;
    materials.csv (lines `name,material`) or materials.yaml in the folder names others.
    """
    from objectfolder import params
    from objectfolder.catalog import add_catalogue, add_mesh
    from objectfolder.intake import UNITS, Candidate, examine, table

    if mesh.suffix in (".yaml", ".yml"):
        if dry_run:
            raise ObjectFolderError(f"{mesh} is a catalogue; --dry-run is for meshes")
        added = add_catalogue(mesh)
        console.print(f"added {', '.join(added) or 'nothing new'}; next: objectfolder build")
        return
    if unit not in UNITS:
        raise ObjectFolderError(f"unit {unit!r} is not one of {', '.join(UNITS)}")
    if up not in (None, "y", "z"):
        raise ObjectFolderError(f"up axis {up!r} is neither 'y' nor 'z'")
    if bridge not in get_args(params.Bridge):
        raise ObjectFolderError(f"bridge {bridge!r} is not one of {', '.join(get_args(params.Bridge))}")
    if wall is not None and not wall > 0:
        raise ObjectFolderError(f"wall is {wall:g}, expected a thickness in metres")
    if mesh.is_dir():
        if name is not None or scale is not None:
            raise ObjectFolderError(f"{mesh} is a folder; --name and --scale are for one mesh")
        raise typer.Exit(not _add_folder(mesh, material, up, unit, wall, bridge, dry_run))
    if name is None or material is None:
        raise ObjectFolderError("a mesh needs --name and --material; see objectfolder add --help")
    finding = examine(Candidate(name, mesh, material), params.read(), scale, up, unit, wall, bridge)
    console.print(table([finding], up is not None))
    _print_notes([finding])
    if dry_run:
        return
    entry = add_mesh(mesh, name, material, finding.scale, up, wall=wall, bridge=bridge)
    console.print(
        f"added {name}: {entry['material']}, longest side {entry['scale']:.4g} m, {entry['up']} up; "
        f"next: objectfolder build {name}",
        soft_wrap=True,
    )


def _print_notes(findings) -> None:
    for finding in findings:
        if finding.notes:
            text = f"{finding.candidate.key}: {'; '.join(finding.notes)}"
            console.print(escape(text), soft_wrap=True, highlight=False)


def _add_folder(
    folder: Path,
    material: str | None,
    up: str | None,
    unit: str,
    wall: float | None,
    bridge: str,
    dry_run: bool,
) -> bool:
    """Examine and add the objects in a folder; whether none was refused."""
    from rich.progress import track

    from objectfolder import params
    from objectfolder.catalog import add_mesh
    from objectfolder.intake import discover, survey, table

    def progress(items, description, total):
        screen = Console(stderr=True)
        return track(
            items, description, total, console=screen, transient=True, disable=not screen.is_terminal
        )

    candidates = discover(folder, material)
    examined = survey(candidates, params.read(), up, unit, wall, bridge)
    findings = list(progress(examined, "examining", len(candidates)))
    console.print(table(findings, up is not None))
    refused = {f.candidate.key: f.refusal for f in findings if f.refusal is not None}
    _print_notes(findings)
    accepted = [f for f in findings if f.refusal is None]
    added = []
    for finding in progress([] if dry_run else accepted, "adding", len(accepted)):
        candidate = finding.candidate
        try:
            material = candidate.material or ""
            add_mesh(candidate.mesh, candidate.key, material, finding.scale, up, wall=wall, bridge=bridge)
            added.append(candidate.key)
        except ObjectFolderError as error:
            refused[candidate.key] = str(error)
    for key, reason in refused.items():
        console.print(f"[bold red]refused[/] {key}: {escape(reason)}", soft_wrap=True, highlight=False)
    text = f"{len(accepted)} can be added" if dry_run else f"{len(added)} added"
    text += f", {len(refused)} refused" if refused else ""
    console.print(text + ("; next: objectfolder build" if added else ""), highlight=False)
    return not refused


@app.command()
def fetch(
    objects: Annotated[
        list[str] | None, typer.Argument(metavar="OBJECT", help="Keys or published names.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Fetch every object.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="List the catalogue and stop.")] = False,
    catalogue: Annotated[Path, typer.Option(help="A catalogue of published objects.")] = Path(
        "catalogs/objectfolder1.yaml"
    ),
    directory: Annotated[
        Path | None,
        typer.Option("--from", metavar="DIR", help="Take archives or folders from here; download nothing."),
    ] = None,
    url: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SOURCE=TEMPLATE", help="Another address for a source; {model} is the id there."
        ),
    ] = None,
    accept_changed: Annotated[
        bool, typer.Option("--accept-changed", help="Take files whose recorded checksum has changed.")
    ] = False,
) -> None:
    """Fetch objects of the paper from where their meshes are published, and add them to the workspace.

    Examples: `objectfolder fetch --list`, `objectfolder fetch ycb_mug 024_bowl`,
    `objectfolder fetch --all --from ~/meshes`. What breaks off goes on with the same command.
    The meshes have their own licences, kept with each as SOURCE.txt.
    """
    from objectfolder import params
    from objectfolder.fetch import report
    from objectfolder.fetch.catalogue import read_catalogue, select
    from objectfolder.fetch.run import Status, fetch_all

    published = read_catalogue(catalogue, url or ())
    present = params.read()["objects"]
    if listing:
        report.print_catalogue(published, present, console)
        return
    keys = list(published.objects) if everything else select(published, objects or ())
    if not keys:
        report.print_overview(published, present, console)
        raise ObjectFolderError("nothing was asked for; name objects (--list shows them), or give --all")
    report.print_licences(published, [key for key in keys if key not in present], console)
    with report.download_progress(Console(stderr=True)) as reporter:
        outcomes = fetch_all(
            keys,
            published,
            directory,
            accept_changed,
            reporter=reporter,
            on_outcome=lambda outcome: report.print_outcome(outcome, console),
        )
    report.print_totals(outcomes, console)
    raise typer.Exit(any(outcome.status is Status.FAILED for outcome in outcomes))


@app.command()
def preset(name: Annotated[str, typer.Argument(help="quick, standard or paper (files in params/).")]) -> None:
    """Merge a preset into params.yaml: how many views, how fine the FEM, how long to train."""
    from objectfolder.catalog import apply_preset

    changed = apply_preset(name)
    console.print(f"preset {name}: changed {', '.join(changed) or 'nothing'}; next: objectfolder build")


@app.command()
def inspect(
    target: Annotated[str, typer.Argument(metavar="STAGE@OBJECT", help="Such as `modal@mug`.")],
    vtu: Annotated[bool, typer.Option(help="Export the solid for ParaView (voxelize).")] = False,
) -> None:
    """Show what a stage's artifacts hold: a table, and a picture beside them."""
    from objectfolder.inspection import inspect as run_inspect
    from objectfolder.inspection import print_inspection

    stage, at, key = target.partition("@")
    if not at:
        raise ObjectFolderError(f"{target!r} is not STAGE@OBJECT, such as modal@mug")
    print_inspection(run_inspect(stage, key, vtu=vtu), console)


@app.command()
def info(file: FileArgument) -> None:
    """Show what an Object File holds."""
    from objectfolder.objectfile import ObjectFile

    obj = ObjectFile.load(file)
    frequencies = obj.frequencies
    table = Table(title=f"{obj.key} ({file.stat().st_size / 1024:.0f} KB)", show_header=False)
    rows = {
        "material": obj.material,
        "longest side": f"{obj.scale:g} m",
        "geometry": f"{obj.header['geometry']['resolution']}^3 distance grid",
        "vision": f"{obj.header['vision']['kind']}, {_parameters(obj, 'vision'):,} parameters",
        "audio": f"{obj.header['audio']['kind']}, {len(frequencies)} modes"
        + (
            f" from {frequencies.min():.0f} to {frequencies.max():.0f} Hz"
            if len(frequencies)
            else " (silent)"
        ),
        "touch": f"{obj.header['touch']['kind']}, sensor {obj.sensor}",
        "schema": str(obj.header["schema"]),
    }
    for row in rows.items():
        table.add_row(*row)
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
    from objectfolder.artifacts import write_npz, write_png
    from objectfolder.objectfile import ObjectFile

    obj, rows = ObjectFile.load(file), _load_array(queries, 6)
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

    from objectfolder.artifacts import atomic
    from objectfolder.objectfile import ObjectFile

    points = _load_array(
        vertices, 3 if forces else 6, "" if forces else " (points and impulses), or give --forces"
    )
    impulse = _load_array(forces, 3) if forces else points[:, 3:]
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
    from objectfolder.artifacts import write_npz, write_png, write_table
    from objectfolder.objectfile import ObjectFile

    wanted = [name.strip() for name in outputs.split(",")]
    unknown = [name for name in wanted if name not in TOUCH_OUTPUTS]
    if unknown:
        raise ObjectFolderError(f"--outputs {unknown[0]!r} is not one of {', '.join(TOUCH_OUTPUTS)}")
    points = _load_array(vertices, 3)
    tilt, azimuth, depths = _load_array(gelinfo, 3).T if gelinfo else (0.0, 0.0, depth)
    obj = ObjectFile.load(file)
    query: dict[str, Any] = {"depth": depths, "tilt": tilt, "azimuth": azimuth, "sensor": sensor}
    if obj.header["touch"]["kind"] == "image" and wanted == ["image"]:
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


@sensor_app.command("list")
def list_sensors() -> None:
    """Show the sensor profiles that come with the package; docs/sensors.md explains their fields."""
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
        typer.Argument(metavar="IMAGE...", help="Pictures of the ball, pressed in different places."),
    ],
    radius: Annotated[float, typer.Option(help="Of the ball, metres.")],
    out: Annotated[Path, typer.Option(help="The profile to write, .yaml; two files go beside it.")],
    sensor: Annotated[str, typer.Option(help="Profile to start from: a name, or a .yaml file.")] = "digit",
    untouched: Annotated[
        Path | None, typer.Option(help="Picture of the sensor that touches nothing; else 3 images or more.")
    ] = None,
    circle: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROW,COLUMN,RADIUS",
            help="Of an imprint, pixels of the profile's images; one per image, in order. Default: found.",
        ),
    ] = None,
) -> None:
    """Fit a sensor's light intensities and background to pictures of a ball pressed on it.

    Take a steel ball of 3 to 10 mm radius. Press it about 1 mm deep, not near the border, in at least three
    different places, and take a picture of each; take one of the untouched sensor as well. Pictures show the
    sensor's view as the profile has it (`--sensor`: size, field of view, gel, where the lights are), upright,
    without automatic exposure or white balance. Then:

    `objectfolder sensor fit a.png b.png c.png --untouched rest.png --radius 0.004 --out mine.yaml`

    Writes mine.yaml, mine_background.png and mine_report.json. Lights of one colour are fitted together. In
    Python: `load_profile("mine.yaml")`. For a build: put it among objectfolder/touch/profiles/.
    """
    from objectfolder.touch.calibration import fit_sensor, save_fit
    from objectfolder.touch.photographs import read_picture
    from objectfolder.touch.profiles import load_profile

    if out.suffix not in (".yaml", ".yml"):
        raise ObjectFolderError(f"--out is {out}, expected the name of a .yaml file")
    profile = load_profile(sensor)
    pictures = np.stack([read_picture(path, profile) for path in images])
    rest = read_picture(untouched, profile) if untouched else None
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


def _load_array(path: Path, width: int, hint: str = "") -> np.ndarray:
    if not path.is_file():
        raise ObjectFolderError(f"{path} does not exist; expected a .npy file of shape (N, {width})")
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise ObjectFolderError(f"{path} is not a .npy file of numbers: {error}") from error
    if isinstance(array, np.ndarray) and array.dtype.kind not in "fiu":
        raise ObjectFolderError(f"{path} holds {array.dtype}, expected real numbers")
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] != width:
        shape = getattr(array, "shape", None)
        raise ObjectFolderError(f"{path} has shape {shape}, expected (N, {width}){hint}")
    return np.asarray(array, np.float64)


def _parameters(obj, modality: str) -> int:
    return sum(v.size for name, v in obj.tensors.items() if name.startswith(modality + "."))


def _print_metrics(keys: list[str]) -> None:
    """Print the metrics table, and where to look."""
    from objectfolder.artifacts import Build, read_json
    from objectfolder.evaluation import summary_row

    rows = [summary_row(key, read_json(Build(key).metrics)) for key in keys]
    table = Table(title="Held-out PSNR in dB / that of a baseline that knows nothing")
    for name in rows[0]:
        table.add_column(name, justify="left" if name == "object" else "right", no_wrap=name == "object")
    for row in rows:
        table.add_row(*row.values())
    console.print(table)
    for key in keys:
        b = Build(key)
        sheets = (b.views_sheet, b.touch_sheet, b.vision_sheet, b.sound_sheet)
        console.print(f"{b.object_file}  pictures: {' '.join(map(str, sheets))}", soft_wrap=True)
