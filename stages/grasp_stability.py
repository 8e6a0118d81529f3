"""grasp_stability: grasps of all objects -> benchmarks/grasp_stability_<split>.json, .csv: will it hold?"""

from objectfolder.benchmarks.datasets.grasps import Grasps
from objectfolder.benchmarks.tasks.grasp_stability import TASK
from objectfolder.benchmarks.tasks.grasp_stability_training import grasp_stability
from objectfolder.benchmarks.tasks.running import run_stage
from objectfolder.workspace.layout import Benchmarks
from objectfolder.workspace.params import read
from stages import run


def main(split: str) -> None:
    samples = Grasps({key: Benchmarks().grasps(key) for key in read()["benchmarks"]["grasp_data"]})
    run_stage(TASK, grasp_stability, split, samples)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
