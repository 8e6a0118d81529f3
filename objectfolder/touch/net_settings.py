"""Settings of the touch nets: section ``train_touch`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Literal

from objectfolder.base.settings import Count, Octaves, Positive, section
from objectfolder.nets.settings import PapersNetConfig


@dataclass(frozen=True, kw_only=True)
class ImageConfig(PapersNetConfig):
    """Shape and training of a net of kind ``image``."""

    pixel_octaves: Octaves = 10


@section("train_touch")
@dataclass(frozen=True, kw_only=True)
class TouchConfig:
    """Kind of the touch net, with settings for both kinds."""

    net: Literal["geometric", "image"] = "geometric"
    offset_span: Positive = 0.0002  #: the depth offset is searched up to this, either way, metres
    rounds: Count = 4  #: bisection steps of the search
    #: maximum number of contacts that ``geometric`` is fitted to, and of validation contacts
    contacts: Count = 64
    image: ImageConfig = ImageConfig()
