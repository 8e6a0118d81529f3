"""decompose: ObjectFile.safetensors -> hulls.npz: the surface as a few convex hulls."""

from objectfolder.benchmarks.params import robot_params
from objectfolder.envs.hulls import DecomposeConfig, convex_hulls, write_hulls
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Build
from stages import run


def main(key: str) -> None:
    build, params = Build(key), robot_params(DecomposeConfig)
    surface = ObjectFile.load(build.object_file).to_mesh()
    write_hulls(build.hulls, convex_hulls(surface, params.settings.hulls))


if __name__ == "__main__":
    run(main, __doc__)
