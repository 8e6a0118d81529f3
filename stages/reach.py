"""reach: Object File and its hulls -> benchmarks/reach_<key>.json, .csv, .safetensors, .gif: PPO on reach."""

from objectfolder.benchmarks.models.settings import ReachConfig
from objectfolder.benchmarks.params import robot_params
from objectfolder.benchmarks.tasks.reach import REACH
from objectfolder.benchmarks.tasks.robots import ObjectRun
from objectfolder.benchmarks.tasks.running import run_benchmark
from objectfolder.envs.hulls import read_hulls
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Benchmarks, Build
from stages import run


def main(key: str) -> None:
    build, params = Build(key), robot_params(ReachConfig)
    file, hulls = ObjectFile.load(build.object_file), read_hulls(build.hulls)
    run_benchmark(ObjectRun(REACH, file, hulls, params, Benchmarks()), print)


if __name__ == "__main__":
    run(main, __doc__)
