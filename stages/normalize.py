"""normalize: source mesh -> visual.glb, surface.ply (seen, touched), solid.ply (vibrates), normalize.json."""

from objectfolder.base.io import atomic, write_json
from objectfolder.base.text import visible
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.ply import write_surface
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.settings import NormalizeConfig
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    params = stage_params(NormalizeConfig, key)
    build = Build(key)
    mesh = load_mesh(params.entry.mesh, params.entry.up, params.settings.texture_size)
    wall = params.entry.wall and params.entry.wall / params.entry.scale
    bridging = params.entry.bridge != "off"
    normalized = normalize(mesh, key, wall, bridging, params.entry.scale)
    seen, solid = normalized.select_visible(params.entry.bridge), normalized.surface.mesh
    for warning in normalized.surface.warnings:
        print(f"warning: {key}: {visible(warning)}")
    with atomic(build.visual) as path:
        normalized.visual.write_glb(path)
    for target, surface in ((build.surface, seen), (build.solid_surface, solid)):
        with atomic(target) as path:
            write_surface(path, surface)
    write_json(build.normalize, normalized.report(params.entry.scale, params.entry.up))


if __name__ == "__main__":
    run(main, __doc__)
