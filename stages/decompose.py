"""decompose: ObjectFile.safetensors -> hulls.npz: the surface as a few convex hulls."""

from objectfolder.benchmarks.datasets.settings import DecomposeConfig
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.hulls import convex_hulls, write_hulls
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    build, params = Build(key), stage_params(DecomposeConfig, key)
    surface = ObjectFile.load(build.object_file).to_mesh()
    write_hulls(build.hulls, convex_hulls(surface, params.settings.hulls))


if __name__ == "__main__":
    run(main, __doc__)
