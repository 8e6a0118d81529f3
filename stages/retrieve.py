"""retrieve: observations of all objects -> benchmarks/retrieve_<split>.json, .csv: by another sense."""

from objectfolder.benchmarks.datasets.observations import certain_observations
from objectfolder.benchmarks.tasks.retrieve import TASK
from objectfolder.benchmarks.tasks.retrieve_training import retrieve
from objectfolder.benchmarks.tasks.running import run_stage
from objectfolder.workspace.layout import Benchmarks
from objectfolder.workspace.params import read
from stages import run


def main(split: str) -> None:
    samples = certain_observations({key: Benchmarks().observations(key) for key in read()["objects"]})
    run_stage(TASK, retrieve, split, samples)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
