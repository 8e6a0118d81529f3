"""reach: Object File and its hulls -> benchmarks/reach_<key>.json, .csv, .safetensors, .gif: PPO on reach."""

from objectfolder.artifacts import Build
from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.params import robot_params
from objectfolder.benchmarks.reach import run_reach
from objectfolder.envs.hulls import cached_hulls
from objectfolder.objectfile import ObjectFile
from objectfolder.params import read
from stages import run


def main(key: str) -> None:
    build, folder = Build(key), Benchmarks()
    hulls = cached_hulls(ObjectFile.load(build.object_file), folder.hulls)
    run_reach(build.object_file, hulls, reach_params(read()), folder, print)


if __name__ == "__main__":
    run(main, __doc__)
