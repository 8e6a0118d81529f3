"""Settings of the nets, sections ``train_vision``, ``train_audio``, ``train_touch``; imports no torch."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, MinLen

from objectfolder.settings import Count, Octaves, Positive, Precision, Share


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


@dataclass(frozen=True, kw_only=True)
class SurfaceConfig:
    """Shape and training of a net of kind ``surface``."""

    levels: Count = 8
    features: Count = 2
    table_bits: Annotated[int, Interval(ge=4, le=24)] = 15
    coarsest: Count = 16
    finest: Count = 320
    width: Count = 64  #: hidden width of the MLPs
    points: Count = 200_000  #: surface points for training base colour and normals
    point_steps: Count = 250
    point_batch: Count = 16_384
    pixels: Count = 400_000  #: pixels for training indirect light, over all training views
    steps: Count = 600
    batch: Count = 4096
    learning_rate: Positive = 0.01


@dataclass(frozen=True, kw_only=True)
class OsfConfig(PapersNetConfig):
    """Shape and training of a net of kind ``osf``; width and depth are those of the density network."""

    branch_width: Count = 128  #: of the scattering network
    branch_depth: Count = 4
    direction_octaves: Octaves = 4
    coarse_samples: Count = 64  #: per ray, stratified
    fine_samples: Count = 128  #: per ray, drawn from the weights of the coarse samples
    hull_cells: Annotated[int, Interval(ge=0, le=256)] = 64
    """Along each axis of the cube. Nothing is computed in cells that the views to learn from show to be
    empty; 0: everything is computed, as in the paper."""
    batch: Count = 1024  #: rays


@dataclass(frozen=True, kw_only=True)
class VisionConfig(SurfaceConfig):
    """Kind of the vision net, with settings for both kinds."""

    net: Literal["surface", "osf"] = "surface"
    osf: OsfConfig = OsfConfig()


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


@dataclass(frozen=True, kw_only=True)
class ImageConfig(PapersNetConfig):
    """Shape and training of a net of kind ``image``."""

    pixel_octaves: Octaves = 10


@dataclass(frozen=True, kw_only=True)
class TouchConfig:
    """Kind of the touch net, with settings for both kinds."""

    net: Literal["geometric", "image"] = "geometric"
    offset_span: Positive = 0.0002  #: the depth offset is searched up to this, either way, metres
    rounds: Count = 4  #: bisection steps of the search
    #: maximum number of contacts that ``geometric`` is fitted to, and of validation contacts
    contacts: Count = 64
    image: ImageConfig = ImageConfig()
