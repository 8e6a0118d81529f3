"""Cross-sensory retrieval: find, by one sense, the same object as met by another (supplementary I.2)."""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple
from itertools import combinations
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F
from torch.optim.swa_utils import update_bn

from objectfolder.artifacts import MODALITIES, SPLITS, file_digest, read_json, write_json
from objectfolder.benchmarks import cca
from objectfolder.benchmarks.encoders import InputSizes, Weights, make_encoder, prepare
from objectfolder.benchmarks.observations import Observations
from objectfolder.benchmarks.scores import chance_map, interval_95, mean_average_precision
from objectfolder.benchmarks.splits import Split, without_duplicates
from objectfolder.benchmarks.training import EpochPoint, train
from objectfolder.errors import ObjectFolderError
from objectfolder.seeding import numpy_generator, seeded

Pair = tuple[str, str]  #: two modalities
Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  #: inputs of both streams, classes of the rows
PAIRS: tuple[Pair, ...] = tuple(combinations(MODALITIES, 2))
CURVE_COLUMNS = ("split", "first", "second", "seed", "epoch", "train_loss", "val_map")
FEATURE_SIZES = {"vision": (16, 16), "audio": (64, 8), "touch": (16, 12)}  #: pixels that CCA is given
DIMENSIONS = (2, 4, 8, 16, 32, 64, 128)  #: principal components and canonical variates that CCA is tried with
CHUNK = 64  #: rows, at most, that are embedded at once
STATISTICS = 512  #: training rows that the batch normalisation's statistics are taken from


class Params(Protocol):
    """How the nets are trained; `objectfolder.benchmarks.params` has them."""

    seeds: int
    epochs: int
    batch: int
    learning_rate: float
    weight_decay: float
    patience: int
    margin: float
    embedding: int


class TwoStream(nn.Module):
    """Two encoders, one of each modality, and the head that they share.

    The head's first layer maps features to the cross-sensory embedding, its second, after a ReLU, to classes.
    The embedding is taken before the ReLU, so that its cosines may be negative.

    Parameters
    ----------
    encoders : two modules with an attribute ``features``
    embedding : int
        Numbers of an embedding.
    classes : int
    """

    def __init__(self, encoders: Sequence[nn.Module], embedding: int, classes: int):
        super().__init__()
        self.encoders = nn.ModuleList(encoders)
        self.embedding = nn.Linear(int(encoders[0].features), embedding)  # type: ignore[arg-type]
        self.classifier = nn.Linear(embedding, classes)

    def embed(self, stream: int, inputs: torch.Tensor) -> torch.Tensor:
        """Embeddings (B, embedding) of one stream's inputs (B, C, H, W)."""
        return self.embedding(self.encoders[stream](inputs))

    def classify(self, embeddings: torch.Tensor) -> torch.Tensor:
        """(B, embedding) -> (B, classes) logits."""
        return self.classifier(torch.relu(embeddings))


def triplet_loss(
    anchor: torch.Tensor, positive: torch.Tensor, labels: torch.Tensor, margin: float
) -> torch.Tensor:
    """Equation 1, averaged over the anchors and over all negatives that the batch has for each.

    The loss of a triplet is ``max(0, D(anchor, positive) - D(anchor, negative) + margin)`` with the cosine
    distance D = 1 - cos. A negative is of the anchor's modality and of another object.

    Parameters
    ----------
    anchor : (B, D) tensor
        Embeddings of one modality.
    positive : (B, D) tensor
        Embeddings of the other modality, row by row of the same object.
    labels : (B,) integer tensor
        Objects of the rows, two or more different ones.
    margin : float

    Returns
    -------
    Scalar tensor.
    """
    # Sixteen bits would round the differences of near cosines away.
    with torch.autocast(anchor.device.type, enabled=False):
        anchor, positive = F.normalize(anchor.float()), F.normalize(positive.float())
        to_positive = (anchor * positive).sum(1, keepdim=True)
        losses = torch.relu(anchor @ anchor.T - to_positive + margin)
        return losses[labels[:, None] != labels].mean()


def cross_sensory_loss(
    first: torch.Tensor, second: torch.Tensor, labels: torch.Tensor, margin: float
) -> torch.Tensor:
    """Equation 2: the triplet losses with anchors of the first and of the second modality."""
    return triplet_loss(first, second, labels, margin) + triplet_loss(second, first, labels, margin)


def paired_batches(
    rows: np.ndarray, labels: np.ndarray, batch: int, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Give every row once in each of two modalities, in pairs of the same object, and in batches.

    Which rows of an object pair up is random. Objects take turns, so that each batch has two or more.

    Parameters
    ----------
    rows : (R,) int array
    labels : (R,) int array
        Their objects, as many rows of each.
    batch : int
        Pairs, at least three.

    Yields
    ------
    Rows of the first and of the second modality, (B,) each.

    Raises
    ------
    ObjectFolderError
        If there is one object only, the batch is too small, or the objects have unequal numbers of rows.
    """
    objects, counts = np.unique(labels, return_counts=True)
    if len(objects) < 2 or batch < 3:
        raise ObjectFolderError(
            f"{len(objects)} object(s) to train on, in batches of {batch}; expected two objects and batches "
            "of three at least, because each batch needs negatives"
        )
    if np.ptp(counts):
        raise ObjectFolderError(
            f"objects have {counts.min()} to {counts.max()} training rows; expected as many of each"
        )
    by_object = rows[np.argsort(labels, kind="stable")].reshape(len(objects), -1)
    turns = rng.permuted(np.tile(np.arange(len(objects)), (counts[0], 1)), axis=1)
    first, second = (
        np.take_along_axis(rng.permuted(by_object, axis=1).T, turns, axis=1).ravel() for _ in range(2)
    )
    ends = np.arange(batch, len(rows), batch)
    if len(ends) and len(rows) - ends[-1] == 1:  # a row alone has no negative
        ends = ends[:-1]
    yield from zip(np.split(first, ends), np.split(second, ends))


def retrieve(
    observations: Observations,
    splits: Sequence[Split],
    params: Params,
    encoder: str,
    sizes: InputSizes,
    *,
    weights: Weights | None = None,
    seed: int,
    progress: Path,
    device: str | torch.device = "cpu",
    report: Callable[[str], None] = lambda line: None,
) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score the retrieval of each pair of modalities, on each split (main paper, Table 3).

    Queries are the test rows of one modality, the gallery those of the other; relevant is what is of the same
    object. Test rows are read once, after the training. What the baseline CCA is fitted on are the same
    training rows, and what it is tried with is chosen by the same validation rows.

    Parameters
    ----------
    observations : Observations
    splits : sequence of Split
        Validation and test rows that have a duplicate among earlier rows, in any modality, are dropped here.
    params : Params
        Sizes of the training; ``seeds`` nets are trained for each pair.
    encoder : str
        Name of the encoders (`objectfolder.benchmarks.encoders.register_encoder`).
    sizes : InputSizes
    weights : Weights, optional
        That the encoders start from.
    seed : int
        Of the first net of each pair; the others have the following ones.
    progress : Path
        Folder that keeps finished scores and the state of a training, from which an interrupted call goes on.
        Those of other data or parameters are not taken. Remove it afterwards.
    device : str or torch.device
    report : callable
        Called with a line about each epoch.

    Returns
    -------
    dict
        By split and direction (such as ``V->A``: seen, what does it sound like?): ``map`` (mean over the
        seeds), its ``interval_95``, ``seeds`` (one value each), ``cca`` and ``chance``. Then ``objects``,
        and by split ``rows``, ``duplicates`` and what was chosen for ``cca``; ``seconds`` of training.
    list
        Rows of the training curves, see `CURVE_COLUMNS`.

    Raises
    ------
    ObjectFolderError
        If a split cannot be trained on or scored, or a training diverges.
    """
    results: dict[str, Any] = {"objects": len(observations.keys), "rows": {}, "duplicates": {}, "cca": {}}
    curves: list[list[Any]] = []
    seconds = 0.0
    for whole in splits:
        split, results["duplicates"][whole.name] = without_duplicates(whole, observations, MODALITIES)
        results["rows"][whole.name] = {name: len(getattr(split, name)) for name in SPLITS}
        labels = observations.labels[split.test]
        chance = chance_map(labels, labels)
        features = {modality: _features(observations, modality, split, sizes) for modality in MODALITIES}
        results[split.name], results["cca"][split.name] = {}, {}
        for pair in PAIRS:
            baseline, chosen = _correlated(pair, features, observations.labels, split)
            results["cca"][split.name]["-".join(pair)] = chosen
            runs = [
                _trained(
                    observations,
                    split,
                    pair,
                    params,
                    encoder,
                    sizes,
                    weights,
                    run_seed,
                    progress,
                    device,
                    report,
                )
                for run_seed in range(seed, seed + params.seeds)
            ]
            for direction in baseline:
                values = [run["map"][direction] for run in runs]
                results[split.name][direction] = {
                    "map": float(np.mean(values)),
                    "interval_95": interval_95(values),
                    "seeds": values,
                    "cca": baseline[direction],
                    "chance": chance,
                }
            for i, run in enumerate(runs):
                curves += [[split.name, *pair, seed + i, *point] for point in run["curve"]]
                seconds += run["seconds"]
    return {**results, "seconds": seconds}, curves


def _trained(
    observations: Observations,
    split: Split,
    pair: Pair,
    params: Params,
    encoder: str,
    sizes: InputSizes,
    weights: Weights | None,
    seed: int,
    progress: Path,
    device: str | torch.device,
    report: Callable[[str], None],
) -> dict[str, Any]:
    """Train one net and score it; or read what an earlier call wrote."""
    title = f"{split.name} {pair[0]}-{pair[1]} seed {seed}"
    identity = {
        "observations": observations.digest,
        "rows": [getattr(split, name).tolist() for name in SPLITS],
        "params": [getattr(params, name) for name in sorted(Params.__annotations__) if name != "seeds"],
        "encoder": [encoder, astuple(sizes), None if weights is None else file_digest(weights.path)],
    }
    digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:16]
    finished = progress / f"{title.replace(' ', '_')}_{digest}.json"
    if finished.is_file():
        return read_json(finished)

    labels = observations.labels
    classes = np.unique(labels[split.train])
    purpose = ("retrieve", split.name, *pair)
    with seeded(seed, *purpose, "net"):
        net = TwoStream(
            [make_encoder(encoder, modality, weights) for modality in pair], params.embedding, len(classes)
        )

    def epoch_batches(epoch: int) -> Iterator[Batch]:
        rng = numpy_generator(seed, *purpose, f"epoch {epoch}")
        for rows in paired_batches(split.train, labels[split.train], params.batch, rng):
            first, second = (prepare(m, observations.read(m, r), sizes, rng) for m, r in zip(pair, rows))
            yield first, second, torch.from_numpy(np.searchsorted(classes, labels[rows[0]]))

    def batch_loss(batch: Batch) -> torch.Tensor:
        *pictures, targets = (x.to(device) for x in batch)
        first, second = (net.embed(stream, x) for stream, x in enumerate(pictures))
        classification = sum(F.cross_entropy(net.classify(x), targets) for x in (first, second))
        return cross_sensory_loss(first, second, targets, params.margin) + classification

    def inputs(stream: int, rows: np.ndarray) -> Iterator[torch.Tensor]:
        for chunk in _chunks(rows):
            yield prepare(pair[stream], observations.read(pair[stream], chunk), sizes).to(device)

    def scores(rows: np.ndarray) -> dict[str, float]:
        embeddings = [
            torch.cat([net.embed(stream, x) for x in inputs(stream, rows)]).float().cpu().numpy()
            for stream in (0, 1)
        ]
        return _maps(pair, embeddings, labels[rows])

    sample = numpy_generator(seed, *purpose, "statistics").permutation(split.train)[:STATISTICS]

    def validation() -> float:
        # Running averages lag behind weights that change fast: the first epochs would score near chance
        # however well they separate the training batches (Wu and Johnson 2021).
        for stream, encoder in enumerate(net.encoders):
            update_bn(inputs(stream, sample), encoder)
        return _mean(scores(split.val))

    def progress_line(point: EpochPoint) -> None:
        report(
            f"{title}: epoch {point.epoch} of {params.epochs}, loss {point.train_loss:.3f}, "
            f"validation mAP {point.val_score:.3f}, {point.seconds:.0f} s"
        )

    checkpoint = finished.with_suffix(".pt")
    curve = train(
        net,
        epoch_batches,
        batch_loss,
        validation,
        epochs=params.epochs,
        learning_rate=params.learning_rate,
        weight_decay=params.weight_decay,
        patience=params.patience,
        checkpoint=checkpoint,
        device=device,
        report=progress_line,
    )
    with torch.no_grad():
        run = {
            "map": scores(split.test),
            "curve": [[point.epoch, point.train_loss, point.val_score] for point in curve],
            "seconds": sum(point.seconds for point in curve),
        }
    write_json(finished, run)
    checkpoint.unlink()
    return run


def _correlated(
    pair: Pair, features: dict[str, dict[str, np.ndarray]], labels: np.ndarray, split: Split
) -> tuple[dict[str, float], dict[str, int]]:
    """Score CCA by direction, with the dimensions that are best on the validation rows."""
    sides = [features[modality] for modality in pair]

    def scores(rows: str, dimensions: int, components: int) -> dict[str, float]:
        variates = [
            side[rows][:, :dimensions] @ matrix[:, :components]
            for side, matrix in zip(sides, found[dimensions])
        ]
        return _maps(pair, variates, labels[getattr(split, rows)])

    found = {
        dimensions: cca.directions(
            sides[0]["train"][:, :dimensions], sides[1]["train"][:, :dimensions], labels[split.train]
        )
        for dimensions in DIMENSIONS
    }
    tried = {
        (dimensions, components): _mean(scores("val", dimensions, components))
        for dimensions in DIMENSIONS
        for components in DIMENSIONS
        if components <= found[dimensions][0].shape[1]
    }
    dimensions, components = max(tried, key=tried.__getitem__)
    return scores("test", dimensions, components), {"dimensions": dimensions, "components": components}


def _features(
    observations: Observations, modality: str, split: Split, sizes: InputSizes
) -> dict[str, np.ndarray]:
    """What CCA knows of each row of a split: components of the encoder's input at few pixels; (n, D)."""
    shape = FEATURE_SIZES[modality]

    def pixels(rows: np.ndarray) -> np.ndarray:
        x = prepare(modality, observations.read(modality, rows), sizes)
        return F.adaptive_avg_pool2d(x, shape).flatten(1).numpy()

    features = {
        name: np.concatenate([pixels(rows) for rows in _chunks(getattr(split, name))]) for name in SPLITS
    }
    whiten = cca.whitening(features["train"], max(DIMENSIONS))
    return {name: whiten(value) for name, value in features.items()}


def _maps(pair: Pair, embeddings: Sequence[np.ndarray], labels: np.ndarray) -> dict[str, float]:
    """Mean average precision by direction, of embeddings of the same rows in two modalities."""
    return {
        f"{pair[query][0].upper()}->{pair[1 - query][0].upper()}": mean_average_precision(
            embeddings[query], labels, embeddings[1 - query], labels
        )
        for query in (0, 1)
    }


def _mean(scores: dict[str, float]) -> float:
    return sum(scores.values()) / len(scores)


def _chunks(rows: np.ndarray) -> list[np.ndarray]:
    return np.array_split(rows, -(-len(rows) // CHUNK))
