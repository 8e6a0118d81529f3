"""Settings of training with TRPO: section ``grasp_policy`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval, MultipleOf

from objectfolder.settings import Batch, Count, Discount, Positive


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
