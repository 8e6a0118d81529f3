"""3D reconstruction from sight, sound and touch (main paper, section 4.3 and Table 4; supplementary I.3).

From an image, a sound, both, or several touches to the object's shape in its own frame, by an occupancy
network behind the encoders of the other benchmarks. IMAGE2MESH is "V", AUDIO2MESH "A", IMAGE+AUDIO2MESH
"VA". Touches, "T", are not in the paper.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from shutil import copyfile
from typing import Annotated, Any, cast

import numpy as np
import torch
import torch.nn.functional as F
from annotated_types import Ge, Interval
from torch import nn

from objectfolder.benchmarks.datasets.companions import Companions
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.models.classifier import Classifier
from objectfolder.benchmarks.models.encoders import flipped
from objectfolder.benchmarks.models.occupancy_net import EMBEDDING, Reconstructor
from objectfolder.benchmarks.models.several_touches import SeveralTouches
from objectfolder.benchmarks.models.shape_model import (
    Setup,
    ShapeModel,
    load_model,
    new_net,
    save_model,
    shape_inputs,
)
from objectfolder.benchmarks.models.training import STATISTICS, EpochPoint, TrainingConfig, shuffled
from objectfolder.benchmarks.reporting.shape_pictures import sheet
from objectfolder.benchmarks.scoring.scores import interval_95
from objectfolder.benchmarks.scoring.truth import THRESHOLDS, Truth, best_level
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.naming import namer_checkpoint, train_namer
from objectfolder.benchmarks.tasks.running import Task
from objectfolder.errors import ObjectFolderError
from objectfolder.io import write_png
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile.file import ObjectFile
from objectfolder.seeding import numpy_generator, seeded
from objectfolder.settings import Count, NonNegative, Positive

SHOWN = 8  #: test rows in the picture
#: Inputs of each variant. VA comes last: it starts from the encoders of the others.
VARIANTS: dict[str, tuple[str, ...]] = {
    "V": ("vision",),
    "A": ("audio",),
    "T": ("touch",),
    "VA": ("vision", "audio"),
}
CURVE_COLUMNS = ("variant", "seed", "epoch", "train_loss", "val_iou")  #: of the training curves
#: Steps per encoded batch, each on other points; all but the first train fusion and decoder only. Encoders
#: take most of the time, while shapes need many more steps than features. A row of several touches is so
#: much to encode that an epoch takes fewer rows, with more steps each.
POINT_SETS, TOUCH_POINT_SETS = 4, 16
#: Inputs of the encoders, or None for those of the batch before; numbers of the objects; points;
#: whether they are inside.
Batch = tuple[dict[str, torch.Tensor] | None, torch.Tensor, torch.Tensor, torch.Tensor]


@dataclass(frozen=True, kw_only=True)
class ReconstructConfig(TrainingConfig):
    """Section ``reconstruct`` of ``params.yaml``."""

    seeds: Count  #: trainings of each variant
    pretrain_epochs: Annotated[int, Ge(0)]  #: in which each encoder learns to name the training objects first
    pretrain_rate: Positive  #: peak learning rate of these epochs, as one cycle
    naming: NonNegative  #: weight of the loss for naming the object from its features; the paper's is 0
    points: Count  #: per observation and step, whose occupancy is learned
    width: Count  #: of the occupancy network
    blocks: Count
    frequencies: Annotated[int, Interval(ge=0, le=12)]  #: octaves of the encoding; the paper's is 0
    resolution: Annotated[int, Ge(8)]  #: of marching cubes
    score_points: Count  #: for IoU, and on either surface for the distances
    views: Count  #: test observations per object that are meshed
    touches: Count  #: of the object that a shape is reconstructed from


def reconstruct(job: Job[ReconstructConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score all variants (main paper, Table 4).

    Test rows are evaluated once, after all choices were made on validation rows. With ``pretrain_epochs``,
    each encoder first learns to name the training objects, alone. Then every variant trains at most
    ``epochs`` epochs; VA half as many, as it starts from the encoders of V and A, and from the fusion and the
    decoder of the one that validates better, of the same seed. The first seed's model of views is written to
    the progress folder as ``model.safetensors``, and a figure of some of its meshes as ``sheet.png``.

    Returns
    -------
    dict
        By variant, and ``average_shape`` (the mean occupancy of the training objects): the scores of
        `Truth.scores` over the first ``views`` test rows of each object; ``threshold``; of variants also
        ``epochs`` and ``val_iou``, all as means over the seeds, the IoU of each of the ``seeds`` and its
        ``interval_95``. Beside them ``perfect``, the surface scores of the truth against itself,
        the number of ``touches``, the counts of `Job.without_duplicates`, and ``seconds``.
    list
        Rows of the training curves: `CURVE_COLUMNS`.

    Raises
    ------
    ObjectFolderError
        If files or checkpoints are damaged, or training diverges.
    """
    job, rows = job.without_duplicates(("vision", "audio"))
    truth = _truth(job)
    finished = {
        variant: [_finished(job, truth, variant, run) for run in range(job.params.seeds)]
        for variant in VARIANTS
    }
    labels, split = job.observations.labels, job.split
    trained_labels, val, test = (
        np.unique(labels[split.train]),
        labels[validation_rows(job)],
        labels[_test(job)],
    )
    scores = {
        **{variant: over_seeds([done["scores"] for done in runs]) for variant, runs in finished.items()},
        "average_shape": truth.average_shape(trained_labels, val, test),
        "perfect": truth.floor(np.unique(test)),
        "touches": job.params.touches,
        **rows,
        "seconds": sum(done["seconds"] for runs in finished.values() for done in runs),
    }
    copyfile(_model_path(job, "V", 0), job.progress / "model.safetensors")
    write_png(job.progress / "sheet.png", _sheet(job, truth))
    return scores, [
        [variant, run, *row]
        for variant, runs in finished.items()
        for run, done in enumerate(runs)
        for row in done["curve"]
    ]


def over_seeds(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the means of scores over seeds, None where a seed has none, with the IoU of each seed."""

    def middle(values: list[Any]) -> Any:
        if isinstance(values[0], dict):
            return {name: middle([value[name] for value in values]) for name in values[0]}
        return None if None in values else float(np.mean(values))

    each = [float(run["iou"]) for run in runs]
    return middle(runs) | {"seeds": each, "interval_95": interval_95(each)}


def first_rows(rows: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """Return the first ``count`` rows of each object, in order; ``labels`` are those of all observations."""
    chosen = [rows[labels[rows] == label][:count] for label in np.unique(labels[rows])]
    return np.concatenate(chosen)


def _test(job: Job[ReconstructConfig]) -> np.ndarray:
    """Return the rows to score."""
    return first_rows(job.split.test, job.observations.labels, job.params.views)


def validation_rows(job: Job[ReconstructConfig]) -> np.ndarray:
    """Return the rows to choose epochs and thresholds on; training rows of objects without validation rows.

    A threshold that is best for the few validation objects of the split ``unseen`` may leave all other
    predictions empty.
    """
    labels, split = job.observations.labels, job.split
    rest = split.train[~np.isin(labels[split.train], labels[split.val])]
    parts = [first_rows(rows, labels, job.params.views) for rows in (split.val, rest) if len(rows)]
    return np.concatenate(parts)


def _read(
    job: Job[ReconstructConfig], modality: str, rows: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Read observations; of touches several for each row, of its object and part of the split."""
    if modality != "touch":
        return job.observations.read(modality, rows)
    chosen = Companions(job.split, job.observations.labels).draw(rows, job.params.touches, rng)
    return job.observations.read(modality, chosen.ravel()).reshape(
        *chosen.shape, *job.observations.shape(modality)
    )


def _inputs(
    job: Job[ReconstructConfig], modality: str, rows: np.ndarray, rng: np.random.Generator
) -> torch.Tensor:
    """Return the inputs of training."""
    if modality == "audio":
        return job.inputs(modality, rows)
    return shape_inputs(modality, _read(job, modality, rows, rng), job.sizes, rng, job.device)


def _seen(job: Job[ReconstructConfig], variant: str, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Read what a variant is validated or scored on."""
    rng = numpy_generator(job.seed, "reconstruct", job.split.name, "seen")
    return {modality: _read(job, modality, rows, rng) for modality in VARIANTS[variant]}


def _truth(job: Job[ReconstructConfig]) -> Truth:
    observations = cast(Observations, job.observations)
    surfaces = {key: partial(_surface, observations.object_file(key), key) for key in observations.keys}
    digests = {key: record["object_sha256"] for key, record in observations.records.items()}
    return Truth(surfaces, digests, job.params.score_points, job.params.resolution, job.seed, job.progress)


def _surface(path: Path, key: str) -> Isosurface:
    """Load the stored surface of an observed Object File."""
    file = ObjectFile.load(path)
    if file.key != key:
        raise ObjectFolderError(f"{path} holds {file.key}, expected {key}; sample the object again")
    return file.surface


def _model_path(job: Job[ReconstructConfig], variant: str, run: int) -> Path:
    """Return the path of a trained model until all are finished."""
    return job.progress / f"{variant}_{run}.safetensors"


def _finished(job: Job[ReconstructConfig], truth: Truth, variant: str, run: int) -> dict[str, Any]:
    """Return scores and curve of a variant and seed, trained unless finished earlier."""
    checkpoint = job.progress / f"{variant}_{run}.pt"

    def make() -> dict[str, Any]:
        namer, named = _named(job, variant, run)
        model, curve = _trained(job, truth, variant, run, namer, checkpoint)
        start = time.perf_counter()
        save_model(_model_path(job, variant, run), model)
        scores = _scores(job, truth, variant, model) | {
            "threshold": model.setup.threshold,
            "epochs": len(curve),
            "val_iou": max(point.val_score for point in curve),
        }
        seconds = sum(point.seconds for point in named + curve) + time.perf_counter() - start
        return {"scores": scores, "curve": [astuple(point)[:3] for point in curve], "seconds": seconds}

    result = job.finished(f"{variant}_{run}", make)
    for path in (checkpoint, *(namer_checkpoint(job, modality, run) for modality in VARIANTS[variant])):
        path.unlink(missing_ok=True)
    return result


def _named(job: Job[ReconstructConfig], variant: str, run: int) -> tuple[Classifier | None, list[EpochPoint]]:
    """Return the namer that a variant starts from, with its curve; None if it does not start from one."""
    params, (modality, *others) = job.params, VARIANTS[variant]
    if others or not params.pretrain_epochs:
        return None, []

    def inputs(rows: np.ndarray, rng: np.random.Generator | None) -> torch.Tensor:
        if modality != "vision":
            return job.inputs(modality, rows, rng)
        views = shape_inputs(modality, job.observations.read(modality, rows), job.sizes, rng, job.device)
        return flipped(views, rng) if job.flip and rng is not None else views

    rate = params.pretrain_rate / params.learning_rate
    return train_namer(
        job, "reconstruct", modality, run, inputs, params.pretrain_epochs, one_cycle=True, rate=rate
    )


def _trained(
    job: Job[ReconstructConfig],
    truth: Truth,
    variant: str,
    run: int,
    namer: Classifier | None,
    checkpoint: Path,
) -> tuple[ShapeModel, list[EpochPoint]]:
    """Train one variant, or resume from its checkpoint."""
    observations, occupancy, params, split = job.observations, truth.occupancy, job.params, job.split
    labels, modalities, device = observations.labels, VARIANTS[variant], job.device
    trained_labels = np.unique(labels[split.train])
    setup = Setup(
        modalities,
        job.encoder,
        job.sizes,
        observations.shape("vision")[0],
        params.width,
        params.blocks,
        params.frequencies,
        params.resolution,
        tuple(observations.keys[label] for label in trained_labels),
    )
    purpose = ("reconstruct", split.name, variant, str(run))
    with seeded(job.seed, *purpose):
        net = new_net(setup, job.weights)
        naming = nn.Linear(net.fusion.get_parameter("0.weight").shape[1], len(trained_labels))
    if job.subtract and "touch" in modalities:
        cast(SeveralTouches, net.encoders["touch"]).set_ground(job.ground)
    sets = TOUCH_POINT_SETS if "touch" in modalities else POINT_SETS
    epochs = params.epochs if len(modalities) == 1 else _start_from_parts(job, truth, net, run)
    if namer is not None:
        _start_from_namer(net, naming, namer, modalities[0])

    def epoch_batches(epoch: int) -> Iterator[Batch]:
        rng = numpy_generator(job.seed, *purpose, f"epoch {epoch}")
        for rows in islice(shuffled(split.train, params.batch, rng), None, None, sets // POINT_SETS):
            inputs = {modality: _inputs(job, modality, rows, rng) for modality in modalities}
            names = torch.from_numpy(np.searchsorted(trained_labels, labels[rows])).to(device)
            for given in (inputs, *[None] * (sets - 1)):
                points, inside = occupancy.draw(labels[rows], params.points, rng)
                yield given, names, torch.from_numpy(points).to(device), torch.from_numpy(inside).to(device)

    encoded: list[torch.Tensor] = []

    def batch_loss(batch: Batch) -> torch.Tensor:
        inputs, names, points, inside = batch
        if inputs is None:
            (features,) = encoded
        else:
            features = net.features(inputs)
            encoded[:] = [features.detach()]
        logits = net.decoder(points, net.fusion(features))
        loss = F.binary_cross_entropy_with_logits(logits, inside.float())
        return loss if inputs is None else loss + params.naming * F.cross_entropy(naming(features), names)

    model = ShapeModel(setup, net)
    val = validation_rows(job)
    seen = _seen(job, variant, val)
    inside = occupancy.val_inside[labels[val]]

    def validated() -> tuple[float, float]:
        logits = model.logits(model.embed(seen), occupancy.val_points)
        return best_level(logits, inside, np.log(THRESHOLDS / (1 - THRESHOLDS)))

    curve = job.train(
        f"reconstruct {split.name}, {variant}, seed {run + 1} of {params.seeds}",
        nn.ModuleDict({"net": net, "naming": naming}),
        epoch_batches,
        batch_loss,
        lambda: validated()[1],
        "IoU",
        checkpoint,
        epochs,
        statistics=STATISTICS * sets,  # of which one in so many is encoded
    )
    threshold = round(float(torch.tensor(validated()[0]).sigmoid()), 4)
    return ShapeModel(replace(setup, threshold=threshold), net), curve


def _start_from_namer(net: Reconstructor, naming: nn.Linear, namer: Classifier, modality: str) -> None:
    """Copy the encoder of one observation, and the layer that names objects from its features."""
    encoder = net.encoders[modality]
    plain = encoder.encoder if isinstance(encoder, SeveralTouches) else encoder
    plain.load_state_dict(namer.encoders[modality].state_dict())
    naming.load_state_dict(namer.head.state_dict())


def _start_from_parts(job: Job[ReconstructConfig], truth: Truth, net: Reconstructor, run: int) -> int:
    """Initialize a net of several modalities from nets of one each; return its number of epochs."""
    parts = {variant: load_model(_model_path(job, variant, run)).net for variant in ("V", "A")}
    scores = {variant: _finished(job, truth, variant, run)["scores"]["val_iou"] for variant in parts}
    _start_from(net, list(parts.values()), parts[max(scores, key=lambda variant: scores[variant])])
    return -(-job.params.epochs // 2)


def _start_from(net: Reconstructor, parts: Sequence[Reconstructor], best: Reconstructor) -> None:
    """Copy the encoders of nets of one modality each; the net initially predicts as the best of them."""
    for part in parts:
        for modality, encoder in part.encoders.items():
            net.encoders[modality].load_state_dict(encoder.state_dict())
    net.decoder.load_state_dict(best.decoder.state_dict())
    fusion = best.fusion.state_dict()
    widths = [part.fusion.get_parameter("0.weight").shape[1] for part in parts]
    fusion["0.weight"] = torch.cat(
        [
            fusion["0.weight"] if part is best else torch.zeros(EMBEDDING, width)
            for part, width in zip(parts, widths)
        ],
        1,
    )
    net.fusion.load_state_dict(fusion)


def _scores(job: Job[ReconstructConfig], truth: Truth, variant: str, model: ShapeModel) -> dict[str, Any]:
    """Score a trained model on test rows."""
    rows = _test(job)
    embedding = model.embed(_seen(job, variant, rows))
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
        embedding = model.embed(_seen(job, variant, rows))
        shapes.append([model.mesh(one) for one in embedding])
    surfaces = [truth.surface(int(label)) for label in job.observations.labels[rows]]
    shapes.append([(surface.vertices, surface.faces) for surface in surfaces])
    views = job.observations.read("vision", rows)
    return sheet(views, [list(meshes) for meshes in zip(*shapes)])


RECONSTRUCT = Task("reconstruct", ReconstructConfig, reconstruct, CURVE_COLUMNS, Observations)
