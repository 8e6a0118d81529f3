"""grasp_stability: grasps of all objects -> benchmarks/grasp_stability_<split>.json, .csv: will it hold?"""

from objectfolder.benchmarks.datasets.grasps import Grasps
from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.params import stage_params
from objectfolder.benchmarks.tasks.grasp_stability import CURVE_COLUMNS, grasp_stability
from objectfolder.benchmarks.tasks.running import run_task
from stages import run


def main(split: str) -> None:
    params, folder = stage_params("grasp_stability"), Benchmarks()
    grasps = Grasps({key: folder.grasps(key) for key in params.keys})
    run_task("grasp_stability", grasp_stability, CURVE_COLUMNS, split, grasps, params, folder, print)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
