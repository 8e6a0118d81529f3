"""3D reconstruction from sight, sound and touch (main paper, section 4.3 and Table 4; supplementary I.3).

From an image, a sound, several touches, or any of these together to the object's shape in its own frame, by
an occupancy network behind the encoders of the other benchmarks. IMAGE2MESH is "V", AUDIO2MESH "A",
IMAGE+AUDIO2MESH "VA". Touches, "T", are not in the paper.
"""

import time
from dataclasses import astuple, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from objectfolder.base.arrays import write_png
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import keep
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.models.shape_model import ShapeModel, load_model, save_model
from objectfolder.benchmarks.reporting.shape_pictures import sheet
from objectfolder.benchmarks.scoring.scores import over_seeds
from objectfolder.benchmarks.scoring.truth import Truth
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.naming import namer_checkpoint
from objectfolder.benchmarks.tasks.reconstruct import ReconstructConfig
from objectfolder.benchmarks.tasks.shape_training import (
    VARIANTS,
    ShapeTraining,
    first_rows,
    read_variant,
    validation_rows,
)
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import MODALITIES

POOLED = (16, 16)  #: size of the views by which the most similar is sought
SHOWN = 8  #: test rows in the picture
Jobs = dict[str, Job[ReconstructConfig]]  #: by variant


def reconstruct(job: Job[ReconstructConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score all variants (main paper, Table 4).

    Variants drop the validation and test rows all of whose inputs repeat an input of their object; those with
    touches and the average shape drop none. Test rows are evaluated once, after all choices were made on
    validation rows. Every variant trains at most ``epochs`` epochs; those of several senses half as many, as
    they start from the encoders of one each, and from the fusion and the decoder of the one that validates
    best, of the same seed. The first
    seed's model of views is written to the progress folder as ``model.safetensors``, and a figure of some of
    its meshes as ``sheet.png``.

    Raises ObjectFolderError if files or checkpoints are damaged, or training diverges.

    Returns scores: by variant and baseline the scores of `Truth.scores` over the first ``views`` test rows of
    each object. Baselines: ``average_shape`` (the mean occupancy of the training objects), ``similar_view``
    (the training object with the most similar view) and, if no test object is known, ``nearest_shape`` (the
    training object with the highest IoU, found by the truth). Of variants also the ``threshold``, ``epochs``
    and ``val_iou``, all as means over the seeds, the IoU of each of the ``seeds`` and its ``interval_95``.
    Beside them ``perfect``, the surface scores of the truth against itself; the numbers of different
    ``touches`` and of ``views``; `Job.counts` of these views, before any is dropped; ``untested``, by variant
    the objects without a test row; and ``seconds``.
    """
    job.check_sizes(MODALITIES)
    repeats = job.repeats(("vision", "audio"))
    jobs = {
        variant: job if "touch" in modalities else job.without_repeats(repeats, modalities)
        for variant, modalities in VARIANTS.items()
    }
    truth = _truth(job)
    finished = {
        variant: [_train_once(jobs, truth, variant, run) for run in range(job.params.seeds)]
        for variant in VARIANTS
    }
    used = replace(job.split, val=validation_rows(job), test=_test(job))
    train, val, test = (job.observations.labels[rows] for rows in (used.train, used.val, used.test))
    known = np.unique(train)
    fewest = int(np.unique(job.observations.labels[job.split.test], return_counts=True)[1].min())
    baselines = {
        "average_shape": truth.average_shape(known, val, test),
        "similar_view": truth.known_shapes("similar_view", _similar(job, used.test), test),
    }
    if not np.isin(test, known).any():
        nearest = truth.nearest_shapes(known, test)
        baselines["nearest_shape"] = truth.known_shapes("nearest_shape", nearest, test)
    scores = {
        **{variant: mean_scores([done["scores"] for done in runs]) for variant, runs in finished.items()},
        **baselines,
        "perfect": truth.floor(np.unique(test)),
        "touches": min(job.params.touches, fewest),
        "views": job.params.views,
        **replace(job, split=used).counts(repeats),
        "untested": {name: lost for name, some in jobs.items() if (lost := job.untested(some))},
        "seconds": sum(done["seconds"] for runs in finished.values() for done in runs),
    }
    keep(_model_path(job, "V", 0), job.progress / "model.safetensors")
    write_png(job.progress / "sheet.png", _sheet(job, truth))
    curve = []
    for variant, runs in finished.items():
        curve += [[variant, run, *row] for run, done in enumerate(runs) for row in done["curve"]]
    return scores, curve


def mean_scores(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the means of scores over seeds, None where a seed has none, with the IoU of each seed."""

    def middle(values: list[Any]) -> Any:
        if isinstance(values[0], dict):
            return {name: middle([value[name] for value in values]) for name in values[0]}
        return None if None in values else float(np.mean(values))

    return middle(runs) | over_seeds("iou", [float(run["iou"]) for run in runs])


def _test(job: Job[ReconstructConfig]) -> np.ndarray:
    """Return the rows to score."""
    return first_rows(job.split.test, job.observations.labels, job.params.views)


def _similar(job: Job[ReconstructConfig], rows: np.ndarray) -> np.ndarray:
    """Return the label of the training object with the view most similar to that of each row."""
    train = job.split.train
    wanted, known = (job.pooled("vision", some, POOLED) for some in (rows, train))
    nearest = torch.cdist(wanted, known).argmin(1).cpu().numpy()
    return job.observations.labels[train[nearest]]


def _truth(job: Job[ReconstructConfig]) -> Truth:
    observations = cast(Observations, job.observations)
    surfaces = {key: partial(_surface, observations.object_file(key), key) for key in observations.keys}
    digests = {key: record["object_sha256"] for key, record in observations.records.items()}
    sides = {key: record["scale"] for key, record in observations.records.items()}
    sizes = job.params.score_points, job.params.resolution
    return Truth(surfaces, digests, sides, *sizes, job.seed, job.progress)


def _surface(path: Path, key: str) -> Isosurface:
    """Load the stored surface of an observed Object File."""
    file = ObjectFile.load(path)
    if file.key != key:
        raise ObjectFolderError(f"{path} holds {file.key}, expected {key}; sample the object again")
    return file.surface


def _model_path(job: Job[ReconstructConfig], variant: str, run: int) -> Path:
    """Return the path of a trained model until all are finished."""
    return job.progress / f"{variant}_{run}.safetensors"


def _train_once(jobs: Jobs, truth: Truth, variant: str, run: int) -> dict[str, Any]:
    """Return scores and curve of a variant and seed, trained unless finished earlier."""
    job = jobs[variant]
    checkpoint = job.progress / f"{variant}_{run}.pt"

    def make() -> dict[str, Any]:
        training = ShapeTraining(job, truth.occupancy, variant, run, checkpoint)
        model, curve, before = training.train(*_parts(jobs, truth, variant, run))
        start = time.perf_counter()
        save_model(_model_path(job, variant, run), model)
        scores = _scores(job, truth, variant, model) | {
            "threshold": model.setup.threshold,
            "epochs": len(curve),
            "val_iou": max(point.val_score for point in curve),
        }
        seconds = before + sum(point.seconds for point in curve) + time.perf_counter() - start
        return {"scores": scores, "curve": [astuple(point)[:3] for point in curve], "seconds": seconds}

    result = job.compute_once(f"{variant}_{run}", make)
    for path in (checkpoint, *(namer_checkpoint(job, modality, run) for modality in VARIANTS[variant])):
        path.unlink(missing_ok=True)
    return result


def _parts(jobs: Jobs, truth: Truth, variant: str, run: int) -> tuple[list[ShapeModel], int]:
    """Return the models that a variant starts from, and which of them validates best."""
    modalities = VARIANTS[variant]
    if len(modalities) == 1:
        return [], 0
    names = [name for name, alone in VARIANTS.items() if len(alone) == 1 and alone[0] in modalities]
    scores = [_train_once(jobs, truth, name, run)["scores"]["val_iou"] for name in names]
    return [load_model(_model_path(jobs[name], name, run)) for name in names], int(np.argmax(scores))


def _scores(job: Job[ReconstructConfig], truth: Truth, variant: str, model: ShapeModel) -> dict[str, Any]:
    """Score a trained model on test rows."""
    rows = _test(job)
    embedding = model.embed(read_variant(job, VARIANTS[variant], rows))
    points = truth.occupancy.score_points
    return truth.scores(
        f"{job.split.name} {variant}",
        job.observations.labels[rows],
        lambda i: model.is_inside(embedding[i : i + 1], points)[0],
        lambda i: model.mesh(embedding[i]),
    )


def _sheet(job: Job[ReconstructConfig], truth: Truth) -> np.ndarray:
    """Draw some test rows: the view, the reconstructions by each variant, and the truth."""
    rows = _test(job)
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, SHOWN).round().astype(int))]
    shapes = []
    for variant in VARIANTS:
        model = load_model(_model_path(job, variant, 0))
        embedding = model.embed(read_variant(job, VARIANTS[variant], rows))
        shapes.append([model.mesh(one) for one in embedding])
    surfaces = [truth.surface(int(label)) for label in job.observations.labels[rows]]
    shapes.append([(surface.vertices, surface.faces) for surface in surfaces])
    views = job.observations.read("vision", rows)
    return sheet(views, [list(meshes) for meshes in zip(*shapes)])
