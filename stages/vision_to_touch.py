"""vision_to_touch: close-ups of all objects -> benchmarks/vision_to_touch_<split>.json, .csv, .png."""

from objectfolder.benchmarks.datasets.observations import CloseUps
from objectfolder.benchmarks.tasks.running import run_stage
from objectfolder.benchmarks.tasks.vision_to_touch import TASK
from objectfolder.benchmarks.tasks.vision_to_touch_training import vision_to_touch
from objectfolder.workspace.layout import Benchmarks
from objectfolder.workspace.params import read
from stages import run


def main(split: str) -> None:
    samples = CloseUps({key: Benchmarks().close_ups(key) for key in read()["objects"]})
    run_stage(TASK, vision_to_touch, split, samples)


if __name__ == "__main__":
    run(main, __doc__, "split, seen or unseen")
