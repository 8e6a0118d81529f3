"""Settings of training with PPO: section ``reach`` of ``params.yaml``."""

from dataclasses import dataclass

from objectfolder.settings import Batch, Count, Discount, Positive


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
