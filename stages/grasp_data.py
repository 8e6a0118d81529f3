"""grasp_data: Object File, hulls, surface.ply -> benchmarks/grasps/<object>: seen, felt, how it ended."""

from objectfolder.benchmarks.datasets.grasp_data import collect_grasps
from objectfolder.benchmarks.datasets.settings import GraspDataConfig
from objectfolder.mesh.ply import read_surface
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import rigid_body
from objectfolder.sim.hulls import read_hulls
from objectfolder.workspace.layout import Benchmarks, Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    build, params = Build(key), stage_params(GraspDataConfig, key)
    file = ObjectFile.load(build.object_file)
    body = rigid_body(file, read_hulls(build.hulls))
    surface = None if file.fixed_contact else read_surface(build.surface)
    collect_grasps(file, body, params.settings, params.seed, Benchmarks().grasps(key), surface)


if __name__ == "__main__":
    run(main, __doc__)
