"""Settings of the touch nets: section ``train_touch`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Literal

from objectfolder.settings import Count, Octaves, Positive, Precision, Share


@dataclass(frozen=True, kw_only=True)
class ImageConfig:
    """Shape and training of a net of kind ``image``."""

    width: Count
    depth: Count
    point_octaves: Octaves
    pixel_octaves: Octaves
    steps: Count
    batch: Count  #: pixels
    learning_rate: Positive
    final_rate: Share  #: of the learning rate, at the end of a cosine; 1: constant, as the paper's
    precision: Precision  #: of the hidden layers in training


@dataclass(frozen=True, kw_only=True)
class TouchConfig:
    """Kind of the touch net, with settings for both kinds."""

    net: Literal["geometric", "image"]
    offset_span: Positive  #: the depth offset is searched up to this, either way, metres
    rounds: Count  #: bisection steps of the search
    contacts: Count  #: maximum number of contacts that ``geometric`` is fitted to, and of validation contacts
    image: ImageConfig
