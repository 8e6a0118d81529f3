"""Settings of the audio nets: section ``train_audio`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, MinLen

from objectfolder.settings import Count, Octaves, Positive, Precision, Share


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
class SpectrogramConfig:
    """Shape and training of a net of kind ``spectrogram``."""

    width: Count
    depth: Count
    point_octaves: Octaves
    bin_octaves: Octaves
    steps: Count
    batch: Count  #: spectrogram bins, each for all three force axes
    learning_rate: Positive
    final_rate: Share  #: of the learning rate, at the end of a cosine; 1: constant, as the paper's
    loud: Share  #: of a batch drawn by loudness, weighted to the same mean; the paper's is 0
    precision: Precision  #: of the hidden layers in training


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
