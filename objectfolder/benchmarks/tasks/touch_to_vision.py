"""Close view from a touch: what would this spot look like (ObjectFolder Benchmark)?"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from objectfolder.base.settings import section
from objectfolder.benchmarks.reporting.tables import Table
from objectfolder.benchmarks.tasks.task import Task
from objectfolder.benchmarks.tasks.vision_to_touch import TranslationConfig, translation_table


@section("touch_to_vision")
@dataclass(frozen=True, kw_only=True)
class TouchToVisionConfig(TranslationConfig):
    """Section ``touch_to_vision`` of ``params.yaml``; the close views are those of ``vision_to_touch``."""


def _table(split: str, scores: Mapping[str, Any]) -> Table:
    names = {"net": "net", "nearest": "view of the most similar touch", "mean": "mean view"}
    return translation_table("Close view from a touch", names, split, scores)


TASK = Task(
    name="touch_to_vision",
    help="""Draw the close view of a contact from its tactile image.

PSNR and SSIM on held-out contacts of the training objects or of new ones, next to the view of the most
similar touch and to the mean view. The figure OUT/touch_to_vision_SPLIT.png shows touch, answer and truth.

`objectfolder bench touch-to-vision --preset quick --split unseen`""",
    settings=TouchToVisionConfig,
    training="objectfolder.benchmarks.tasks.touch_to_vision_training:touch_to_vision",
    columns=("seed", "epoch", "train_loss", "val_psnr"),  # pooled PSNR
    table=_table,
    page="Vision from touch",
    splits=("seen", "unseen"),
    samples="close_ups",
)
