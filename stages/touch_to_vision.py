"""touch_to_vision: close-ups of all objects -> benchmarks/touch_to_vision_<split>.json, .csv, .png."""

from objectfolder.benchmarks.datasets.observations import CloseUps
from objectfolder.benchmarks.tasks.running import run_stage
from objectfolder.benchmarks.tasks.touch_to_vision import TASK
from objectfolder.benchmarks.tasks.touch_to_vision_training import touch_to_vision
from objectfolder.workspace.layout import Benchmarks
from objectfolder.workspace.params import read
from stages import run


def main(split: str) -> None:
    samples = CloseUps({key: Benchmarks().close_ups(key) for key in read()["objects"]})
    run_stage(TASK, touch_to_vision, split, samples)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
