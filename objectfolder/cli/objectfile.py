"""Commands on an Object File: info, query."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.table import Table

from objectfolder.base.arrays import read_rows
from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.cli.console import App, console, print_line
from objectfolder.cli.files import FORMS, empty_folder, object_file
from objectfolder.stored.header import PARTS, RADIATION
from objectfolder.stored.kinds import known_kinds

if TYPE_CHECKING:
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.vision.lighting import PointLight

query_app = App(help="Query an Object File: `vision`, `audio` or `touch`.")

#: Units of a sound without a listener, by response.
SOUND_UNITS = {"displacement": "m kg^1/2", "velocity": "m kg^1/2/s", "acceleration": "m kg^1/2/s^2"}
TOUCH_ARRAYS = ("height", "displacement", "pressure", "normals")
SHEAR_ARRAYS = ("sideways", "traction", "marker_flow")  #: of contacts that are sheared
TOUCH_OUTPUTS = ("image", "mask", *TOUCH_ARRAYS, *SHEAR_ARRAYS)
#: Columns of contacts.csv by attribute of the touches.
TOUCH_COLUMNS = {
    "force": "force_N",
    "area": "area_m2",
    "max_penetration": "max_penetration_m",
    "mean_penetration": "mean_penetration_m",
    "obstructed": "obstructed",
}
SHEAR_COLUMNS = {"torque": "torque_Nm", "slipping": "slipping"}
_BATCH = 64  # sheared contacts at once
_FAINTEST = 0.003  # peak of a sound, 50 dB below full scale: the noise of a quiet room

# A WAV file counts its bytes, and those of a second, in 32 bits; a sample has 4.
_MAX_RATE = 2**30 - 1
_MAX_SAMPLES = 2**30 - 100

FileArgument = Annotated[
    Path,
    typer.Argument(metavar="FILE", help=f"Object File: a {FORMS}.", callback=object_file),
]
ImagesArgument = Annotated[
    Path,
    typer.Argument(metavar="OUT", help="New or empty folder for 1.png, 2.png ...", callback=empty_folder),
]
SoundsArgument = Annotated[
    Path,
    typer.Argument(metavar="OUT", help="New or empty folder for 1.wav, 2.wav ...", callback=empty_folder),
]


def info(file: FileArgument) -> None:
    """Show the contents of an Object File."""
    from objectfolder.objectfile.file import ObjectFile

    obj = ObjectFile.load(file)
    table = Table(title=f"{obj.key} ({file.stat().st_size / 1000:.0f} kB)", show_header=False)
    rows = {"material": obj.material, "longest side": f"{obj.scale:g} m"}
    if {"solid", "material_properties"} <= obj.header.keys():
        volume, given = obj.header["solid"]["volume"] * obj.scale**3, obj.header.get("mass")
        rows["mass"] = f"{obj.header['material_properties']['density'] * volume:.3g} kg"
        if given is not None:
            rows["mass"] = f"{given:.3g} kg (given; solid volume x density would be {rows['mass']})"
    rows |= {part: _summary_of(obj, part) for part in PARTS}
    heard = RADIATION in obj.header
    rows[RADIATION] = obj.header[RADIATION]["kind"] if heard else "none: no sound at a listener"
    rows["format"] = obj.header["format"]
    for name, value in rows.items():
        table.add_row(name, value)
    console.print(table)


@query_app.command()
def vision(
    file: FileArgument,
    queries: Annotated[
        Path,
        typer.Argument(
            metavar="QUERIES.npy",
            help="(N, 6): camera xyz, light xyz; with --lights or --environment (N, 3): camera xyz.",
        ),
    ],
    out: ImagesArgument,
    resolution: Annotated[int, typer.Option(min=1, help="Side of the square images, pixels.")] = 256,
    buffers: Annotated[
        bool, typer.Option("--buffers", help="Also write 1.npz ...: linear rgba, depth (metres), normals.")
    ] = False,
    supersample: Annotated[bool, typer.Option(help="Smooth edges; without it, rendering is faster.")] = True,
    lights: Annotated[
        str | None,
        typer.Option(
            metavar="studio|FILE.npy",
            help="Lights of all views: studio, or a file (L, 6): position xyz, linear RGB.",
        ),
    ] = None,
    environment: Annotated[
        Path | None,
        typer.Option(help="Environment map that lights all views: equirectangular, .hdr or .exr."),
    ] = None,
) -> None:
    """Render views of an object. Positions are in the unit frame: the longest side is 1."""
    from objectfolder.base.arrays import write_npz, write_png
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.vision.cameras import Intrinsics
    from objectfolder.vision.environment import gather_lamps
    from objectfolder.vision.query import LitCameras

    given = lights is not None or environment is not None
    hint = ", cameras, beside --lights or --environment" if given else ", or give --lights"
    obj, rows = ObjectFile.load(file), read_rows(queries, 3 if given else 6, hint)
    lamps = gather_lamps(read_lamps(lights), environment)
    # Checked together, so that a bad row leaves no files; drawn one by one, which takes less memory.
    square = Intrinsics.square(resolution)
    cameras = LitCameras.checked(rows[:, :3], None if given else rows[:, 3:], lamps, square)
    for i, (pose, lit_by) in enumerate(cameras, 1):
        views = obj.render(pose, None, resolution, supersample=supersample, lights=lit_by)
        write_png(out / f"{i}.png", (views.rgb[0] * 255).round().astype(np.uint8))
        if buffers:
            write_npz(out / f"{i}.npz", rgba=views.rgba[0], depth=views.depth[0], normals=views.normals[0])
    print_line(f"{plural(len(rows), 'view')} in {out}/")


def read_lamps(lights: str | None) -> "str | list[PointLight] | None":
    """Return the lights that an option names: "studio", or those of a file."""
    if lights is None or lights == "studio":
        return lights
    from objectfolder.vision.lighting import PointLight

    if not Path(lights).exists():
        raise ObjectFolderError(f"--lights {lights} does not exist; expected studio, or a .npy file (L, 6)")
    rows = read_rows(lights, 6, ", position xyz and linear RGB; or give --lights studio")
    return [PointLight(row[:3], row[3:]) for row in rows]


@query_app.command()
def audio(
    file: FileArgument,
    vertices: Annotated[
        Path,
        typer.Argument(
            metavar="VERTICES.npy", help="(N, 3) points in metres, or (N, 6) with impulses in N s."
        ),
    ],
    out: SoundsArgument,
    forces: Annotated[
        Path | None,
        typer.Option(
            metavar="FORCES.npy", help="(N, 3) impulses in N s; default: columns 4 to 6 of VERTICES."
        ),
    ] = None,
    sample_rate: Annotated[
        int, typer.Option(min=1, max=_MAX_RATE, metavar="HZ", help="Samples per second.")
    ] = 16000,
    duration: Annotated[float, typer.Option(metavar="SECONDS", help="Length of each sound.")] = 2.0,
    response: Annotated[
        str,
        typer.Option(
            metavar="RESPONSE",
            help="Without --listener: displacement, velocity or acceleration of the modes.",
        ),
    ] = "displacement",
    contact_time: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="Duration of the strike; 0: an ideal impulse; default: the striker's."
        ),
    ] = None,
    material: Annotated[
        str | None,
        typer.Option(
            metavar="MATERIAL", help="Another material: a name, or a YAML file; default: the object's own."
        ),
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Another longest side, with VERTICES on the object of this size; default: its own.",
        ),
    ] = None,
    striker: Annotated[
        str | None,
        typer.Option(
            metavar="STRIKER",
            help="What strikes: steel (default), wood, rubber, finger or a YAML file. Sets the contact time.",
        ),
    ] = None,
    listener: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z", help="Position of a listener, metres: write the sound pressure there, Pa."
        ),
    ] = None,
    normalize: Annotated[bool, typer.Option(help="Scale all sounds by their common peak.")] = False,
) -> None:
    """Write the sounds of strikes as WAV files. `objectfolder sample audio` makes strikes.

    `objectfolder query audio mug VERTICES.npy OUT/ --sample-rate 48000 --listener 0.5 0 0.3 --normalize`

    Amplitudes are absolute: most are too faint or too loud for a player without `--normalize`.
    """
    from objectfolder.base.arrays import wav_bytes
    from objectfolder.base.io import write_bytes
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.sound.synthesis import count_samples

    points = read_rows(
        vertices, 3 if forces else 6, "" if forces else " (points and impulses), or give --forces"
    )
    impulses = read_rows(forces, 3) if forces else points[:, 3:]
    obj = ObjectFile.load(file)
    if count_samples(sample_rate, duration) > _MAX_SAMPLES:
        raise ObjectFolderError(
            f"--duration {duration:g} at --sample-rate {sample_rate}: a WAV file holds at most "
            f"{_MAX_SAMPLES:,} samples; ask for a shorter duration or a lower rate"
        )
    sounds = obj.impact(
        points[:, :3],
        impulses,
        sample_rate,
        duration,
        response,
        contact_time=contact_time,
        material=material,
        scale=scale,
        striker=striker,
        listener=listener,
    )
    own = material is None and scale is None
    frequencies = obj.frequencies if own else obj.tuning(material, scale).frequencies.numpy()
    peak = float(np.abs(sounds).max(initial=0))
    if normalize and peak > 0:
        sounds = sounds / peak * 0.9
    for i, sound in enumerate(sounds, 1):
        write_bytes(out / f"{i}.wav", wav_bytes(sound, sample_rate))
    loudest = _peak_summary(peak, response, listener is not None, normalize)
    modes = _mode_summary(frequencies, sample_rate)
    print_line(f"{plural(len(sounds), 'sound')} in {out}/, {loudest}; {modes}")
    if not normalize and (peak > 1 or 0 < peak < _FAINTEST):
        limit = "above full scale: players clip it" if peak > 1 else "too faint to be heard"
        warning = f"warning: a peak of {peak:.3g} is {limit}; give --normalize to listen"
        console.print(warning, style="yellow", soft_wrap=True, highlight=False)


@query_app.command()
def touch(
    file: FileArgument,
    vertices: Annotated[Path, typer.Argument(metavar="VERTICES.npy", help="(N, 3) contact points, metres.")],
    out: ImagesArgument,
    gelinfo: Annotated[
        Path | None,
        typer.Option(
            metavar="GELINFO.npy",
            help="(N, 3): tilt theta, its direction phi (both in radians), press depth (metres).",
        ),
    ] = None,
    depth: Annotated[float, typer.Option(metavar="METRES", help="Press depth, without --gelinfo.")] = 0.001,
    sensor: Annotated[
        str | None,
        typer.Option(metavar="SENSOR", help="Another sensor: a name (`sensor list`) or a .yaml file."),
    ] = None,
    outputs: Annotated[
        str, typer.Option(metavar="NAME,...", help=f"What to write: {', '.join(TOUCH_OUTPUTS)}.")
    ] = "image",
    shear: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="RIGHT UP", help="Motion of the object in the image after the press, metres."),
    ] = None,
    twist: Annotated[
        float, typer.Option(metavar="RADIANS", help="Rotation of the object in the image after the press.")
    ] = 0.0,
    friction: Annotated[
        float | None, typer.Option(help="Coefficient of friction; default: the material's.")
    ] = None,
    markers: Annotated[
        bool, typer.Option("--markers", help="Draw the gel's markers into the images.")
    ] = False,
) -> None:
    """Press a tactile sensor on an object, and optionally shear the contact.

    Writes 1.png ... (image), 1_mask.png ... (mask: the contact area of gel and object), 1.npz ... (height and
    displacement in metres, pressure in Pa, normals of the gel), and contacts.csv with the force, area,
    penetration and obstruction of each contact. With --shear, --twist or --markers also the gel's motion
    sideways (metres), traction (Pa), marker_flow and the markers at rest (pixels), shear force and torque.
    docs/touch.md defines them.
    """
    from objectfolder.base.arrays import write_png
    from objectfolder.base.io import write_table
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.touch.query import ContactPoses

    names = [name.strip() for name in outputs.split(",")]
    unknown = [name for name in names if name not in TOUCH_OUTPUTS]
    if unknown:
        raise ObjectFolderError(f"--outputs {unknown[0]!r} is not one of {', '.join(TOUCH_OUTPUTS)}")
    moved = shear is not None or twist != 0 or markers
    if not moved and (of_motion := [name for name in names if name in SHEAR_ARRAYS]):
        raise ObjectFolderError(f"--outputs {of_motion[0]} needs --shear, --twist or --markers")
    if friction is not None and shear is None and twist == 0:
        raise ObjectFolderError("--friction has an effect only with --shear or --twist")
    points = read_rows(vertices, 3)
    tilt, azimuth, depths = read_rows(gelinfo, 3).T if gelinfo else (0.0, 0.0, depth)
    obj = ObjectFile.load(file)
    query: dict[str, Any] = {"depth": depths, "tilt": tilt, "azimuth": azimuth, "sensor": sensor}
    if obj.fixed_contact is not None and names == ["image"] and not moved:
        images = obj.touch(points, **query)
        for i, image in enumerate(images, 1):
            write_png(out / f"{i}.png", image)
        print_line(f"{plural(len(images), 'tactile image')} in {out}/")
        return
    if moved:
        others: dict[str, Any] = {"sensor": sensor, "shear": shear, "twist": twist}
        others |= {"friction": friction, "markers": markers}
        obj.touches(points, **query)  # checks all contacts before any is written
        contacts = ContactPoses.checked(points, depths, 0.0, tilt, azimuth)
        batches: Iterator[Any] = (
            obj.press(**vars(contacts[start : start + _BATCH]), **others)
            for start in range(0, len(points), _BATCH)
        )
        columns, forces = TOUCH_COLUMNS | SHEAR_COLUMNS, ["shear_right_N", "shear_up_N"]
    else:
        batches, columns, forces = obj.touches(points, **query), TOUCH_COLUMNS, []
    rows: list[list[float]] = []
    for batch in batches:
        for i in range(len(batch.images)):
            number = len(rows) + 1
            _write_touch(out, number, batch, i, names)
            sideways = batch.shear_force[i].tolist() if moved else []
            rows.append([number, *(float(getattr(batch, column)[i]) for column in columns), *sideways])
    write_table(out / "contacts.csv", ["contact", *columns.values(), *forces], rows)
    print_line(f"{plural(len(rows), 'contact')} in {out}/{_contact_summary(np.array(rows))}")


def _write_touch(out: Path, number: int, batch: Any, row: int, names: list[str]) -> None:
    from objectfolder.base.arrays import write_npz, write_png

    if "image" in names:
        write_png(out / f"{number}.png", batch.images[row])
    if "mask" in names:
        write_png(out / f"{number}_mask.png", batch.mask[row].astype(np.uint8) * 255)
    arrays = {name: getattr(batch, name)[row] for name in (*TOUCH_ARRAYS, *SHEAR_ARRAYS) if name in names}
    if "marker_flow" in arrays:
        arrays["markers"] = batch.markers
    if arrays:
        write_npz(out / f"{number}.npz", **arrays)


def _peak_summary(peak: float, response: str, heard: bool, normalized: bool) -> str:
    if not peak:
        return "peak 0: silent"
    unit = "Pa" if heard else SOUND_UNITS[response]
    return f"peak {peak:.3g} {unit}" + (" before normalizing" if normalized else "")


def _mode_summary(frequencies: np.ndarray, sample_rate: int) -> str:
    above = int((frequencies >= sample_rate / 2).sum())
    left_out = f", {above} left out above half the sample rate, {sample_rate / 2:g} Hz" if above else ""
    return plural(len(frequencies), "mode") + left_out


def _contact_summary(rows: np.ndarray) -> str:
    if not len(rows):
        return ""
    columns = dict(zip(TOUCH_COLUMNS, rows.T[1:], strict=False))
    force, area = columns["force"], columns["area"] * 1e6
    text = "" if np.isnan(force).any() else f"; force {force.min():.3g} to {force.max():.3g} N"
    text += f", area {area.min():.3g} to {area.max():.3g} mm2"
    obstructed = int((columns["obstructed"] > 0).sum())
    return text + (f"; {obstructed} obstructed: a real sensor could not reach them" if obstructed else "")


def _summary_of(obj: "ObjectFile", part: str) -> str:
    """Describe a part in a line, reading no tensors but the modes."""
    from objectfolder.sound.fem.certainty import MAX_UNWARNED_ERROR

    if part not in obj.header:
        return "none"
    kind = obj.header[part]["kind"]
    if kind not in known_kinds(part):
        return f"{kind}, unknown to this version"
    if part == "geometry":
        return f"{kind}, {obj.header[part]['resolution']}^3"
    if part == "touch":
        return f"{kind}, sensor {obj.sensor}"
    if part == "vision":
        return kind
    frequencies = obj.frequencies
    if not len(frequencies):
        heard = "silent, but for its recoil at a listener" if "radiation" in obj.header else "silent"
        return f"{kind}, no modes: {heard}" if obj.has_modes else kind
    described = obj.header[part]
    error = described.get("frequency_uncertainty")
    certain = ""
    if error is not None and error > MAX_UNWARNED_ERROR:
        certain = f", the lowest ten may be {error:.0%} wrong"
    elif error is not None:
        certain = ", lowest ten within " + ("0.1%" if error < 1e-3 else f"about {error:.1%}")
    if described.get("frequency_uncertainty_unknown"):
        certain = ", of unknown error: walls are too thin for the grid"
    if described.get("uncertain"):
        certain += "; the sound is marked uncertain"
    span = f"{frequencies.min():.0f} to {frequencies.max():.0f} Hz"
    cut = f", truncated above {described['band_hz'][1]:.0f} Hz" if described.get("truncated") else ""
    return f"{kind}, {plural(len(frequencies), 'mode')} from {span}{cut}{certain}"
