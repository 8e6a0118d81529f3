"""Settings of the touch nets: section ``train_touch`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Literal

from objectfolder.settings import Count, Octaves, Positive, Precision, Share


@dataclass(frozen=True, kw_only=True)
class ImageConfig:
    """Shape and training of a net of kind ``image``."""

    width: Count = 256
    depth: Count = 8
    point_octaves: Octaves = 10
    pixel_octaves: Octaves = 10
    steps: Count = 500_000
    batch: Count = 16_384  #: pixels
    learning_rate: Positive = 0.0005
    final_rate: Share = 0.01  #: of the learning rate, at the end of a cosine; 1: constant, as the paper's
    precision: Precision = "float32"  #: of the hidden layers in training


@dataclass(frozen=True, kw_only=True)
class TouchConfig:
    """Kind of the touch net, with settings for both kinds."""

    net: Literal["geometric", "image"] = "geometric"
    offset_span: Positive = 0.0002  #: the depth offset is searched up to this, either way, metres
    rounds: Count = 4  #: bisection steps of the search
    #: maximum number of contacts that ``geometric`` is fitted to, and of validation contacts
    contacts: Count = 64
    image: ImageConfig = ImageConfig()
