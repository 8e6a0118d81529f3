"""reconstruct: observations of all objects -> benchmarks/reconstruct_<split>.{json,csv,safetensors,png}."""

from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.params import object_keys, task_params
from objectfolder.benchmarks.tasks.reconstruction import RECONSTRUCT
from objectfolder.benchmarks.tasks.reconstruction_config import ReconstructConfig
from objectfolder.benchmarks.tasks.running import SplitRun, run_benchmark
from objectfolder.workspace.layout import Benchmarks
from stages import run


def main(split: str) -> None:
    params, folder = task_params(ReconstructConfig), Benchmarks()
    observations = Observations({key: folder.observations(key) for key in object_keys("reconstruct")})
    run_benchmark(SplitRun(RECONSTRUCT, split, observations, params, folder), print)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
