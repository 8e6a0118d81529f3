"""voxelize: solid.ply -> solid.npz (elements); surface.ply -> sdf.npz (distance grid); voxelize.json."""

from objectfolder.base.arrays import write_npz
from objectfolder.base.io import write_json
from objectfolder.mesh.ply import read_surface
from objectfolder.sound.fem.elements import solid_arrays
from objectfolder.sound.fem.settings import VoxelizeConfig
from objectfolder.sound.fem.voxelize import voxelize
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    settings = stage_params(VoxelizeConfig, key).settings
    build = Build(key)
    surface, solid = read_surface(build.surface), read_surface(build.solid_surface)
    voxels = voxelize(surface, solid, settings, key)
    write_npz(build.solid, **solid_arrays(voxels.cells))
    write_npz(build.sdf, values=voxels.values, band=voxels.band, **vars(voxels.features))
    write_json(build.voxelize, voxels.report)


if __name__ == "__main__":
    run(main, __doc__)
