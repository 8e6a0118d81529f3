"""Imagine a close view from a touch (visuo-tactile generation of the ObjectFolder Benchmark, CVPR 2023)."""

from typing import Any

from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.touch_to_vision import TouchToVisionConfig
from objectfolder.benchmarks.tasks.vision_to_touch_training import Translation, translate


def touch_to_vision(job: Job[TouchToVisionConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score a net that draws the close view of what a tactile image shows; see `translate`.

    Flat spots feel alike, so a test row is left out only if its view repeats as well.
    """
    job, counts = job.without_duplicates(("touch", "view"))
    return translate(job, Translation("touch_to_vision", "touch", "view"), counts)
