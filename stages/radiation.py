"""radiation: surface, modes, scale -> radiation.safetensors."""

from objectfolder.base.arrays import read_npz, write_safetensors
from objectfolder.mesh.ply import read_surface
from objectfolder.sound.radiation.radiation import pack_radiation, radiate
from objectfolder.sound.radiation.settings import RadiationConfig
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    params = stage_params(RadiationConfig, key)
    build, scale = Build(key), params.entry.scale
    vertices, faces = read_surface(build.surface)
    modes = read_npz(build.modes, "points", "shapes", "damped_frequency")
    surface = vertices * scale, faces
    field = radiate(
        surface,
        modes["points"] * scale,
        modes["shapes"],
        modes["damped_frequency"],
        params.settings.triangles,
    )
    tensors, header = pack_radiation(field, surface, scale, 1000 * params.settings.kilobytes)
    write_safetensors(build.radiation, tensors, header)


if __name__ == "__main__":
    run(main, __doc__)
