"""Cross-sensory retrieval: find observations of the same object in another modality (supplementary I.2)."""

from collections.abc import Iterator, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.models.baselines import find_directions, fit_whitening
from objectfolder.benchmarks.models.training import EpochPoint, Objective, count_batches
from objectfolder.benchmarks.models.two_stream import TwoStream, cross_sensory_loss, paired_batches
from objectfolder.benchmarks.scoring.scores import chance_map, mean_average_precision, over_seeds
from objectfolder.benchmarks.tasks import naming
from objectfolder.benchmarks.tasks.job import Job, in_chunks
from objectfolder.benchmarks.tasks.retrieve import RetrieveConfig, check_objects
from objectfolder.benchmarks.tasks.task import Objects
from objectfolder.benchmarks.tasks.touch_shapes import in_touch_frame
from objectfolder.workspace.layout import MODALITIES

Pair = tuple[str, str]  #: two modalities
Maps = dict[str, float]  #: mean average precision by direction, such as V->A
Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  #: inputs of both streams, classes of the rows
PAIRS: tuple[Pair, ...] = tuple(combinations(MODALITIES, 2))
FEATURE_SIZES = {"vision": (16, 16), "audio": (64, 8), "touch": (16, 12)}  #: input sizes of CCA, pixels
DIMENSIONS = tuple(2**i for i in range(10))  #: candidate numbers of components and of variates of CCA
FINE_RATE = 0.25  #: learning rate with pre-trained encoders, relative to that of the settings


def retrieve(job: Job[RetrieveConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score the retrieval of each pair of modalities (main paper, Table 3).

    Queries are the test rows of one modality, the gallery those of the other; observations of
    the same object are relevant. The gallery is ranked by the cosine of embeddings, and once more, ``named``,
    by the probability that both rows are of one object, after the classifier's probabilities of each. With
    queries and gallery of one modality, no row finds itself; the scores are means over the two pairs that
    hold it. The epoch is chosen on the validation rows, ranked by cosine among some training rows. With
    ``pretrain_epochs``, encoders first learn to name the training objects. The baseline CCA is fitted on the
    same training rows, and its dimensions are chosen in the same way. Test rows are evaluated once, after
    training.

    Raises ObjectFolderError if a split cannot be trained on or scored, or a training diverges.

    Returns ``directions``, such as ``V->A`` (sounds from views) or ``V->V``: ``map`` (mean over the seeds),
    its ``interval_95``, ``seeds`` (one value each); ``named``, with the same three; ``cca``; ``chance``. Then
    what was chosen for ``cca``, the counts of `Job.without_duplicates`, with a row dropped for all pairs if
    both inputs of one repeat, and ``seconds`` of training.
    In rows of the training curves, ``second`` is empty in pre-training.
    """
    check_objects(job.split, Objects(job.observations.keys, job.observations.labels))
    job.check_sizes(MODALITIES)
    job = in_touch_frame(job)
    # The same gallery for all pairs, although only some of them may repeat a row.
    job, rows = job.without_duplicates(*PAIRS)
    labels = job.observations.labels[job.split.test]
    correlated = job.compute_once("cca", lambda: _score_cca(job))
    baselines: list[Maps] = correlated["maps"]
    seeds = range(job.params.seeds)
    alone = list(product(MODALITIES, seeds)) if job.params.pretrain_epochs else []
    named = {one: _pretrain(job, *one) for one in alone}
    finished = {pair: [_train_once(job, pair, run) for run in seeds] for pair in PAIRS}
    for checkpoint in job.progress.glob("encoder_*.pt"):
        checkpoint.unlink()
    directions: dict[str, Any] = {}
    chance, repeated = chance_map(labels, labels), naming.repeated_objects(labels, len(labels))
    chance_within = chance_map(labels, labels[repeated], own=True) if len(repeated) else None
    for direction in sorted({name for baseline in baselines for name in baseline}):
        # A direction within a sense belongs to two pairs.
        nets = [runs for runs in finished.values() if direction in runs[0]["map"]]
        by_cosine, by_names = (
            [float(np.mean([runs[run][rank][direction] for runs in nets])) for run in seeds]
            for rank in ("map", "named")
        )
        directions[direction] = {
            **over_seeds("map", by_cosine),
            "named": over_seeds("map", by_names),
            "cca": float(np.mean([baseline[direction] for baseline in baselines if direction in baseline])),
            "chance": chance if direction[0] != direction[-1] else chance_within,
        }
    curves = [[name, "", run, *point] for (name, run), unit in named.items() for point in unit["curve"]]
    for pair, runs in finished.items():
        curves += [[*pair, i, *point] for i, run in enumerate(runs) for point in run["curve"]]
    units = [*named.values(), *(run for runs in finished.values() for run in runs)]
    seconds = sum(unit["seconds"] for unit in units)
    return {"directions": directions, "cca": correlated["chosen"], **rows, "seconds": seconds}, curves


def _pretrain(job: Job[RetrieveConfig], modality: str, run: int) -> dict[str, Any]:
    """Return the curve of an encoder's pre-training, which leaves its checkpoint behind."""
    return job.train_once(f"encoder_{modality}_{run}", lambda: _namer(job, modality, run), lambda net: {})


def _train_once(job: Job[RetrieveConfig], pair: Pair, run: int) -> dict[str, Any]:
    """Return the scores of one net, trained unless finished earlier."""
    name = f"{pair[0]}_{pair[1]}_{run}"
    checkpoint = job.progress / f"{name}.pt"

    def score(net: TwoStream) -> dict[str, Any]:
        embeddings = _embeddings(job, net, pair, job.split.test)
        named = [_probabilities(net, some) for some in embeddings]
        return {"map": _maps(job, pair, embeddings), "named": _maps(job, pair, named, cosine=False)}

    return job.train_once(name, lambda: _train(job, pair, run, checkpoint), score, [checkpoint])


def _train(
    job: Job[RetrieveConfig], pair: Pair, run: int, checkpoint: Path
) -> tuple[TwoStream, list[EpochPoint]]:
    """Train one net, or resume from its checkpoint."""
    params, rows, labels = job.params, job.split.train, job.observations.labels
    classes = np.unique(labels[rows])
    purpose = ("retrieve", job.split.name, *pair, str(run))
    with seeded(job.seed, *purpose):
        net = TwoStream([job.make_encoder(modality) for modality in pair], params.embedding, len(classes))
    if params.pretrain_epochs:
        for encoder, modality in zip(net.encoders, pair):
            encoder.load_state_dict(_namer(job, modality, run)[0].state_dict())

    def epoch_batches(epoch: int) -> Iterator[Batch]:
        rng = numpy_generator(job.seed, *purpose, f"epoch {epoch}")
        for paired in paired_batches(rows, labels[rows], params.batch, rng):
            first, second = (job.inputs(m, some, rng) for m, some in zip(pair, paired))
            targets = torch.from_numpy(np.searchsorted(classes, labels[paired[0]]))
            yield first, second, targets.to(job.device)

    def batch_loss(batch: Batch) -> torch.Tensor:
        *inputs, targets = batch
        first, second = (net.embed(stream, x) for stream, x in enumerate(inputs))
        classification = sum(F.cross_entropy(net.classify(x), targets) for x in (first, second))
        return cross_sensory_loss(first, second, targets, params.margin) + classification

    def val_score() -> float:
        return _val_score(job, _embeddings(job, net, pair, naming.validation_gallery(job, "retrieve")))

    steps = params.epochs * count_batches(len(rows), params.batch)
    curve = job.train(
        f"retrieve {job.split.name}, {pair[0]} and {pair[1]}, seed {run + 1} of {params.seeds}",
        Objective(net, epoch_batches, batch_loss, val_score, "mAP"),
        checkpoint,
        rate=FINE_RATE if params.pretrain_epochs else 1.0,
        cycle=steps if params.schedule == "one_cycle" else None,
    )
    return net, curve


def _namer(job: Job[RetrieveConfig], modality: str, run: int) -> tuple[nn.Module, list[EpochPoint]]:
    """Train an encoder to name the training objects, or read its finished checkpoint."""

    def inputs(rows: np.ndarray, rng: np.random.Generator | None) -> torch.Tensor:
        return job.inputs(modality, rows, rng)

    epochs, one_cycle = job.params.pretrain_epochs, job.params.schedule == "one_cycle"
    net, curve = naming.train_namer(job, "retrieve", modality, run, inputs, epochs, one_cycle)
    return net.encoders[modality], curve


def _maps(
    job: Job[RetrieveConfig], pair: Pair, embeddings: Sequence[np.ndarray], cosine: bool = True
) -> Maps:
    """Score embeddings of the test rows in two modalities, between them and within each."""
    labels = job.observations.labels[job.split.test]
    names = [modality[0].upper() for modality in pair]
    crossed = _score_crossed(embeddings, labels, len(labels), cosine)
    maps = dict(zip(("->".join(names), "->".join(names[::-1])), crossed))
    if len(naming.repeated_objects(labels, len(labels))):
        maps |= {
            f"{name}->{name}": naming.score_within(x, labels, len(labels), cosine)
            for name, x in zip(names, embeddings)
        }
    return maps


def _val_score(job: Job[RetrieveConfig], embeddings: Sequence[np.ndarray]) -> float:
    """Score embeddings of the `validation_gallery` in two modalities: the mean over both directions."""
    labels = job.observations.labels[naming.validation_gallery(job, "retrieve")]
    return float(np.mean(_score_crossed(embeddings, labels, len(job.split.val))))


def _score_crossed(
    embeddings: Sequence[np.ndarray], labels: np.ndarray, queries: int, cosine: bool = True
) -> list[float]:
    """Score the first rows of one modality as queries for all rows of the other, and the reverse."""
    return [
        mean_average_precision(
            embeddings[query][:queries], labels[:queries], embeddings[1 - query], labels, cosine=cosine
        )
        for query in (0, 1)
    ]


@torch.no_grad()
def _embeddings(job: Job[RetrieveConfig], net: TwoStream, pair: Pair, rows: np.ndarray) -> list[np.ndarray]:
    """Return the embeddings (n, embedding) of both streams."""

    def embed(stream: int, modality: str) -> np.ndarray:
        return in_chunks(lambda some: net.embed(stream, job.inputs(modality, some)), rows).cpu().numpy()

    return [embed(*one) for one in enumerate(pair)]


@torch.no_grad()
def _probabilities(net: TwoStream, embeddings: np.ndarray) -> np.ndarray:
    """Return the probability of each training object, (n, classes)."""
    device = net.embedding.weight.device
    return net.classify(torch.from_numpy(embeddings).to(device)).double().softmax(1).cpu().numpy()


def _features(job: Job[RetrieveConfig], modality: str) -> dict[str, np.ndarray]:
    """Return the CCA inputs of each part of a split: whitened, downsampled encoder inputs; (n, D)."""
    shape = FEATURE_SIZES[modality]

    def pixels(rows: np.ndarray) -> np.ndarray:
        return job.pooled(modality, rows, shape).cpu().numpy()

    train = pixels(job.split.train)
    whiten = fit_whitening(train, max(DIMENSIONS))
    return {
        "train": whiten(train),
        "validation": whiten(pixels(naming.validation_gallery(job, "retrieve"))),
        "test": whiten(pixels(job.split.test)),
    }


def _score_cca(job: Job[RetrieveConfig]) -> dict[str, Any]:
    """Return the scores of CCA for each pair, and what was chosen; no seed changes them."""
    features = {modality: _features(job, modality) for modality in MODALITIES}
    maps, chosen = zip(*(_correlate(job, pair, features) for pair in PAIRS))
    return {"maps": maps, "chosen": dict(zip(map("-".join, PAIRS), chosen))}


def _correlate(
    job: Job[RetrieveConfig], pair: Pair, features: dict[str, dict[str, np.ndarray]]
) -> tuple[Maps, dict[str, int]]:
    """Score CCA by direction, with the dimensions that are best on the validation rows."""
    first, second = (features[modality] for modality in pair)
    labels = job.observations.labels[job.split.train]
    found = {d: find_directions(first["train"][:, :d], second["train"][:, :d], labels) for d in DIMENSIONS}

    def variates(name: str, dimensions: int, components: int) -> list[np.ndarray]:
        return [
            side[name][:, :dimensions] @ matrix[:, :components]
            for side, matrix in zip((first, second), found[dimensions])
        ]

    tried = {
        chosen: _val_score(job, variates("validation", *chosen))
        for chosen in product(DIMENSIONS, DIMENSIONS)
        if chosen[1] <= found[chosen[0]][0].shape[1]
    }
    chosen = max(tried, key=tried.__getitem__)
    scores = _maps(job, pair, variates("test", *chosen))
    return scores, dict(zip(("dimensions", "components"), chosen))
