"""reconstruct: observations of all objects -> benchmarks/reconstruct_<split>.{json,csv,safetensors,png}."""

from objectfolder.benchmarks.datasets.observations import certain_observations
from objectfolder.benchmarks.tasks.reconstruct import TASK
from objectfolder.benchmarks.tasks.reconstruct_training import reconstruct
from objectfolder.benchmarks.tasks.running import run_stage
from objectfolder.workspace.layout import Benchmarks
from objectfolder.workspace.params import read
from stages import run


def main(split: str) -> None:
    samples = certain_observations({key: Benchmarks().observations(key) for key in read()["objects"]})
    run_stage(TASK, reconstruct, split, samples)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
