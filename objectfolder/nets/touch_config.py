"""Settings of the touch nets: section ``train_touch`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Literal

from objectfolder.settings import Count, Octaves, Positive


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


@dataclass(frozen=True, kw_only=True)
class TouchConfig:
    """Kind of the touch net, and the settings of both kinds."""

    net: Literal["geometric", "image"]
    offset_span: Positive  #: search range of the depth offset, metres
    rounds: Count  #: of bisection
    contacts: Count  #: greatest number of training and of validation contacts
    image: ImageConfig
