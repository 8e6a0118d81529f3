"""Touch from a close view: what would this spot feel like (ObjectFolder Benchmark)?

`objectfolder.benchmarks.tasks.touch_to_vision` is the other way round, with the same net and close views.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Ge, MultipleOf

from objectfolder.base.settings import Count, NonNegative, Positive, section
from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.benchmarks.reporting.tables import NEW_OBJECTS, Table, format_interval
from objectfolder.benchmarks.tasks.task import Task


@dataclass(frozen=True, kw_only=True)
class TranslationConfig(TrainingConfig):
    """Training of a net that draws one picture from another."""

    epochs: Count = 8
    learning_rate: Positive = 0.004
    weight_decay: NonNegative = 0.05
    patience: Count = 8
    width: Count = 16  #: channels of the net at full size


@section("vision_to_touch")
@dataclass(frozen=True, kw_only=True)
class VisionToTouchConfig(TranslationConfig):
    """Section ``vision_to_touch`` of ``params.yaml``."""

    contacts: Annotated[int, Ge(10), MultipleOf(10)] = 100  #: with each object


def translation_table(title: str, names: Mapping[str, str], split: str, scores: Mapping[str, Any]) -> Table:
    """Lay out scores of pictures; ``names`` of the answers ``net``, ``nearest`` and ``mean``."""
    rows = []
    for kind, name in names.items():
        score = scores[kind]
        figures = (f"{score['psnr_pooled']:.1f}", f"{score['ssim']:.3f}")
        spread = format_interval(score, 1, ".1f") if kind == "net" else ""
        rows.append((name, f"{score['psnr']:.1f}" + spread, *figures))
    counts = scores["rows"]
    return Table(
        f"{title}, {split} objects",
        ("", "PSNR, dB", "PSNR, pooled", "SSIM"),
        rows,
        f"{scores['objects']} objects; {counts['train']:,} contacts to train with, {counts['val']:,} for "
        f"validation, {counts['test']:,} for the test. All presses are 1 mm deep."
        + NEW_OBJECTS
        * (split == "unseen"),
    )


def _table(split: str, scores: Mapping[str, Any]) -> Table:
    names = {"net": "net", "nearest": "touch of the most similar view", "mean": "mean touch"}
    return translation_table("Touch from a close view", names, split, scores)


TASK = Task(
    name="vision_to_touch",
    help="""Draw the tactile image of a contact from a close view of it.

Prints PSNR and SSIM on held-out contacts of the training objects or of new ones, next to the touch of the
most similar view and the mean touch. The figure OUT/vision_to_touch_SPLIT.png shows view, prediction and
truth.

`objectfolder bench vision-to-touch --preset quick --split unseen`""",
    settings=VisionToTouchConfig,
    training="objectfolder.benchmarks.tasks.vision_to_touch_training:vision_to_touch",
    columns=("seed", "epoch", "train_loss", "val_psnr"),  # pooled PSNR
    table=_table,
    page="Touch from vision",
    splits=("seen", "unseen"),
    samples="close_ups",
)
