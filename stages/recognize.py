"""recognize: observations of all objects -> benchmarks/recognize_<split>.json, .csv: instance recognition."""

from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.params import object_keys, task_params
from objectfolder.benchmarks.tasks.recognition import RECOGNIZE
from objectfolder.benchmarks.tasks.recognition_config import RecognizeConfig
from objectfolder.benchmarks.tasks.running import SplitRun, run_benchmark
from objectfolder.workspace.layout import Benchmarks
from stages import run


def main(split: str) -> None:
    params, folder = task_params(RecognizeConfig), Benchmarks()
    observations = Observations({key: folder.observations(key) for key in object_keys("recognize")})
    run_benchmark(SplitRun(RECOGNIZE, split, observations, params, folder), print)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
