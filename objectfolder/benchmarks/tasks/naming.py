"""Pre-training: an encoder alone learns to name the training objects, before retrieval or reconstruction."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch.nn import functional as F

from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.models.classifier import Classifier
from objectfolder.benchmarks.models.settings import TrainingConfig
from objectfolder.benchmarks.models.training import EpochPoint, Objective, count_batches, shuffle
from objectfolder.benchmarks.scoring.scores import mean_average_precision
from objectfolder.benchmarks.tasks.job import Job, in_chunks

SAMPLE = 256  #: training rows in the gallery of validation

#: Makes encoder inputs of rows; with a generator those of training.
Inputs = Callable[[np.ndarray, np.random.Generator | None], torch.Tensor]
Batch = tuple[torch.Tensor, torch.Tensor]  #: inputs, classes

_Params = TypeVar("_Params", bound=TrainingConfig)


def train_namer(
    job: Job[_Params],
    stage: str,
    modality: str,
    run: int,
    inputs: Inputs,
    epochs: int,
    one_cycle: bool,
    rate: float = 1.0,
) -> tuple[Classifier, list[EpochPoint]]:
    """Train an encoder and a linear layer to name the training objects, or read its finished checkpoint.

    The epoch is the one whose features retrieve the validation rows best, within the modality. ``stage`` is
    the task, which names the random numbers; ``run`` the seed, from 0; ``inputs`` are those of the encoder;
    ``rate`` is a factor of the learning rate. The classes are the training objects in label order.
    """
    params, rows, labels = job.params, job.split.train, job.observations.labels
    classes = np.unique(labels[rows])
    purpose = (stage, job.split.name, modality, str(run))
    with seeded(job.seed, *purpose):
        net = Classifier({modality: job.make_encoder(modality)}, len(classes))

    def epoch_batches(epoch: int) -> Iterator[Batch]:
        rng = numpy_generator(job.seed, *purpose, f"epoch {epoch}")
        for some in shuffle(rows, params.batch, rng):
            targets = torch.from_numpy(np.searchsorted(classes, labels[some]))
            yield inputs(some, rng), targets.to(job.device)

    def batch_loss(batch: Batch) -> torch.Tensor:
        given, targets = batch
        return F.cross_entropy(net({modality: given}), targets)

    def val_score() -> float:
        gallery = validation_gallery(job, stage)
        features = in_chunks(lambda some: net.encoders[modality](inputs(some, None)), gallery)
        return score_within(features.cpu().numpy(), labels[gallery], len(job.split.val))

    curve = job.train(
        f"{stage} {job.split.name}, {modality} alone, seed {run + 1}",
        Objective(net, epoch_batches, batch_loss, val_score, "mAP"),
        namer_checkpoint(job, modality, run),
        epochs,
        rate,
        epochs * count_batches(len(rows), params.batch) if one_cycle else None,
    )
    return net, curve


def namer_checkpoint(job: Job[_Params], modality: str, run: int) -> Path:
    """Return the path of a namer's checkpoint, which stays until it is deleted."""
    return job.progress / f"encoder_{modality}_{run}.pt"


def validation_gallery(job: Job[_Params], stage: str) -> np.ndarray:
    """Return the validation rows, which are the queries, then some training rows.

    The few validation objects of the split ``unseen`` alone would be too easy to rank.
    """
    rng = numpy_generator(job.seed, stage, job.split.name, "sample")
    return np.concatenate([job.split.val, rng.permutation(job.split.train)[:SAMPLE]])


def repeated_objects(labels: np.ndarray, queries: int) -> np.ndarray:
    """Return which of the queries, the first rows, have another row of their object."""
    _, inverse, counts = np.unique(labels, return_inverse=True, return_counts=True)
    return np.flatnonzero(counts[inverse[:queries]] > 1)


def score_within(embeddings: np.ndarray, labels: np.ndarray, queries: int, cosine: bool = True) -> float:
    """Score the `repeated_objects` of the queries among all other rows of the same modality."""
    asked = repeated_objects(labels, queries)
    order = np.concatenate([asked, np.setdiff1d(np.arange(len(labels)), asked)])
    of = labels[order]
    return mean_average_precision(
        embeddings[asked], labels[asked], embeddings[order], of, own=True, cosine=cosine
    )
