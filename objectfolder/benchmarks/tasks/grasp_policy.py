"""Grasping by touch: a policy that moves the hand before it closes (supplementary I.4)."""

from collections.abc import Mapping
from typing import Any

from objectfolder.benchmarks.models.settings import GraspPolicyConfig
from objectfolder.benchmarks.reporting.published import GRASPING
from objectfolder.benchmarks.reporting.tables import Table, format_rate
from objectfolder.benchmarks.tasks.task import Task

#: Rows of grasping, in their order.
GRASP_POLICIES = {
    "touch": "touch",
    "touch_exact": "touch, exact",
    "tactile": "tactile images alone",
    "width": "width alone",
    "blind": "blind",
    "random": "random actions",
    "nothing": "none",
}


def _table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    """Lay out the scores of `objectfolder.benchmarks.tasks.grasp_policy.grasp_policy` by object."""
    rows = []
    for key, score in scores.items():
        for policy, name in GRASP_POLICIES.items():
            seeds = " ".join(f"{100 * value:.1f}" for value in score[policy]["seeds"])
            rows.append((key, name, format_rate(score[policy]), seeds))
    first = next(iter(scores.values()))
    return Table(
        "Grasping by touch: success in %",
        ("object", "policy", "success", "each seed"),
        rows,
        f"{first['rollouts']} fresh rollouts per seed, at most {first['episodes']} episodes of training; in "
        "brackets the 95 % interval (Wilson) over all rollouts of these policies; how much trainings differ, "
        "the seeds show. While policies learn, and in row touch, features are those of the nearest of "
        f"{first['presses']} presses; exact: the Object File is asked.",
    )


TASK = Task(
    name="grasp_policy",
    help="""Learn to grasp an object by touch: TRPO in ObjectFolder/Grasp-v0.

Prints success rates in new episodes of policies that observe touch, only the jaw opening, or neither, next to
random actions and no action. Training curves, a policy and an animation are written to OUT.

`objectfolder bench grasp-policy --preset quick build/tonic_bottle`""",
    settings=GraspPolicyConfig,
    training="objectfolder.benchmarks.tasks.grasp_policy_training:grasp_policy",
    columns=("policy", "seed", "episodes", "train_success", "val_success"),
    table=_table,
    published=(GRASPING,),
    page="Grasping",
    robot=True,
    trains_nets=False,
    former=("grasping",),
)
