"""Grasp stability: will a grasp hold, by a view, by touch, by both (supplementary H, I.4)?"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Ge, MinLen

from objectfolder.base.settings import Count, section
from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.benchmarks.reporting.tables import Table, describe_rows, format_figure, format_interval
from objectfolder.benchmarks.tasks.task import Task

#: Rows of grasp stability, in their order.
PREDICTED_FROM = {
    "V": "vision",
    "T": "touch",
    "VT": "vision + touch",
    "T_explicit": "explicit touch",
    "VT_explicit": "vision + explicit touch",
    "T_on_explicit": "touch, tested with explicit",
    "VT_on_explicit": "vision + touch, tested with explicit",
    "majority": "commonest outcome",
    "object_majority": "commonest outcome of the object",
    "geometry": "width, offset",
    "geometry_force": "width, offset, force",
}
REPEATED = "repeat a camera picture of their object, and were dropped"


@section("grasp_stability")
@dataclass(frozen=True, kw_only=True)
class GraspStabilityConfig(TrainingConfig):
    """Section ``grasp_stability`` of ``params.yaml``."""

    epochs: Count = 6
    patience: Count = 6
    #: Training set sizes in grasps, ascending; sizes beyond the available grasps are replaced by all of them.
    sizes: Annotated[tuple[Annotated[int, Ge(2)], ...], MinLen(1)] = (100, 10_000)
    #: smaller training sets are repeated within an epoch until it has so many grasps
    epoch_grasps: Count = 400
    fusion_epochs: Count = 1  #: of vision and touch together, after each was trained alone
    hidden: Count = 128  #: units between both fully connected layers, for each of vision and touch
    #: height and width that touches are averaged to, instead of those of ``encode``
    touch: tuple[int, int] = (32, 24)

    def __post_init__(self) -> None:
        """Check the order of the sizes."""
        if list(self.sizes) != sorted(set(self.sizes)):
            raise ValueError(f"sizes: expected ascending numbers, none twice, got {list(self.sizes)}")


def _table(split: str, scores: Mapping[str, Any]) -> Table:
    """Accuracy by number of training grasps; the rest at the largest number."""
    sizes = [scores["sizes"][size] for size in sorted(scores["sizes"], key=int)]
    largest = sizes[-1]
    repeated = len(largest["V"]["seeds"]) > 1
    rows: list[tuple[str, ...]] = []
    for variant, name in PREDICTED_FROM.items():
        if variant in largest:
            cells = [_with_range(found[variant]) for found in sizes]
            best = largest[variant]
            each = " ".join(f"{100 * rate:.1f}" for rate in best["seeds"])
            cells += [format_figure(best["balanced_accuracy"], 3), format_figure(best["auc"], 3)]
            rows.append((name, *cells, *[each if len(best["seeds"]) > 1 else "-"] * repeated))
    for pair in largest["compared"]:
        first, second = pair.split(" - ")
        differences = [found["compared"][pair] for found in sizes]
        cells = [f"{100 * d['difference']:+z.1f}{format_interval(d, 100, '.1f')}" for d in differences]
        by_seed = zip(largest[first]["seeds"], largest[second]["seeds"])
        each = " ".join(f"{100 * (rate - other):+z.1f}" for rate, other in by_seed)
        name = f"{PREDICTED_FROM[first]} − {PREDICTED_FROM[second]}"
        rows.append((name, *cells, "", "", *[each] * repeated))
    heads = [
        f"{count:,}" if count == found["asked"] else f"all {count:,} (of {found['asked']:,})"
        for count, found in zip(sorted(map(int, scores["sizes"])), sizes)
    ]
    return Table(
        f"Grasp stability, {split} objects: accuracy in % by number of training grasps",
        ("from", *heads, "balanced accuracy", "AUC", *["each seed"] * repeated),
        rows,
        f"{describe_rows(scores, REPEATED)} Of the test grasps {100 * scores['success']['test']:.0f} % "
        f"succeed, of those for training {100 * scores['success']['train']:.0f} %. In brackets Wilson's "
        "95 % interval over the test rows; ± of differences: 95 %, paired by row. Balanced accuracy, "
        "AUC and each seed with the most grasps. The paper shows a figure, no numbers.",
    )


def _with_range(score: Mapping[str, Any]) -> str:
    low, high = (100 * end for end in score["wilson_95"])
    return f"{100 * score['accuracy']:.1f} ({low:.0f}-{high:.0f})"


TASK = Task(
    name="grasp_stability",
    help="""Predict whether a grasp will hold, from a view of it, the touches of both fingers, or both.

Grasps are simulated first and kept in OUT/grasps. If surface.ply lies beside the Object Files, as after a
build, the same touches are also simulated on this mesh, for comparison.

`objectfolder bench grasp-stability --preset quick`""",
    settings=GraspStabilityConfig,
    training="objectfolder.benchmarks.tasks.grasp_stability_training:grasp_stability",
    columns=("size", "seed", "variant", "epoch", "train_loss", "val_accuracy"),
    table=_table,
    page="Grasp stability",
    splits=("seen", "unseen"),
    samples="grasps",
    encodes=("vision", "touch"),
    former=("stability",),
)
