"""Settings of the audio nets: section ``train_audio`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, MinLen

from objectfolder.base.settings import Count, Octaves, Positive, Share, section
from objectfolder.nets.settings import PapersNetConfig


@dataclass(frozen=True, kw_only=True)
class GainsConfig:
    """Shape and training of a net of kind ``gains``, for objects with up to ``modes`` modes."""

    modes: Count = 75
    resolution: Annotated[int, Interval(ge=1, le=128)] = 16  #: cells of the grid along each axis
    channels: Count = 10  #: features of a grid node
    width: Count = 64  #: of the first sine layer
    #: Width of the second sine layer, at least. The output is linear in it, so it bounds the rank.
    features: Count = 320
    most_features: Count = 320  #: for mode shapes that have little in common, such as those of many boards
    frequency: Positive = 10.0  #: factor inside the sines
    steps: Count = 3400
    learning_rate: Positive = 0.007
    grid_rate: Positive = 3.0  #: learning rate of the grid, relative to ``learning_rate``


@dataclass(frozen=True, kw_only=True)
class SpectrogramConfig(PapersNetConfig):
    """Shape and training of a net of kind ``spectrogram``."""

    bin_octaves: Octaves = 10
    loud: Share = 0.5  #: of a batch drawn by loudness, weighted to the same mean; the paper's is 0
    #: paper: values scaled to [0, 1], from which it learns silence; turned: in units of the root mean square,
    #: over the phases of each bin's loudest mode
    target: Literal["turned", "paper"] = "turned"


@section("train_audio")
@dataclass(frozen=True, kw_only=True)
class AudioConfig:
    """Kind of the audio net, with settings for both kinds."""

    net: Literal["gains", "spectrogram"] = "gains"
    #: Ascending; the first that is large enough is used
    sizes: Annotated[tuple[GainsConfig, ...], MinLen(1)] = (
        GainsConfig(),
        GainsConfig(modes=1000, channels=12, width=96, features=384, most_features=512, steps=3200),
    )
    batch: Count = 512  #: surface points, for ``gains``
    spectrogram: SpectrogramConfig = SpectrogramConfig()

    def size(self, modes: int) -> GainsConfig:
        """Return the first size that is large enough for a number of modes, else the last."""
        return next((size for size in self.sizes if modes <= size.modes), self.sizes[-1])
