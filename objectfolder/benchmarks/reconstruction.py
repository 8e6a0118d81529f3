"""Audio-visual 3D reconstruction (main paper, section 4.3 and Table 4; supplementary I.3).

From an image, a sound, or both to the object's shape in its own frame, by an occupancy network behind the
encoders of the other benchmarks. IMAGE2MESH is "V", AUDIO2MESH "A", IMAGE+AUDIO2MESH "VA".
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from shutil import copyfile
from typing import Any, Protocol

import numpy as np
import torch
import torch.nn.functional as F

from objectfolder.artifacts import SPLITS, read_json, write_json, write_png
from objectfolder.benchmarks.encoders import InputSizes, Weights, make_encoder, prepare
from objectfolder.benchmarks.observations import Observations
from objectfolder.benchmarks.occupancy import Occupancy, cached_occupancy
from objectfolder.benchmarks.occupancy_net import EMBEDDING, Reconstructor
from objectfolder.benchmarks.shape_model import Setup, ShapeModel, load_model, new_net, save_model
from objectfolder.benchmarks.shape_pictures import sheet
from objectfolder.benchmarks.shapes import (
    Surface,
    extract_mesh,
    intersection_over_union,
    sampled_surface,
    surface_scores,
)
from objectfolder.benchmarks.splits import Split, without_duplicates
from objectfolder.benchmarks.training import EpochPoint, shuffled, train
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile import ObjectFile
from objectfolder.seeding import numpy_generator, seeded

SHOWN = 8  #: test rows in the picture
#: What each variant looks at. VA comes last: it starts from the encoders of the others.
VARIANTS: dict[str, tuple[str, ...]] = {"V": ("vision",), "A": ("audio",), "VA": ("vision", "audio")}
CURVE_COLUMNS = ("variant", "epoch", "train_loss", "val_iou")  #: of the training curves
#: Steps from one encoded batch, each on other points; all but the first train fusion and decoder alone.
#: Shapes take many more steps to learn than features, and encoders most of the time.
POINT_SETS = 4
POOL = 2**16  #: points of each kind to train on, per object
VAL_POINTS = 2**12  #: uniform points to validate on
#: Occupancies that are tried as the threshold; the best on validation is taken.
THRESHOLDS = np.linspace(0.05, 0.95, 19).round(2)


#: Inputs of the encoders, or None for those of the batch before; points; whether they are inside.
Batch = tuple[dict[str, torch.Tensor] | None, torch.Tensor, torch.Tensor]


class ReconstructParams(Protocol):
    """Settings; `objectfolder.benchmarks.params` documents them."""

    epochs: int
    batch: int
    points: int
    width: int
    blocks: int
    frequencies: int
    learning_rate: float
    weight_decay: float
    patience: int
    resolution: int
    score_points: int
    views: int


@dataclass(frozen=True)
class Task:
    """Arguments of `reconstruct`, and what is made of them once."""

    observations: Observations
    split: Split
    params: ReconstructParams
    encoder: str
    sizes: InputSizes
    seed: int
    progress: Path
    weights: Weights | None = None
    device: str | torch.device = "cpu"
    report: Callable[[str], None] = lambda line: None

    @cached_property
    def occupancy(self) -> Occupancy:
        """Occupancy samples of all objects; made at first use, or read."""
        files = {key: self.observations.object_file(key) for key in self.observations.keys}
        p = self.params
        return cached_occupancy(
            self.progress / "occupancy.npz", files, POOL, VAL_POINTS, p.score_points, p.resolution, self.seed
        )

    @cached_property
    def truth(self) -> Callable[[int], Surface]:
        """Sampled surface of an object, by label."""
        return cache(lambda label: self._surface(label, "truth"))

    def surface(self, label: int) -> Isosurface:
        """Stored surface of an object."""
        return ObjectFile.load(self.observations.object_file(self.observations.keys[label])).surface

    def _surface(self, label: int, purpose: str) -> Surface:
        key, surface = self.observations.keys[label], self.surface(label)
        rng = numpy_generator(self.seed, "reconstruct", "surface", purpose, key)
        sampled = sampled_surface(surface.vertices, surface.faces, self.params.score_points, rng)
        assert sampled is not None  # an Object File without a surface is refused when it is read
        return sampled

    def floor(self, label: int) -> tuple[float, float]:
        """Surface scores of the truth itself, sampled anew: what a perfect answer would get."""
        return surface_scores(self._surface(label, "floor"), self.truth(label))


def reconstruct(
    observations: Observations,
    split: Split,
    params: ReconstructParams,
    encoder: str,
    sizes: InputSizes,
    *,
    weights: Weights | None = None,
    seed: int,
    progress: Path,
    device: str | torch.device = "cpu",
    report: Callable[[str], None] = lambda line: None,
) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score all variants (main paper, Table 4).

    Test rows are looked at once, after everything was chosen on validation rows. Every variant trains at most
    ``epochs`` epochs; VA half as many, as it starts from the encoders of V and A, and from the fusion and the
    decoder of the one that validates better.

    Parameters
    ----------
    observations : Observations
    split : Split
        Kept-back rows that show what is learnt from are dropped.
    params : ReconstructParams
    encoder : str
        Name of the encoders (`objectfolder.benchmarks.encoders.register_encoder`).
    sizes : InputSizes
    weights : Weights, optional
        That encoders start from.
    seed : int
    progress : Path
        Folder of what is finished, and of checkpoints. A call that was interrupted goes on from it: it must
        be empty, or of a call with the same arguments. The model of views is left there as
        ``model.safetensors``, and a picture of some meshes as ``sheet.png``.
    device : str or torch.device, optional
    report : callable, optional
        Called with a line about each epoch.

    Returns
    -------
    dict
        By variant, and ``average_shape`` (the mean occupancy of the training objects): ``iou``,
        ``chamfer_l1``, ``normal_consistency`` (see `objectfolder.benchmarks.shapes`), means over ``samples``
        test rows, of which ``empty`` gave no surface; ``threshold``; ``per_object``, IoU by key; of variants
        also ``epochs`` and ``val_iou``. Beside them ``perfect``, the surface scores of the truth against
        itself, ``objects``, ``rows``, ``duplicates`` that were dropped, and ``seconds``.
    list
        Rows of the training curves: `CURVE_COLUMNS`.

    Raises
    ------
    ObjectFolderError
        If files or checkpoints are damaged, or training diverges.
    """
    split, duplicates = without_duplicates(split, observations, ("vision", "audio"))
    make_encoder(encoder, "vision", weights)
    encoder = encoder.rpartition(":")[2]  # a model's file names no code that is run when it is read
    task = Task(observations, split, params, encoder, sizes, seed, progress, weights, device, report)
    finished = {variant: _finished(task, variant) for variant in VARIANTS}
    chosen = np.unique(observations.labels[selected(split.test, task)])
    floors = np.mean([task.floor(int(label)) for label in chosen], 0)
    scores = {
        **{variant: done["scores"] for variant, done in finished.items()},
        "average_shape": average_shape(task),
        "perfect": dict(zip(("chamfer_l1", "normal_consistency"), floors.tolist())),
        "objects": len(observations.keys),
        "rows": {name: len(getattr(split, name)) for name in SPLITS},
        "duplicates": duplicates,
        "seconds": sum(done["seconds"] for done in finished.values()),
    }
    copyfile(model_path(task, "V"), progress / "model.safetensors")
    write_png(progress / "sheet.png", _sheet(task))
    return scores, [[variant, *row] for variant, done in finished.items() for row in done["curve"]]


def model_path(task: Task, variant: str) -> Path:
    """Where a trained model is kept until all are finished."""
    return task.progress / f"{variant}.safetensors"


def selected(rows: np.ndarray, task: Task) -> np.ndarray:
    """Return the rows that are scored: the first ``views`` of each object, in order."""
    labels = task.observations.labels[rows]
    chosen = [rows[labels == label][: task.params.views] for label in np.unique(labels)]
    return np.concatenate(chosen)


def average_shape(task: Task) -> dict[str, Any]:
    """Score the mean occupancy of the training objects, the same answer whatever is seen or heard.

    The threshold is the best one on validation rows.
    """
    split, labels, occupancy = task.split, task.observations.labels, task.occupancy
    learnt = np.unique(labels[split.train])
    test, val = labels[selected(split.test, task)], labels[selected(split.val, task)]

    def mean(inside: np.ndarray) -> np.ndarray:
        return inside[learnt].mean(0, dtype=np.float32)

    guess = mean(occupancy.val_inside)
    guesses = np.broadcast_to(guess, (len(val), len(guess)))
    level, _ = best_level(guesses, occupancy.val_inside[val], THRESHOLDS)
    side = int(occupancy.resolution)
    grid = occupancy.grid(learnt).mean(0, dtype=np.float32).reshape(side, side, side)
    inside = mean(occupancy.score_inside) > level
    mesh = extract_mesh(grid, level)
    return _scores(task, "average_shape", test, lambda i: inside, lambda i: mesh) | {"threshold": level}


def best_level(values: np.ndarray, inside: np.ndarray, levels: np.ndarray) -> tuple[float, float]:
    """Level above which values (B, P) agree best with the truth (B, P), and the mean IoU there.

    Of levels that are equally good, the lowest.
    """
    scores = [float(intersection_over_union(values > level, inside).mean()) for level in levels]
    best = int(np.argmax(scores))
    return float(levels[best]), scores[best]


def _finished(task: Task, variant: str) -> dict[str, Any]:
    """Scores and curve of a variant; trained if no earlier call did."""
    path = task.progress / f"{variant}.json"
    if not path.is_file():
        start = time.perf_counter()
        checkpoint = task.progress / f"{variant}.pt"
        model, curve = _trained(task, variant, checkpoint)
        save_model(model_path(task, variant), model)
        scores = score_model(task, variant, model) | {
            "epochs": len(curve),
            "val_iou": max(point.val_score for point in curve),
        }
        done = {
            "scores": scores,
            "curve": [astuple(point)[:3] for point in curve],
            "seconds": time.perf_counter() - start,
        }
        write_json(path, done)
        checkpoint.unlink(missing_ok=True)
    stored: dict[str, Any] = read_json(path)
    return stored


def _trained(task: Task, variant: str, checkpoint: Path) -> tuple[ShapeModel, list[EpochPoint]]:
    """Train one variant, or go on from its checkpoint."""
    observations, occupancy, params, split = task.observations, task.occupancy, task.params, task.split
    labels, modalities, device = observations.labels, VARIANTS[variant], torch.device(task.device)
    setup = Setup(
        modalities,
        task.encoder,
        task.sizes,
        observations.shape("vision")[0],
        params.width,
        params.blocks,
        params.frequencies,
        params.resolution,
        tuple(observations.keys[label] for label in np.unique(labels[split.train])),
    )
    purpose = ("reconstruct", split.name, variant)
    net, epochs = _started(task, setup, purpose)

    def epoch_batches(epoch: int) -> Iterator[Batch]:
        rng = numpy_generator(task.seed, *purpose, f"epoch {epoch}")
        for rows in shuffled(split.train, params.batch, rng):
            inputs = {
                m: prepare(m, observations.read(m, rows), task.sizes, rng).to(device) for m in modalities
            }
            for given in (inputs, *[None] * (POINT_SETS - 1)):
                points, inside = occupancy.draw(labels[rows], params.points, rng)
                yield given, torch.from_numpy(points).to(device), torch.from_numpy(inside).to(device)

    encoded: list[torch.Tensor] = []

    def batch_loss(batch: Batch) -> torch.Tensor:
        inputs, points, inside = batch
        if inputs is None:
            (features,) = encoded
        else:
            features = net.features(inputs)
            encoded[:] = [features.detach()]
        logits = net.decoder(points, net.fusion(features))
        return F.binary_cross_entropy_with_logits(logits, inside.float())

    model = ShapeModel(setup, net)
    val = selected(split.val, task)
    seen = {modality: observations.read(modality, val) for modality in modalities}
    truth = occupancy.val_inside[labels[val]]

    def validated() -> tuple[float, float]:
        logits = model.logits(model.embed(seen), occupancy.val_points)
        return best_level(logits, truth, np.log(THRESHOLDS / (1 - THRESHOLDS)))

    def told(point: EpochPoint) -> None:
        task.report(
            f"reconstruct {split.name}, {variant}, epoch {point.epoch} of {epochs}: training loss "
            f"{point.train_loss:.3f}, validation IoU {point.val_score:.3f}, {point.seconds:.0f} s"
        )

    curve = train(
        net,
        epoch_batches,
        batch_loss,
        lambda: validated()[1],
        epochs=epochs,
        learning_rate=params.learning_rate,
        weight_decay=params.weight_decay,
        patience=params.patience,
        checkpoint=checkpoint,
        device=device,
        report=told,
    )
    threshold = round(float(torch.tensor(validated()[0]).sigmoid()), 4)
    return ShapeModel(replace(setup, threshold=threshold), net), curve


def _started(task: Task, setup: Setup, purpose: tuple[str, ...]) -> tuple[Reconstructor, int]:
    """Give the net that training starts from and the number of epochs."""
    with seeded(task.seed, *purpose):
        net = new_net(setup, task.weights)
    if len(setup.modalities) == 1:
        return net, task.params.epochs
    parts = {variant: load_model(model_path(task, variant)).net for variant in ("V", "A")}
    scores = {v: _finished(task, v)["scores"]["val_iou"] for v in parts}
    _start_from(net, list(parts.values()), parts[max(scores, key=lambda variant: scores[variant])])
    return net, -(-task.params.epochs // 2)


def _start_from(net: Reconstructor, parts: Sequence[Reconstructor], best: Reconstructor) -> None:
    """Give a net the encoders of nets of one modality each; it answers as the best of them at first."""
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


def score_model(task: Task, variant: str, model: ShapeModel) -> dict[str, Any]:
    """Score a trained model on the selected test rows."""
    rows = selected(task.split.test, task)
    embedding = model.embed({m: task.observations.read(m, rows) for m in model.setup.modalities})
    points = task.occupancy.score_points
    scores = _scores(
        task,
        variant,
        task.observations.labels[rows],
        lambda i: model.is_inside(embedding[i : i + 1], points)[0],
        lambda i: model.mesh(embedding[i]),
    )
    return scores | {"threshold": model.setup.threshold}


def _scores(
    task: Task,
    name: str,
    labels: np.ndarray,
    inside: Callable[[int], np.ndarray],
    mesh: Callable[[int], tuple[np.ndarray, np.ndarray]],
) -> dict[str, Any]:
    """Means over samples, whose objects are ``labels``, of what is answered to the i-th."""
    iou, surfaces, empty = np.zeros(len(labels)), np.zeros((len(labels), 2)), 0
    for i, label in enumerate(labels):
        iou[i] = intersection_over_union(inside(i), task.occupancy.score_inside[label])
        rng = numpy_generator(task.seed, "reconstruct", "surface", task.split.name, name, str(i))
        predicted = sampled_surface(*mesh(i), task.params.score_points, rng)
        surfaces[i] = surface_scores(predicted, task.truth(int(label)))
        empty += predicted is None
    keys = task.observations.keys
    return {
        "iou": float(iou.mean()),
        "chamfer_l1": float(surfaces[:, 0].mean()),
        "normal_consistency": float(surfaces[:, 1].mean()),
        "samples": len(labels),
        "empty": empty,
        "per_object": {keys[label]: float(iou[labels == label].mean()) for label in np.unique(labels)},
    }


def _sheet(task: Task) -> np.ndarray:
    """Draw some test rows: the view; what V, A and VA make of it and of the sound; the truth."""
    rows = selected(task.split.test, task)
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, SHOWN).round().astype(int))]
    shapes = []
    for variant, modalities in VARIANTS.items():
        model = load_model(model_path(task, variant))
        embedding = model.embed({name: task.observations.read(name, rows) for name in modalities})
        shapes.append([model.mesh(one) for one in embedding])
    truth = [task.surface(int(label)) for label in task.observations.labels[rows]]
    shapes.append([(surface.vertices, surface.faces) for surface in truth])
    views = task.observations.read("vision", rows)
    return sheet(views, [list(meshes) for meshes in zip(*shapes)])
