"""Command that fits an object's material to recordings of it."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from objectfolder.cli.console import App, print_line, print_wide
from objectfolder.cli.files import OWN, object_key

fit_app = App(
    help="Fit an object to measurements of the real one: `sound`, to recordings of taps.",
)
#: Score of the next best stiffness, relative to the best, from which on the fit may be wrong.
RIVAL_LIMIT = 0.6


@fit_app.callback()
def _group() -> None:
    """Keep `sound` a command of its own."""


@fit_app.command()
def sound(
    key: Annotated[
        str, typer.Argument(metavar="OBJECT", help=f"Built object: its {OWN}.", callback=object_key)
    ],
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="WAV, FLAC, OGG or M4A files of taps.")
    ],
    law: Annotated[str, typer.Option(metavar="loss_factor|rayleigh", help="Damping model.")] = "loss_factor",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the fit; change nothing.")] = False,
) -> None:
    """Fit stiffness and damping of an object to recordings of taps, and write them to params.yaml.

    Hang the object on a thread or lay it on foam, so that it rings freely, and tap it at several points with
    something hard and small: one or more taps per file, at least a second apart, without clipping. Then:

    `objectfolder fit sound mug tap1.wav tap2.wav`

    The modes heard are matched to those of the object's last build; modes below 200 Hz are not used. Size,
    density and Poisson's ratio stay as they are. The next build rescales the modes; it does not solve them
    again.
    """
    import numpy as np

    from objectfolder.base.arrays import read_npz
    from objectfolder.base.checks import one_of
    from objectfolder.base.io import check_output, read_json
    from objectfolder.base.materials import LAWS, Material
    from objectfolder.sound.fitting import ECHO, fit_sound
    from objectfolder.sound.recordings import read_recording, resample_to_lowest
    from objectfolder.sound.ringdown import LN_1000
    from objectfolder.workspace import params
    from objectfolder.workspace.check import check_object
    from objectfolder.workspace.layout import Build
    from objectfolder.workspace.objects import set_material

    one_of("--law", law, LAWS)
    check_object(key, params.read())
    if not dry_run:
        check_output(params.PARAMS_FILE)
    build = Build(key)
    report, modes = read_json(build.modal), read_npz(build.modes, "eigenvalues")
    sounds, rate = resample_to_lowest([read_recording(path) for path in recordings], recordings)
    computed = np.sqrt(modes["eigenvalues"]) / (2 * np.pi)
    solid = Material(report["material"], **report["material_properties"])
    fit = fit_sound(computed, solid, sounds, rate, law)
    match, heard = fit.match, fit.heard

    table = Table(title=f"{key}: {len(match.heard)} of {len(heard.frequency)} heard modes matched")
    for title in ("computed Hz", "heard Hz", "left after the fit", "T60 s", "by the fitted law"):
        table.add_column(title, justify="right")
    for row, found, residual, decay in zip(match.computed, match.heard, match.residual, fit.decay_time):
        table.add_row(
            f"{computed[row]:.1f}",
            f"{heard.frequency[found]:.1f}",
            f"{residual:+.2%}",
            f"{LN_1000 / heard.damping[found]:.3g}",
            f"{decay:.3g}",
        )
    print_wide(table)
    left = ", ".join(f"{heard.frequency[row]:.0f}" for row in fit.left_out)
    lines = [
        *(f"{path}: no tap found, left out" for path, count in zip(recordings, fit.taps) if not count),
        f"stiffness: {match.stiffness:.4f} times that of {report['material']} as built; frequencies then "
        f"differ by {fit.frequency_error:.2%} (root mean square)",
        f"not matched, Hz: {left or 'none'}",
        f"modes below 200 Hz are not used: {(computed < 200).sum()} of {len(computed)} computed ones",
        f"material: {fit.material}",
    ]
    if match.rival > RIVAL_LIMIT:
        lines.append(
            f"uncertain: another stiffness matches {match.rival:.0%} as well; give more recordings, or check "
            "the size"
        )
    if fit.unexplained > ECHO:
        lines.append(
            f"uncertain: {fit.unexplained:.1%} of the rings is no exponential decay, as with echoes, rattles "
            "or a held object: T60 may be several times wrong; record closer, without echo, the object free"
        )
    for line in lines:
        print_line(line)
    if dry_run:
        return
    set_material(key, fit.material)
    print_line(f"wrote objects.{key}.material to {params.PARAMS_FILE}; next: objectfolder build {key}")
