"""retrieve: observations of all objects -> benchmarks/retrieve_<split>.json, .csv: by another sense."""

from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.params import object_keys, task_params
from objectfolder.benchmarks.tasks.retrieval import RETRIEVE
from objectfolder.benchmarks.tasks.retrieval_config import RetrieveConfig
from objectfolder.benchmarks.tasks.running import SplitRun, run_benchmark
from objectfolder.workspace.layout import Benchmarks
from stages import run


def main(split: str) -> None:
    params, folder = task_params(RetrieveConfig), Benchmarks()
    observations = Observations({key: folder.observations(key) for key in object_keys("retrieve")})
    run_benchmark(SplitRun(RETRIEVE, split, observations, params, folder), print)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
