"""Localization of a contact on a known object by touch, sound, sight, or several (ObjectFolder Benchmark)."""

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import Annotated, Any

from annotated_types import Ge, MultipleOf

from objectfolder.base.settings import Count, NonNegative, Positive, section
from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.benchmarks.reporting.published import LOCALIZATION
from objectfolder.benchmarks.reporting.tables import Table, format_interval
from objectfolder.benchmarks.tasks.task import Task

#: Senses that contacts are localized by. The last letter's belief counts in full beside those of others.
SENSES = {
    **{"T": "touch", "A": "sound", "V": "close view", "TA": "touch + sound", "TV": "touch + close view"},
    **{"VA": "close view + sound", "TVA": "touch + close view + sound"},
}


@section("localize")
@dataclass(frozen=True, kw_only=True)
class LocalizeConfig(TrainingConfig):
    """Section ``localize`` of ``params.yaml``."""

    epochs: Count = 30
    learning_rate: Positive = 0.003
    weight_decay: NonNegative = 0.05
    patience: Count = 30
    #: With each object: 80 % to train with, 10 % for validation, 10 % for the test, which need a sequence.
    contacts: Annotated[int, Ge(80), MultipleOf(10)] = 500


def _table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    """Lay out the scores of `objectfolder.benchmarks.tasks.localization.localize` by object."""
    rows: list[tuple[str, ...]] = []
    for senses, name in SENSES.items():
        heard = [key for key, score in scores.items() if senses in score]
        if not heard:
            continue
        found = [scores[key][senses] for key in heard]
        for key, one in zip(heard, found):
            net, nearest = one["net"], one["nearest"]
            rows.append(
                (
                    *(name, key),
                    f"{100 * net['mean']:.1f}" + format_interval(net, 100, ".1f"),
                    *(f"{100 * value:.1f}" for value in (net["median"], net["together"])),
                    *(f"{100 * nearest[kind]:.1f}" for kind in ("mean", "together")),
                    *(f"{100 * scores[key][kind]:.1f}" for kind in ("constant", "random")),
                    f"{100 * net['mean'] / scores[key]['diameter']:.1f}",
                )
            )
        if len(found) > 1:
            means = [
                *(fmean(one["net"][kind] for one in found) for kind in ("mean", "median", "together")),
                *(fmean(one["nearest"][kind] for one in found) for kind in ("mean", "together")),
                *(fmean(scores[key][kind] for key in heard) for kind in ("constant", "random")),
                fmean(scores[key][senses]["net"]["mean"] / scores[key]["diameter"] for key in heard),
            ]
            rows.append((name, f"mean of {len(found)}", *(f"{100 * value:.1f}" for value in means)))
    contacts = next(iter(scores.values()))["contacts"]
    silent = [key for key, score in scores.items() if score.get("uncertain")]
    return Table(
        "Localization of contacts: mean error in % of the longest side",
        (
            "from",
            "object",
            "net",
            "median",
            "eight",
            "nearest",
            "eight nearest",
            "constant",
            "random",
            "normalized",
        ),
        rows,
        f"{contacts['train']} contacts to train with, {contacts['val']} for validation, "
        f"{contacts['test']} for the test. Eight: after eight contacts with known moves between them. "
        "Nearest: the training contact with the most similar input, for eight a belief by similarity. "
        "Constant: the best single answer. Normalized: the net's, in % of the greatest distance between two "
        "points of the object. "
        f"The {LOCALIZATION.by} has {LOCALIZATION.listed()}, not comparable: {LOCALIZATION.cited()}."
        + (f" Without sound, since theirs is marked uncertain: {', '.join(silent)}." if silent else ""),
    )


TASK = Task(
    name="localize",
    help="""Find where a known object was touched or struck: by a touch, a sound, a close view, or several.

Prints mean errors in percent of the object's longest side, next to those of the most similar training
contact, the best constant answer and a random one.

`objectfolder bench localize --preset quick build/mug`""",
    settings=LocalizeConfig,
    training="objectfolder.benchmarks.tasks.localize_training:localize_object",
    columns=("seed", "senses", "epoch", "train_loss", "val_score"),  # minus the mean error, sides
    table=_table,
    page="Localization",
    encodes=("touch", "audio", "vision"),
    former=("localization",),
)
