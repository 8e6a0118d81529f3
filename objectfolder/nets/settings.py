"""Settings that the nets of the paper share."""

from dataclasses import dataclass
from typing import Any

from objectfolder.base.settings import Count, Octaves, Positive, Precision, Share


@dataclass(frozen=True, kw_only=True)
class PapersNetConfig:
    """Shape and training that the nets of the paper share."""

    width: Count = 256
    depth: Count = 8
    point_octaves: Octaves = 10
    steps: Count = 500_000
    batch: Count = 16_384  #: pixels of ``image``; bins of ``spectrogram``, each for all three force axes
    learning_rate: Positive = 0.0005
    final_rate: Share = 0.01  #: of the learning rate, at the end of a cosine; 1: constant, as the paper's
    precision: Precision = "float32"  #: of the hidden layers in training


def papers_net(settings: Any, kind: str) -> PapersNetConfig | None:
    """Return the settings of a kind of net in a section, or its class, if it is one of the paper's."""
    own = getattr(settings, kind, None)
    return own if isinstance(own, PapersNetConfig) else None
