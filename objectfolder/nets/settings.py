"""Settings of the nets, sections ``train_vision``, ``train_audio``, ``train_touch``; imports no torch."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, MinLen

from objectfolder.settings import Count, Octaves, Positive, Precision, Share


@dataclass(frozen=True, kw_only=True)
class PapersNetConfig:
    """Shape and training that the nets of the paper share."""

    width: Count
    depth: Count
    point_octaves: Octaves
    steps: Count
    batch: Count  #: rays of ``osf``, pixels of ``image``, bins of ``spectrogram``, each for all three axes
    learning_rate: Positive
    final_rate: Share  #: of the learning rate, at the end of a cosine; 1: constant, as the paper's
    precision: Precision  #: of the hidden layers in training


@dataclass(frozen=True, kw_only=True)
class SurfaceConfig:
    """Shape and training of a net of kind ``surface``."""

    levels: Count
    features: Count
    table_bits: Annotated[int, Interval(ge=4, le=24)]
    coarsest: Count
    finest: Count
    width: Count  #: hidden width of the MLPs
    points: Count  #: surface points for training base colour and normals
    point_steps: Count
    point_batch: Count
    pixels: Count  #: pixels for training indirect light, over all training views
    steps: Count
    batch: Count
    learning_rate: Positive


@dataclass(frozen=True, kw_only=True)
class OsfConfig(PapersNetConfig):
    """Shape and training of a net of kind ``osf``; width and depth are those of the density network."""

    branch_width: Count  #: of the scattering network
    branch_depth: Count
    direction_octaves: Octaves
    coarse_samples: Count  #: per ray, stratified
    fine_samples: Count  #: per ray, drawn from the weights of the coarse samples
    hull_cells: Annotated[int, Interval(ge=0, le=256)]
    """Along each axis of the cube. Nothing is computed in cells that the views to learn from show to be
    empty; 0: everything is computed, as in the paper."""


@dataclass(frozen=True, kw_only=True)
class VisionConfig(SurfaceConfig):
    """Kind of the vision net, with settings for both kinds."""

    net: Literal["surface", "osf"]
    osf: OsfConfig


@dataclass(frozen=True, kw_only=True)
class GainsConfig:
    """Shape and training of a net of kind ``gains``, for objects with up to ``modes`` modes."""

    modes: Count
    resolution: Annotated[int, Interval(ge=1, le=128)]  #: cells of the grid along each axis
    channels: Count  #: features of a grid node
    width: Count  #: of the first sine layer
    #: Width of the second sine layer, at least. The output is linear in it, so it bounds the rank.
    features: Count
    most_features: Count  #: for mode shapes that have little in common, such as those of many boards
    frequency: Positive  #: factor inside the sines
    steps: Count
    learning_rate: Positive
    grid_rate: Positive  #: learning rate of the grid, relative to ``learning_rate``


@dataclass(frozen=True, kw_only=True)
class SpectrogramConfig(PapersNetConfig):
    """Shape and training of a net of kind ``spectrogram``."""

    bin_octaves: Octaves
    loud: Share  #: of a batch drawn by loudness, weighted to the same mean; the paper's is 0


@dataclass(frozen=True, kw_only=True)
class AudioConfig:
    """Kind of the audio net, with settings for both kinds."""

    net: Literal["gains", "spectrogram"]
    sizes: Annotated[tuple[GainsConfig, ...], MinLen(1)]  #: ascending; the first large enough is used
    batch: Count  #: surface points, for ``gains``
    spectrogram: SpectrogramConfig

    def size(self, modes: int) -> GainsConfig:
        """Return the first size that is large enough for a number of modes, else the last."""
        return next((size for size in self.sizes if modes <= size.modes), self.sizes[-1])


@dataclass(frozen=True, kw_only=True)
class ImageConfig(PapersNetConfig):
    """Shape and training of a net of kind ``image``."""

    pixel_octaves: Octaves


@dataclass(frozen=True, kw_only=True)
class TouchConfig:
    """Kind of the touch net, with settings for both kinds."""

    net: Literal["geometric", "image"]
    offset_span: Positive  #: the depth offset is searched up to this, either way, metres
    rounds: Count  #: bisection steps of the search
    contacts: Count  #: maximum number of contacts that ``geometric`` is fitted to, and of validation contacts
    image: ImageConfig
