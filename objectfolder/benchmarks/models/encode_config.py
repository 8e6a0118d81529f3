"""Section ``encode`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge

from objectfolder.settings import Precision


@dataclass(frozen=True)
class InputSizes:
    """Sizes of encoder inputs, pixels."""

    image: int  #: side of the crop of a view
    spectrogram: tuple[int, int]  #: frequencies, times
    touch: tuple[int, int]  #: height, width

    def of(self, modality: str) -> tuple[int, int]:
        """Return height and width of the inputs of a modality."""
        return {"vision": (self.image, self.image), "audio": self.spectrogram, "touch": self.touch}[modality]


@dataclass(frozen=True, kw_only=True)
class EncodeConfig:
    """Section ``encode`` of ``params.yaml``."""

    encoder: str = "resnet18"  #: registered name, or FILE.py:NAME
    image: Annotated[int, Ge(8)] = 56  #: side of the crop of a view, pixels
    spectrogram: tuple[int, int] = (64, 50)  #: bins and frames; the paper's: 257, 201
    touch: tuple[int, int] = (64, 48)  #: height and width, pixels; the paper's: 160, 120
    subtract: bool = False  #: the median touch from touches, before recognition and retrieval (`Ground`)
    shift: Annotated[int, Ge(0)] = 0  #: pixels by which these touches are moved at most in training
    flip: bool = False  #: half of the views in training, left to right, before recognition and retrieval
    precision: Precision = "float32"  #: of training on a CPU; `objectfolder.benchmarks.models.training.train`

    @property
    def sizes(self) -> InputSizes:
        """Sizes of encoder inputs."""
        return InputSizes(self.image, self.spectrogram, self.touch)
