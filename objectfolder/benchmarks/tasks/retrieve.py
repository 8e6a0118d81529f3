"""Cross-sensory retrieval: find observations of the same object in another modality (supplementary I.2)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.settings import Count, Positive, section
from objectfolder.benchmarks.datasets.splits import Split
from objectfolder.benchmarks.models.settings import TouchFrameConfig
from objectfolder.benchmarks.reporting.published import RETRIEVAL, UNSEEN_RETRIEVAL
from objectfolder.benchmarks.reporting.tables import NEW_OBJECTS, Table, describe_rows, format_interval
from objectfolder.benchmarks.tasks.task import Objects, Task
from objectfolder.workspace.layout import MODALITIES

DIRECTIONS = ("V->A", "V->T", "A->V", "A->T", "T->V", "T->A")
SAME_SENSE = ("V->V", "A->A", "T->T")
REPEATED = "repeat an input of their object, and were dropped if both inputs of a pair do"


@section("retrieve")
@dataclass(frozen=True, kw_only=True)
class RetrieveConfig(TouchFrameConfig):
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
    rows = []
    for direction in [*DIRECTIONS, *(name for name in SAME_SENSE if name in scores["directions"])]:
        score = scores["directions"][direction]
        ours = (_map(score), _map(score["named"]), f"{score['cca']:.3f}", f"{score['chance']:.3f}")
        rows.append((direction, *ours))
    return Table(
        f"Cross-sensory retrieval, {split} objects: mean average precision",
        ("direction", "mAP", "mAP by names", "CCA", "chance"),
        rows,
        describe_rows(scores, REPEATED) + NEW_OBJECTS * (split == "unseen"),
    )


def _map(score: Mapping[str, Any]) -> str:
    return f"{score['map']:.3f}" + format_interval(score, 1, ".3f")


TASK = Task(
    name="retrieve",
    help="""Retrieve observations of the same object in another modality, such as sounds from views.

Prints the mean average precision for all six directions, next to canonical correlation analysis (CCA), chance
and the paper's Table 3.

`objectfolder bench retrieve --preset quick --split unseen`""",
    settings=RetrieveConfig,
    training="objectfolder.benchmarks.tasks.retrieve_training:retrieve",
    columns=("first", "second", "seed", "epoch", "train_loss", "val_map"),
    table=_table,
    published=(RETRIEVAL, UNSEEN_RETRIEVAL),
    page="Retrieval",
    splits=("seen", "unseen"),
    samples="observations",
    encodes=MODALITIES,
    check=check_objects,
    former=("retrieval",),
)
