"""normalize: source mesh -> visual.glb (unit cube), surface.ply (closed), normalize.json."""

from objectfolder.artifacts import Build, atomic, write_json
from objectfolder.mesh.load import load_mesh
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.surface import write_surface
from objectfolder.params import stage_params
from stages import run


def main(key: str) -> None:
    params = stage_params("normalize", key)
    build = Build(key)
    mesh = load_mesh(params.object.mesh, params.object.up, params.section.texture_size)
    normalized = normalize(mesh, key)
    with atomic(build.visual) as path:
        normalized.visual.write_glb(path)
    with atomic(build.surface) as path:
        write_surface(path, normalized.surface)
    write_json(build.normalize, normalized.report(params.object.scale, params.object.up))


if __name__ == "__main__":
    run(main, __doc__)
