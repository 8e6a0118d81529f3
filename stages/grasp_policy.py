"""grasp_policy: Object File, hulls -> benchmarks/grasp_policy_<object>.json, .csv, .safetensors, .gif."""

from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.models.trpo import GraspPolicyConfig
from objectfolder.benchmarks.params import robot_params
from objectfolder.benchmarks.tasks.grasp_policy import run_grasp_policy
from objectfolder.envs.hulls import read_hulls
from objectfolder.workspace.layout import Build
from stages import run


def main(key: str) -> None:
    build = Build(key)
    params = robot_params(GraspPolicyConfig)
    run_grasp_policy(build.object_file, read_hulls(build.hulls), params, Benchmarks(), print)


if __name__ == "__main__":
    run(main, __doc__)
