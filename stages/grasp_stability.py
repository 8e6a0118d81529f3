"""grasp_stability: grasps of all objects -> benchmarks/grasp_stability_<split>.json, .csv: will it hold?"""

from objectfolder.benchmarks.datasets.grasps import Grasps
from objectfolder.benchmarks.params import object_keys, task_params
from objectfolder.benchmarks.tasks.grasp_stability import GRASP_STABILITY
from objectfolder.benchmarks.tasks.grasp_stability_config import GraspStabilityConfig
from objectfolder.benchmarks.tasks.running import SplitRun, run_benchmark
from objectfolder.workspace.layout import Benchmarks
from stages import run


def main(split: str) -> None:
    params, folder = task_params(GraspStabilityConfig), Benchmarks()
    grasps = Grasps({key: folder.grasps(key) for key in object_keys("grasp_stability")})
    run_benchmark(SplitRun(GRASP_STABILITY, split, grasps, params, folder), print)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
