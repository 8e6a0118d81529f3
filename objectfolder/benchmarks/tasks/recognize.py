"""Recognition of objects and materials: which one is seen, heard or touched (supplementary I.1)?"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.settings import Count, section
from objectfolder.benchmarks.datasets.splits import Split
from objectfolder.benchmarks.models.settings import TouchFrameConfig
from objectfolder.benchmarks.reporting.published import MATERIALS, RECOGNITION
from objectfolder.benchmarks.reporting.tables import NEW_OBJECTS, Table, describe_rows, format_interval
from objectfolder.benchmarks.tasks.task import Objects, Task, Variant
from objectfolder.workspace.layout import MODALITIES

COMBINATIONS = ("V", "A", "T", "VA", "VT", "AT", "VAT")  #: of modalities, in the order of rows
REPEATED_MATERIALS = "repeat an input of their material, and were dropped where nothing else is sensed"


@section("recognize")
@dataclass(frozen=True, kw_only=True)
class RecognizeConfig(TouchFrameConfig):
    """Section ``recognize`` of ``params.yaml``."""

    epochs: Count = 5
    patience: Count = 2
    seeds: Count = 3
    fusion_epochs: Count = 1  #: of several modalities together, after each was trained alone
    schedule: Literal["cosine", "one_cycle"] = "cosine"  #: `objectfolder.benchmarks.models.training.train`
    label_smoothing: Annotated[float, Interval(ge=0, lt=1)] = 0.0


@dataclass(frozen=True)
class Target:
    """What is recognized."""

    names: tuple[str, ...]  #: of the classes
    labels: np.ndarray  #: (rows,) int64, the class of each row


def check_learnt(split: Split, objects: Objects) -> None:
    """Raise ObjectFolderError if a test object is absent from training."""
    unknown = np.setdiff1d(objects.labels[split.test], objects.labels[split.train])
    if unknown.size:
        raise ObjectFolderError(
            f"split {split.name}: test class {objects.keys[unknown[0]]} is absent from training; use "
            "--split seen"
        )


def keep_learnt_materials(split: Split, objects: Objects) -> Split:
    """Drop validation and test rows of materials that no training object has.

    Raises ObjectFolderError if all objects for training are of one material, or none for validation or the
    test is of a material of theirs.
    """
    target = material_target(objects)
    names, labels = np.array(target.names), target.labels
    known = np.unique(labels[split.train])
    if len(known) < 2:
        raise ObjectFolderError(
            f"split {split.name}: all objects for training are of {names[known[0]]}; add objects of another "
            "material"
        )
    val, test = (rows[np.isin(labels[rows], known)] for rows in (split.val, split.test))
    for part, rows in (("validation", val), ("test", test)):
        if not len(rows):
            raise ObjectFolderError(
                f"split {split.name}: no {part} object is of a material of the objects for training "
                f"({', '.join(names[known])}); add objects"
            )
    return replace(split, val=val, test=test)


def material_target(objects: Objects) -> Target:
    """Return the materials as classes."""
    names, classes = np.unique(objects.materials, return_inverse=True)
    return Target(tuple(names.tolist()), classes.astype(np.int64)[objects.labels])


def _table(split: str, scores: Mapping[str, Any]) -> Table:
    chance = ("chance", f"{100 * scores['chance']['majority']:.1f}", "", "")
    return Table(
        f"Instance recognition, {scores['objects']} objects: accuracy in %",
        ("modalities", "accuracy", "bound", "each seed"),
        [*_modalities(scores), chance],
        describe_rows(scores) + _touches_note(scores),
    )


def _material_table(split: str, scores: Mapping[str, Any]) -> Table:
    rows = _modalities(scores)
    chance = {"commonest material": "majority", "chance": "uniform"}
    rows += [(name, f"{100 * scores['chance'][kind]:.1f}", "", "") for name, kind in chance.items()]
    absent = ", ".join(scores["left_out"])
    return Table(
        f"Classification of {len(scores['materials'])} materials, {scores['objects']} objects, {split}: "
        "accuracy in %",
        ("modalities", "accuracy", "bound", "each seed"),
        rows,
        describe_rows(scores, REPEATED_MATERIALS)
        + _touches_note(scores)
        + (f" Left out, since no object for training is of it: {absent}." if absent else "")
        + NEW_OBJECTS * (split == "unseen"),
    )


def _modalities(scores: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Rows of combinations of modalities, and of several touches together."""
    rows = [(name, *_seeds(scores[name])) for name in COMBINATIONS if name in scores]
    for kind, name in (("touches", "T"), ("touches_not_flat", "T, not flat")):
        for size, score in sorted(scores.get(kind, {}).items(), key=lambda item: int(item[0])):
            together = name if size == "1" else f"{name}, {size} together"
            if together != "T":  # its row is above, over all rows
                rows.append((together, *_seeds(score)))
    return rows


def _seeds(score: Mapping[str, Any]) -> tuple[str, ...]:
    """Cells of an accuracy, its bound, and the accuracy of each seed."""
    bound = f"{100 * score['bound']:.1f}" if "bound" in score else ""
    return _percent(score), bound, " ".join(f"{100 * value:.1f}" for value in score["seeds"])


def _touches_note(scores: Mapping[str, Any]) -> str:
    if "flat" not in scores:
        return ""
    right = scores.get("flat_accuracy")
    named = "" if right is None else f", of which {100 * right:.0f} % are answered correctly"
    return (
        f" Of the test touches {100 * scores['flat']:.0f} % are on flat ground or miss{named}; "
        "bound: these tell nothing, all others are answered correctly. Together: by the mean log "
        "probability of random test touches of an object; this and not flat as means over objects."
    )


def _percent(score: Mapping[str, Any]) -> str:
    return f"{100 * score['accuracy']:.1f}" + format_interval(score, 100, ".1f")


MATERIALS_TASK = Task(
    name="materials",
    help="Recognize the material of an object, also of unseen objects.",
    settings=RecognizeConfig,
    training="objectfolder.benchmarks.tasks.recognize_training:classify_materials",
    columns=("seed", "modalities", "epoch", "train_loss", "val_accuracy"),
    table=_material_table,
    published=(MATERIALS,),
    page="Materials",
    splits=("seen", "unseen"),
    samples="observations",
    encodes=MODALITIES,
    check=keep_learnt_materials,
)
TASK = replace(
    MATERIALS_TASK,
    name="recognize",
    help="""Recognize an object, or its material, from a view, an impact sound, a touch, or any combination.

Prints the accuracy on held-out observations, and on several touches together, with its 95 % interval over
seeds, next to chance and published figures. The figure OUT/recognize_seen.png (OUT/materials_SPLIT.png) shows
what is mistaken for what.

`objectfolder bench recognize --preset quick`

`objectfolder bench recognize --preset laptop --label material --split unseen`""",
    training="objectfolder.benchmarks.tasks.recognize_training:recognize",
    table=_table,
    published=(RECOGNITION,),
    page="Recognition",
    splits=("seen",),
    check=check_learnt,
    variant=Variant(
        "label",
        ("object", "material"),
        MATERIALS_TASK,
        "What is recognized: the object, or its material, also of unseen objects.",
    ),
    former=("recognition",),
)
