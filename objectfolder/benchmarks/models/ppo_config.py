"""Settings of training with PPO: section ``reach`` of ``params.yaml``."""

from dataclasses import dataclass

from objectfolder.settings import Batch, Count, Discount, Positive


@dataclass(frozen=True, kw_only=True)
class ReachConfig:
    """Section ``reach`` of ``params.yaml``; names as in Schulman et al. 2017."""

    seeds: Count  #: trainings
    steps: Count  #: greatest number of control steps of a training
    horizon: Count  #: control steps (12.5 ms) of an episode
    goals: Count  #: of the test, and as many others of the validation
    environments: Count  #: in parallel
    rollout: Count  #: control steps in each environment between updates
    batch: Batch
    epochs: Count  #: over each rollout
    learning_rate: Positive  #: at the start; falls linearly to 0 at ``steps``
    discount: Discount  #: gamma, per control step
    width: Count  #: of both hidden layers
    log_deviation: float  #: natural logarithm of the initial standard deviation of actions
