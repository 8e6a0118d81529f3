"""Command that renders a MuJoCo scene with its sound: simulate."""

from pathlib import Path
from typing import Annotated

import typer

from objectfolder.cli.encoding import encoder, write_video
from objectfolder.cli.files import FORMS, object_files


def simulate(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.xml", help="MuJoCo scene.")],
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE...]",
            help=f"Object Files of the bodies named by their keys, each a {FORMS}; default: samples.",
            callback=object_files,
        ),
    ] = None,
    duration: Annotated[float, typer.Option(metavar="SECONDS", help="Length of the video.")] = 5.0,
    out: Annotated[Path, typer.Option(help="Video to write, .mp4.")] = Path("clip.mp4"),
    listener: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z",
            help="Position of the listener, metres, world frame.",
            show_default="the camera's",
        ),
    ] = None,
    resolution: Annotated[
        tuple[int, int],
        typer.Option(metavar="WIDTH HEIGHT", help="Size of the frames, pixels; even numbers."),
    ] = (480, 360),
    fps: Annotated[int, typer.Option(help="Frames per second.")] = 25,
    seed: Annotated[int, typer.Option(help="Random seed of the noise of sliding and rolling.")] = 0,
) -> None:
    """Render a MuJoCo scene to video with the contact sounds of its Object Files.

    `objectfolder export mjcf` writes bodies for a scene. The simulation starts at the first keyframe, if any,
    and is seen by the first camera. Sound is scaled to a peak of 1; the pressure of the peak is
    printed. Needs the program ffmpeg; see docs/senses.md.

    Example: `objectfolder simulate scene.xml --duration 3 --out clip.mp4`
    """
    import mujoco

    from objectfolder.base.errors import ObjectFolderError, shortened
    from objectfolder.cli.console import console
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.objectfile.samples import available_samples
    from objectfolder.sim.clip import SceneCamera, default_view
    from objectfolder.sim.clip import simulate as run
    from objectfolder.sim.hearing import Hearing

    program = encoder("simulate", out, *resolution)
    try:
        model = mujoco.MjModel.from_xml_path(str(scene))
    except ValueError as error:
        raise ObjectFolderError(f"{scene}: MuJoCo cannot read it: {shortened(error, 300)}") from error
    names = {model.body(k).name.rpartition("/")[2] for k in range(model.nbody)}
    found = [ObjectFile.load(path) for path in files or []] or [
        ObjectFile.sample(name) for name in available_samples() if name in names
    ]
    if not found:
        raise ObjectFolderError(
            f"{scene}: no body is named {' or '.join(available_samples())}; give the Object Files of "
            "its bodies"
        )
    objects = {file.key: file for file in found}
    if len(objects) < len(found):
        raise ObjectFolderError(f"{', '.join(file.key for file in found)}: give each object once")
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    view = default_view(model, data, objects)
    hearing = Hearing(model, objects, view.eye if listener is None else listener, seed=seed)
    hearing.reset(data)
    take = run(model, data, hearing, duration, fps)
    loudest = float(abs(take.sound).max())
    console.print(f"loudest: {loudest:.3g} Pa", highlight=False)
    width, height = resolution
    pictures = SceneCamera(model, objects, view, height, width).pictures(take)
    track = take.sound / loudest if loudest else take.sound
    write_video(program, out, pictures, len(take.states), fps, resolution, track, round(hearing.sample_rate))
