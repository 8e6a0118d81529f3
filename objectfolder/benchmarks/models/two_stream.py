"""Two encoders with a shared embedding, their losses, and the pairs they learn from (supplementary I.2)."""

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from objectfolder.base.errors import ObjectFolderError, plural


class TwoStream(nn.Module):
    """Two encoders, one per modality, each with an attribute ``features``, and a shared head.

    The head's first layer maps features to the cross-sensory embedding, its second, after a ReLU, to classes.
    The embedding is taken before the ReLU, so that its cosines may be negative.
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
    """Compute equation 1, averaged over anchors and all their negatives in the batch.

    The loss of a triplet is ``max(0, D(anchor, positive) - D(anchor, negative) + margin)`` with the cosine
    distance D = 1 - cos. A negative is of the anchor's modality and of another object. Embeddings are (B, D):
    anchors of one modality, positives of the other, row by row of the same object. Labels (B,) name the
    objects of the rows, two or more different ones.
    """
    # Differences of similar cosines need more than 16 bits.
    with torch.autocast(anchor.device.type, enabled=False):
        anchor, positive = F.normalize(anchor.float()), F.normalize(positive.float())
        to_positive = (anchor * positive).sum(1, keepdim=True)
        losses = torch.relu(anchor @ anchor.T - to_positive + margin)
        return losses[labels[:, None] != labels].mean()


def cross_sensory_loss(
    first: torch.Tensor, second: torch.Tensor, labels: torch.Tensor, margin: float
) -> torch.Tensor:
    """Compute equation 2: the sum of the triplet losses with anchors of either modality."""
    return triplet_loss(first, second, labels, margin) + triplet_loss(second, first, labels, margin)


def paired_batches(
    rows: np.ndarray, labels: np.ndarray, batch: int, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield batches of pairs of rows of the same object, each row once per modality.

    Labels (R,) name the objects of the rows (R,), as many rows of each. Rows of an object are paired at
    random. Objects alternate, so that each batch, of at least three pairs, has at least two. Yields the rows
    of the first and of the second modality, (B,) each. Raises ObjectFolderError if there is one object only,
    the batch is too small, or the objects have unequal numbers of rows.
    """
    objects, counts = np.unique(labels, return_counts=True)
    if len(objects) < 2 or batch < 3:
        raise ObjectFolderError(
            f"{plural(len(objects), 'object')} to train on, in batches of {batch}; expected two objects and "
            "batches of three at least, because each batch needs negatives"
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
