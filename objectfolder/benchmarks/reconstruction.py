"""Audio-visual 3D reconstruction (main paper, section 4.3 and Table 4; supplementary I.3).

From an image, a sound, or both to the object's shape in its own frame, by an occupancy network behind the
encoders of the other benchmarks. IMAGE2MESH is "V", AUDIO2MESH "A", IMAGE+AUDIO2MESH "VA".
"""

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
import torch.nn.functional as F

from objectfolder.artifacts import read_json, write_json
from objectfolder.benchmarks.encoders import InputSizes, prepare
from objectfolder.benchmarks.observations import Observations
from objectfolder.benchmarks.occupancy import Occupancy, cached_occupancy
from objectfolder.benchmarks.occupancy_net import EMBEDDING, Reconstructor
from objectfolder.benchmarks.shape_model import Setup, ShapeModel, load_model, new_net, save_model
from objectfolder.benchmarks.shapes import (
    Surface,
    extract_mesh,
    intersection_over_union,
    sampled_surface,
    surface_scores,
)
from objectfolder.benchmarks.splits import Split, named_split, without_duplicates
from objectfolder.benchmarks.training import EpochPoint, shuffled, train
from objectfolder.objectfile import ObjectFile
from objectfolder.seeding import numpy_generator, seeded

#: What each variant looks at. VA comes last: it starts from the encoders of the others.
VARIANTS: dict[str, tuple[str, ...]] = {"V": ("vision",), "A": ("audio",), "VA": ("vision", "audio")}
CURVE = ("epoch", "train_loss", "val_iou")  #: columns of a training curve
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
    """What all variants share.

    Parameters
    ----------
    observations : Observations
    files : mapping of str to Path
        Object Files by key.
    params : ReconstructParams
    encoder : str
    sizes : InputSizes
    seed : int
    cache : Path
        Folder that keeps occupancy samples (``occupancy.npz``).
    weights : mapping of str to torch.Tensor, optional
        What encoders start from; see `objectfolder.benchmarks.encoders.read_weights`.
    device : str
    """

    observations: Observations
    files: Mapping[str, Path]
    params: ReconstructParams
    encoder: str
    sizes: InputSizes
    seed: int
    cache: Path
    weights: Mapping[str, torch.Tensor] | None = None
    device: str = "cpu"

    @cached_property
    def occupancy(self) -> Occupancy:
        """Occupancy samples of all objects; made at first use, or read."""
        files = {key: self.files[key] for key in self.observations.keys}
        p = self.params
        return cached_occupancy(
            self.cache / "occupancy.npz", files, POOL, VAL_POINTS, p.score_points, p.resolution, self.seed
        )

    @cached_property
    def truth(self) -> Callable[[int], Surface]:
        """Sampled surface of an object, by label."""
        return cache(lambda label: self._surface(label, "truth"))

    def _surface(self, label: int, purpose: str) -> Surface:
        key = self.observations.keys[label]
        surface = ObjectFile.load(self.files[key]).surface
        rng = numpy_generator(self.seed, "reconstruct", "surface", purpose, key)
        sampled = sampled_surface(surface.vertices, surface.faces, self.params.score_points, rng)
        assert sampled is not None  # an Object File without a surface is refused when it is read
        return sampled

    def floor(self, label: int) -> tuple[float, float]:
        """Surface scores of the truth itself, sampled anew: what a perfect answer would get."""
        return surface_scores(self._surface(label, "floor"), self.truth(label))


def reconstruct(
    task: Task,
    folder: Path,
    splits: Sequence[str] = ("seen", "unseen"),
    report: Callable[[str, EpochPoint], None] = lambda name, point: None,
) -> tuple[dict[str, Any], dict[str, list[list[float]]]]:
    """Train and score all variants on all splits.

    An interrupted call goes on where it was: ``folder`` keeps what is finished, and the running training.
    Test rows are looked at once, after everything was chosen on validation rows. Every variant trains at
    most ``epochs`` epochs; VA half as many, as it starts from the encoders of V and A, and from the fusion
    and the decoder of the one that validates better.

    Parameters
    ----------
    task : Task
    folder : Path
        Of this benchmark alone.
    splits : sequence of str
        "seen": test views and sounds of objects that were trained on, as in the paper. "unseen": of others.
    report : callable
        Called with "seen V" or the like and each new point of a training curve.

    Returns
    -------
    dict
        By split, then by variant or ``average_shape`` (the mean occupancy of the training objects): ``iou``,
        ``chamfer_l1``, ``normal_consistency`` (see `objectfolder.benchmarks.shapes`), means over ``samples``
        test rows, of which ``empty`` gave no surface; ``threshold``; ``per_object``, IoU by key; of variants
        also ``epochs``, ``val_iou`` and ``seconds``. Beside them ``perfect``, the surface scores of the truth
        against itself, and ``duplicates``, rows that were dropped because the training set holds the like.
    dict
        By "seen_V" or the like, rows of a training curve, whose columns are `CURVE`.

    Raises
    ------
    ObjectFolderError
        If files or checkpoints are damaged, a split cannot be made, or training diverges.
    """
    results: dict[str, Any] = {}
    curves: dict[str, list[list[float]]] = {}
    for name in splits:
        made = named_split(name, task.observations.keys, task.observations.count)
        split, duplicates = without_duplicates(made, task.observations, ("vision", "audio"))
        results[name] = {"duplicates": duplicates}
        for variant in VARIANTS:
            done = _finished(task, split, variant, folder, report)
            results[name][variant] = done["scores"]
            curves[f"{name}_{variant}"] = done["curve"]
        results[name]["average_shape"] = average_shape(task, split)
        chosen = task.observations.labels[selected(split.test, task)]
        floors = np.mean([task.floor(int(label)) for label in np.unique(chosen)], 0)
        results[name]["perfect"] = dict(zip(("chamfer_l1", "normal_consistency"), floors.tolist()))
    return results, curves


def model_path(folder: Path, split: str, variant: str) -> Path:
    """Where `reconstruct` keeps a trained model, such as IMAGE2MESH of split "seen", variant "V"."""
    return folder / f"{split}_{variant}.safetensors"


def _result_path(folder: Path, split: str, variant: str) -> Path:
    return folder / f"{split}_{variant}.json"


def selected(rows: np.ndarray, task: Task) -> np.ndarray:
    """Return the rows that are scored: the first ``views`` of each object, in order."""
    labels = task.observations.labels[rows]
    chosen = [rows[labels == label][: task.params.views] for label in np.unique(labels)]
    return np.concatenate(chosen)


def average_shape(task: Task, split: Split) -> dict[str, Any]:
    """Score the mean occupancy of the training objects, the same answer whatever is seen or heard.

    The threshold is the best one on validation rows.
    """
    labels, occupancy = task.observations.labels, task.occupancy
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
    return _scores(task, split, "average_shape", test, lambda i: inside, lambda i: mesh) | {
        "threshold": level
    }


def best_level(values: np.ndarray, inside: np.ndarray, levels: np.ndarray) -> tuple[float, float]:
    """Level above which values (B, P) agree best with the truth (B, P), and the mean IoU there.

    Of levels that are equally good, the lowest.
    """
    scores = [float(intersection_over_union(values > level, inside).mean()) for level in levels]
    best = int(np.argmax(scores))
    return float(levels[best]), scores[best]


def _finished(
    task: Task, split: Split, variant: str, folder: Path, report: Callable[[str, EpochPoint], None]
) -> dict[str, Any]:
    """Scores and curve of a variant: read, if they are there and of the same request, or made."""
    path, model = _result_path(folder, split.name, variant), model_path(folder, split.name, variant)
    request = _request(task, split, variant)
    if path.is_file() and model.is_file():
        stored: dict[str, Any] = read_json(path)
        if stored.get("request") == request:
            return stored
    start = time.perf_counter()
    checkpoint = folder / f".{split.name}_{variant}.{request[:16]}.pt"
    trained, curve = _trained(
        task, split, variant, folder, checkpoint, lambda point: report(f"{split.name} {variant}", point)
    )
    save_model(model, trained)
    scores = score_model(task, split, variant, trained) | {
        "epochs": len(curve),
        "val_iou": max(point.val_score for point in curve),
        "seconds": sum(point.seconds for point in curve) + time.perf_counter() - start,
    }
    done = {
        "request": request,
        "scores": scores,
        "curve": [[point.epoch, point.train_loss, point.val_score] for point in curve],
    }
    write_json(path, done)
    checkpoint.unlink(missing_ok=True)
    return done


def _request(task: Task, split: Split, variant: str) -> str:
    """Digest of all that scores follow from."""
    names = ReconstructParams.__annotations__
    weights = hashlib.sha256()
    for name, value in sorted((task.weights or {}).items()):
        weights.update(name.encode() + value.contiguous().numpy().tobytes())
    said = {
        "observations": task.observations.digest,
        "split": [split.name, *(rows.tolist() for rows in (split.train, split.val, split.test))],
        "variant": variant,
        "params": {name: getattr(task.params, name) for name in names},
        "encoder": task.encoder,
        "sizes": asdict(task.sizes),
        "seed": task.seed,
        "weights": weights.hexdigest(),
    }
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def _trained(
    task: Task,
    split: Split,
    variant: str,
    folder: Path,
    checkpoint: Path,
    report: Callable[[EpochPoint], None],
) -> tuple[ShapeModel, list[EpochPoint]]:
    observations, occupancy, params = task.observations, task.occupancy, task.params
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
    net, epochs = _started(task, setup, split, folder, purpose)

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
        report=report,
    )
    threshold = round(float(torch.tensor(validated()[0]).sigmoid()), 4)
    return ShapeModel(replace(setup, threshold=threshold), net), curve


def _started(
    task: Task, setup: Setup, split: Split, folder: Path, purpose: tuple[str, ...]
) -> tuple[Reconstructor, int]:
    """Give the net that training starts from and the number of epochs."""
    with seeded(task.seed, *purpose):
        net = new_net(setup, task.weights)
    if len(setup.modalities) == 1:
        return net, task.params.epochs
    parts = {variant: load_model(model_path(folder, split.name, variant)).net for variant in ("V", "A")}
    scores = {v: read_json(_result_path(folder, split.name, v))["scores"]["val_iou"] for v in parts}
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


def score_model(task: Task, split: Split, variant: str, model: ShapeModel) -> dict[str, Any]:
    """Score a trained model on the selected test rows."""
    rows = selected(split.test, task)
    embedding = model.embed({m: task.observations.read(m, rows) for m in model.setup.modalities})
    points = task.occupancy.score_points
    scores = _scores(
        task,
        split,
        variant,
        task.observations.labels[rows],
        lambda i: model.is_inside(embedding[i : i + 1], points)[0],
        lambda i: model.mesh(embedding[i]),
    )
    return scores | {"threshold": model.setup.threshold}


def _scores(
    task: Task,
    split: Split,
    name: str,
    labels: np.ndarray,
    inside: Callable[[int], np.ndarray],
    mesh: Callable[[int], tuple[np.ndarray, np.ndarray]],
) -> dict[str, Any]:
    """Means over samples, whose objects are ``labels``, of what is answered to the i-th."""
    iou, surfaces, empty = np.zeros(len(labels)), np.zeros((len(labels), 2)), 0
    for i, label in enumerate(labels):
        iou[i] = intersection_over_union(inside(i), task.occupancy.score_inside[label])
        rng = numpy_generator(task.seed, "reconstruct", "surface", split.name, name, str(i))
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
