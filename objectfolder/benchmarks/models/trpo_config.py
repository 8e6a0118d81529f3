"""Settings of training with TRPO: section ``grasp_policy`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval, MultipleOf

from objectfolder.settings import Batch, Count, Discount, Positive


@dataclass(frozen=True, kw_only=True)
class GraspPolicyConfig:
    """Section ``grasp_policy`` of ``params.yaml``: TRPO with the constants of supplementary I.4."""

    seeds: Count  #: trainings
    episodes: Count  #: of a training
    environments: Count  #: episodes in parallel
    rollout: Annotated[int, Ge(2), MultipleOf(2)]  #: steps in each environment between updates
    updates: Count  #: between validations; the policy is saved after each
    patience: Count  #: validations without an improvement after which training stops
    batch: Batch  #: of the value function
    learning_rate: Positive  #: of the value function
    discount: Discount  #: gamma
    gae: Annotated[float, Interval(ge=0, le=1)]  #: lambda of generalised advantage estimation
    damping: Positive  #: alpha of the conjugate gradients
    divergence: Positive  #: delta, KL divergence of an update
    width: Count  #: of both hidden layers
    log_deviation: float  #: natural logarithm of the initial standard deviation of actions
    rollouts: Count  #: episodes of the test, and as many others of the validation
    presses: Count  #: poses at which both fingers' features are kept
