"""Contact refinement and surface traversal: slide a sensor to a contact (ObjectFolder Benchmark)."""

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import Annotated, Any

from annotated_types import Ge, MultipleOf

from objectfolder.base.settings import Count, NonNegative, Positive, section
from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.benchmarks.reporting.tables import Table, format_interval
from objectfolder.benchmarks.tasks.task import Task

#: What a learned policy and the pixel descent compare with the goal's.
SENSES = {"T": "touch", "V": "close view", "TV": "touch + close view"}
TITLES = {"refine": "refinement", "traverse": "traversal"}
#: Policies of the table, with the senses that they use, if any, and their names.
POLICIES = (
    *(("net", letters, f"net, {words}") for letters, words in SENSES.items()),
    *(("descent", letters, f"pixel descent, {words}") for letters, words in SENSES.items()),
    *((name, "", name) for name in ("still", "random", "oracle")),
)


@section("slide")
@dataclass(frozen=True, kw_only=True)
class SlideConfig(TrainingConfig):
    """Section ``slide`` of ``params.yaml``."""

    epochs: Count = 20
    batch: Count = 64
    learning_rate: Positive = 0.003
    weight_decay: NonNegative = 0.01
    patience: Count = 20
    contacts: Annotated[int, Ge(40), MultipleOf(40)] = 800  #: of each way, nine tenths to train with
    episodes: Count = 50  #: of each way


def _table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    """Lay out the scores of `objectfolder.benchmarks.tasks.slide_training.slide_object` by way and object."""
    rows: list[tuple[str, ...]] = []
    for way, title in TITLES.items():
        for policy, senses, name in POLICIES:
            found = {
                key: score[way][policy][senses] if senses else score[way][policy]
                for key, score in scores.items()
                if not senses or senses in score[way][policy]
            }
            rows += [(title, name, key, *_figures(one)) for key, one in found.items()]
            if len(found) > 1:
                kinds = ("success", "distance", "degrees")
                mean = {kind: fmean(one[kind] for one in found.values()) for kind in kinds}
                rows.append((title, name, f"mean of {len(found)}", *_figures(mean)))
    first = next(iter(scores.values()))
    return Table(
        "Sliding to a contact: success in %, and what is left",
        ("way", "policy", "object", "success, %", "mm", "degrees"),
        rows,
        f"{first['episodes']} episodes of each way, of at most {first['steps']} steps; {first['contacts']} "
        "contacts to learn from. Refinement: up to 3 mm and 15 degrees away, reached within 0.5 mm and 1 "
        "degree. Traversal: 5 to 15 mm along the surface, reached within 1 mm. mm and degrees: means at the "
        "end. The oracle knows where the goal is.",
    )


def _figures(score: Mapping[str, Any]) -> tuple[str, str, str]:
    share = f"{100 * score['success']:.0f}"
    if "interval_95" in score:
        share += format_interval(score, 100, ".0f")
    return share, f"{1000 * score['distance']:.1f}", f"{score['degrees']:.1f}"


TASK = Task(
    name="slide",
    help="""Slide a tactile sensor to a contact known by its reading: contact refinement, surface traversal.

A net learns from contacts of the object how far it is from one reading to another; the sensor follows its
answers. Prints how often the goal is reached by touch, by a close view and by both, next to pixel descent,
random motions and an oracle. The figure OUT/slide_OBJECT.png shows episodes.

`objectfolder bench slide --preset quick build/mug`""",
    settings=SlideConfig,
    training="objectfolder.benchmarks.tasks.slide_training:slide_object",
    columns=("seed", "way", "senses", "epoch", "train_loss", "val_score"),  # minus the mean error, steps
    table=_table,
    page="Sliding",
)
