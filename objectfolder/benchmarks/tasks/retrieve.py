"""Cross-sensory retrieval: find observations of the same object in another modality (supplementary I.2)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.settings import Count, Positive, section
from objectfolder.benchmarks.datasets.splits import Split
from objectfolder.benchmarks.models.settings import TouchFrameConfig, TrainingConfig
from objectfolder.benchmarks.reporting.tables import NEW_OBJECTS, Table, describe_rows, format_interval
from objectfolder.benchmarks.tasks.task import Objects, Task
from objectfolder.workspace.layout import MODALITIES

#: Mean average precision, theirs and that of their CCA; seen objects.
RETRIEVAL = {
    "V->A": (0.90, 0.57),
    "V->T": (0.50, 0.24),
    "A->V": (0.92, 0.59),
    "A->T": (0.55, 0.31),
    "T->V": (0.48, 0.29),
    "T->A": (0.64, 0.33),
}
#: Mean average precision of the best method of the ObjectFolder Benchmark (Gao et al., CVPR 2023), 200 unseen
#: objects of 1,000.
UNSEEN_RETRIEVAL = {"V->A": 0.307, "V->T": 0.124, "A->V": 0.310, "A->T": 0.090, "T->V": 0.138, "T->A": 0.154}
SAME_SENSE = ("V->V", "A->A", "T->T")
REPEATED = "repeat an input of their object, and were dropped if both inputs of a pair do"


@section("retrieve")
@dataclass(frozen=True, kw_only=True)
class RetrieveConfig(TrainingConfig, TouchFrameConfig):
    """Section ``retrieve`` of ``params.yaml``."""

    epochs: Count = 5
    patience: Count = 5
    seeds: Count = 3
    batch: Annotated[int, Ge(3)] = 32  #: pairs; each batch needs negatives
    margin: Positive = 0.5  #: of the triplet losses, cosine distance
    embedding: Count = 128  #: size of the compared embeddings
    #: in which each encoder learns to name the training objects first
    pretrain_epochs: Annotated[int, Ge(0)] = 0
    schedule: Literal["cosine", "one_cycle"] = "cosine"  #: `objectfolder.benchmarks.models.training.train`


def check_objects(split: Split, objects: Objects) -> None:
    """Raise ObjectFolderError unless there are two training objects and two to rank: each needs negatives."""
    for rows, does, role in ((split.train, "trains", "training"), (split.test, "tests", "test")):
        classes = np.unique(objects.labels[rows])
        if len(classes) < 2:
            raise ObjectFolderError(
                f"split {split.name} {does} on {objects.keys[classes[0]]} alone, expected two objects or "
                f"more; add {role} objects"
            )


def _table(split: str, scores: Mapping[str, Any]) -> Table:
    rows, new = [], split == "unseen"
    for direction in [*RETRIEVAL, *(name for name in SAME_SENSE if name in scores["directions"])]:
        score = scores["directions"][direction]
        paper = RETRIEVAL.get(direction)
        papers = ("-", "-") if paper is None else (f"{paper[0]:.2f}", f"{paper[1]:.2f}")
        ours = (_map(score), _map(score["named"]), f"{score['cca']:.3f}", f"{score['chance']:.3f}")
        unseen = UNSEEN_RETRIEVAL.get(direction)
        rows.append((direction, *ours, *(("-" if unseen is None else f"{unseen:.3f}",) if new else papers)))
    theirs = ("ObjectFolder Benchmark, 200 objects",) if new else ("paper", "paper's CCA")
    columns = ("direction", "mAP", "mAP by names", "CCA", "chance", *theirs)
    title = f"Cross-sensory retrieval, {split} objects: mean average precision"
    note = describe_rows(scores, REPEATED)
    if new:
        note += " Chance among the 200 objects of the ObjectFolder Benchmark is lower." + NEW_OBJECTS
    return Table(title, columns, rows, note)


def _map(score: Mapping[str, Any]) -> str:
    return f"{score['map']:.3f}" + format_interval(score, 1, ".3f")


TASK = Task(
    name="retrieve",
    help="""Retrieve observations of the same object in another modality, such as sounds from views.

Mean average precision for all six directions, next to CCA, chance and the paper's Table 3.

`objectfolder bench retrieve --preset quick --split unseen`""",
    settings=RetrieveConfig,
    training="objectfolder.benchmarks.tasks.retrieve_training:retrieve",
    columns=("first", "second", "seed", "epoch", "train_loss", "val_map"),
    table=_table,
    page="Retrieval",
    splits=("seen", "unseen"),
    samples="observations",
    encodes=MODALITIES,
    check=check_objects,
    former=("retrieval",),
)
