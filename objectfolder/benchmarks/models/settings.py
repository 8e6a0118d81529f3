"""Settings of models and their training, sections of ``params.yaml``; imports no torch."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Interval, MultipleOf

from objectfolder.base.settings import Batch, Count, Discount, NonNegative, Positive, Precision, section


@dataclass(frozen=True)
class InputSizes:
    """Sizes of encoder inputs, pixels."""

    image: int  #: side of the crop of a view
    spectrogram: tuple[int, int]  #: frequencies, times
    touch: tuple[int, int]  #: height, width

    def of(self, modality: str) -> tuple[int, int]:
        """Return height and width of the inputs of a modality."""
        return {"vision": (self.image, self.image), "audio": self.spectrogram, "touch": self.touch}[modality]


@section("encode")
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


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings that the sections of all trained tasks share."""

    epochs: Count  #: at most
    batch: Annotated[int, Ge(2)] = 32
    learning_rate: Positive = 0.001
    weight_decay: NonNegative = 0.01
    patience: Count  #: epochs without a better validation score after which training stops
    seeds: Count = 1  #: runs whose mean is the result


@dataclass(frozen=True, kw_only=True)
class TouchFrameConfig(TrainingConfig):
    """Settings of tasks that ask what is touched, not where or how."""

    #: Touches as the sensor's images, or as the shape of its gel, as at one depth and upright.
    touch_frame: Literal["sensor", "own"] = "sensor"


@section("reach")
@dataclass(frozen=True, kw_only=True)
class ReachConfig:
    """Section ``reach`` of ``params.yaml``; names as in Schulman et al. 2017."""

    seeds: Count = 1  #: trainings
    steps: Count = 800_000  #: greatest number of control steps of a training
    horizon: Count = 100  #: control steps (12.5 ms) of an episode
    goals: Count = 100  #: of the test, and as many others of the validation
    environments: Count = 8  #: in parallel
    rollout: Count = 512  #: control steps in each environment between updates
    batch: Batch = 512
    epochs: Count = 10  #: over each rollout
    learning_rate: Positive = 0.0005  #: at the start; falls linearly to 0 at ``steps``
    discount: Discount = 0.97  #: gamma, per control step
    width: Count = 64  #: of both hidden layers
    log_deviation: float = 0.0  #: natural logarithm of the initial standard deviation of actions


@section("grasp_policy")
@dataclass(frozen=True, kw_only=True)
class GraspPolicyConfig:
    """Section ``grasp_policy`` of ``params.yaml``: TRPO with the constants of supplementary I.4."""

    seeds: Count = 3  #: trainings
    episodes: Count = 30_000  #: of a training
    environments: Count = 50  #: episodes in parallel
    rollout: Annotated[int, Ge(2), MultipleOf(2)] = 40  #: steps in each environment between updates
    updates: Count = 2  #: between validations; the policy is saved after each
    patience: Count = 5  #: validations without an improvement after which training stops
    batch: Batch = 250  #: of the value function
    learning_rate: Positive = 0.001  #: of the value function
    discount: Discount = 0.95  #: gamma
    gae: Annotated[float, Interval(ge=0, le=1)] = 0.97  #: lambda of generalised advantage estimation
    damping: Positive = 0.01  #: alpha of the conjugate gradients
    divergence: Positive = 0.01  #: delta, KL divergence of an update
    width: Count = 256  #: of both hidden layers
    log_deviation: float = -0.7  #: natural logarithm of the initial standard deviation of actions
    rollouts: Count = 200  #: episodes of the test, and as many others of the validation
    presses: Count = 2500  #: poses at which both fingers' features are kept
