"""render_touch: surface.ply, sensor profile -> touch/{train,val,test}.npz, touch.png (a contact sheet)."""

from objectfolder.base.arrays import write_npz, write_png
from objectfolder.base.figures import tile
from objectfolder.base.seeding import numpy_generator
from objectfolder.mesh.ply import read_surface
from objectfolder.touch.profiles import load_profile
from objectfolder.touch.settings import RenderTouchConfig
from objectfolder.touch.truth import draw_contacts, render_contacts
from objectfolder.workspace.installed import sensor_file
from objectfolder.workspace.layout import SPLITS, Build
from objectfolder.workspace.params import stage_params
from stages import progress, run


def main(key: str) -> None:
    params = stage_params(RenderTouchConfig, key)
    build, settings = Build(key), params.settings
    vertices, faces = read_surface(build.surface)
    profile = load_profile(sensor_file(params.sensor))
    rng = numpy_generator(params.seed, key, "render_touch")
    places = draw_contacts(vertices, faces, settings, rng)
    for split, (points, normals) in zip(SPLITS, places):
        contacts = render_contacts(
            vertices,
            faces,
            params.entry.scale,
            points,
            profile,
            numpy_generator(params.seed, key, "render_touch", split),
            settings.renderer,
            settings.depth,
            settings.angle,
            progress(f"{key}: {split} touches"),
            normals,
        )
        write_npz(build.touch(split), **contacts, renderer=settings.renderer)
    write_png(build.touch_sheet, tile(contacts["images"][:36], columns=12))


if __name__ == "__main__":
    run(main, __doc__)
