"""grasp_policy: Object File, hulls -> benchmarks/grasp_policy_<object>.json, .csv, .safetensors, .gif."""

from objectfolder.benchmarks.models.settings import GraspPolicyConfig
from objectfolder.benchmarks.params import robot_params
from objectfolder.benchmarks.tasks.grasp_policy import GRASP_POLICY
from objectfolder.benchmarks.tasks.robots import ObjectRun
from objectfolder.benchmarks.tasks.running import run_benchmark
from objectfolder.envs.hulls import read_hulls
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Benchmarks, Build
from stages import run


def main(key: str) -> None:
    build, params = Build(key), robot_params(GraspPolicyConfig)
    file, hulls = ObjectFile.load(build.object_file), read_hulls(build.hulls)
    run_benchmark(ObjectRun(GRASP_POLICY, file, hulls, params, Benchmarks()), print)


if __name__ == "__main__":
    run(main, __doc__)
