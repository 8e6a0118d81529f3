"""3D reconstruction from sight, sound and touch (main paper, Table 4; supplementary I.3)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Ge, Interval

from objectfolder.base.settings import Count, NonNegative, Positive, section
from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.benchmarks.reporting import tables
from objectfolder.benchmarks.reporting.published import RECONSTRUCTION
from objectfolder.benchmarks.tasks.task import Task
from objectfolder.workspace.layout import MODALITIES

#: Rows of reconstruction, in their order; touches are not in the paper.
NAMES = {
    **{"average_shape": "average shape", "V": "image", "A": "audio", "T": "{} touches"},
    **{"VA": "image + audio", "VT": "image + {} touches", "AT": "audio + {} touches"},
    "VAT": "image + audio + {} touches",
}
#: Scores and their decimals, in the order of columns.
COLUMNS = {"iou": 4, "chamfer_l1": 4, "chamfer_cm": 2, "normal_consistency": 4}
#: Rows of reconstruction below the paper's, and what they are.
KNOWN_SHAPES = {
    "similar_view": "known object with the most similar view",
    "nearest_shape": "known object of the most similar shape",
    "perfect": "truth, sampled again",
}
REPEATED = "repeat an input of their object, and gave way to later ones where nothing else is sensed"


@section("reconstruct")
@dataclass(frozen=True, kw_only=True)
class ReconstructConfig(TrainingConfig):
    """Section ``reconstruct`` of ``params.yaml``."""

    epochs: Count = 6
    patience: Count = 5
    seeds: Count = 3
    #: In which each encoder learns to name the training objects and then stays as it is; 0: all is learned
    #: together.
    pretrain_epochs: Annotated[int, Ge(0)] = 0
    pretrain_rate: Positive = 0.004  #: peak learning rate of these epochs
    #: Weight of the loss for naming the object from its features while all is learned together; the paper's
    #: is 0.
    naming: NonNegative = 1.0
    points: Count = 96  #: per observation and step, whose occupancy is learned
    width: Count = 128  #: of the occupancy network
    blocks: Count = 5
    frequencies: Annotated[int, Interval(ge=0, le=12)] = 6  #: octaves of the encoding; the paper's is 0
    resolution: Annotated[int, Ge(8)] = 64  #: of marching cubes
    score_points: Count = 30_000  #: for IoU, and on either surface for the distances
    views: Count = 2  #: test observations per object that are meshed
    touches: Count = 16  #: of the object that a shape is reconstructed from, as far as its part has so many


def _table(split: str, scores: Mapping[str, Any]) -> tables.Table:
    rows, counts = [], scores["rows"]
    for kind, name in (NAMES | KNOWN_SHAPES).items():
        if kind not in scores:  # a baseline that the split lacks, or a variant that earlier versions lacked
            continue
        score = scores[kind]
        ours = [tables.format_figure(score.get(name), digits) for name, digits in COLUMNS.items()]
        ours[0] += tables.format_interval(score, 1, ".4f") if "interval_95" in score else ""
        rows.append((name.format(scores["touches"]), *ours))
    return tables.Table(
        f"3D reconstruction, {split} objects",
        ("from", "IoU", "Chamfer-L1", "Chamfer-L1, cm", "normal consistency"),
        rows,
        f"{counts['train']} rows to train with; of each object the first {scores['views']} for validation "
        f"and for the test, {counts['val']} and {counts['test']} in all; "
        + tables.describe_repeats(scores, REPEATED)
        + tables.NEW_OBJECTS * (split == "unseen"),
    )


TASK = Task(
    name="reconstruct",
    help="""Reconstruct an object's shape from a view, an impact sound, several touches, or several of these.

Prints IoU, Chamfer-L1 and normal consistency, next to the average shape and the paper's Table 4. The model
for views is kept: `objectfolder reconstruct PHOTO.jpg MESH.ply --model OUT/reconstruct_seen.safetensors`.

`objectfolder bench reconstruct --preset quick --split seen`""",
    settings=ReconstructConfig,
    training="objectfolder.benchmarks.tasks.reconstruct_training:reconstruct",
    columns=("variant", "seed", "epoch", "train_loss", "val_iou"),
    table=_table,
    published=(RECONSTRUCTION,),
    page="Reconstruction",
    splits=("seen", "unseen"),
    samples="observations",
    encodes=MODALITIES,
    former=("reconstruction",),
)
