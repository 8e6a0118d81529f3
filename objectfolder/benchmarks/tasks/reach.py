"""Reach past an object: the task of Meta-World's MT1 (supplementary J)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from objectfolder.benchmarks.models.settings import ReachConfig
from objectfolder.benchmarks.reporting.published import REACH
from objectfolder.benchmarks.reporting.tables import Table, format_rate
from objectfolder.benchmarks.tasks.task import Task, Variant

HANDS = {"reach": "floating hand", "metaworld_reach": "Meta-World's Sawyer arm"}
REACH_POLICIES = {
    "ppo": "PPO",
    "controller": "straight to the goal",
    "random": "random actions",
    "nothing": "none",
}


def _table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    """Lay out the scores of `objectfolder.benchmarks.tasks.reach.reach` by object."""
    rows = []
    for key, score in scores.items():
        for policy, name in REACH_POLICIES.items():
            played = score[policy]
            rows.append(
                (
                    key,
                    name,
                    *(format_rate(played[when]) for when in ("last", "any")),
                    f"{1000 * played['distance']:.0f}",
                    f"{played['return'] / score['horizon']:.2f}",
                    _thousands(score["steps"]) if policy == "ppo" else "-",
                )
            )
    first = next(iter(scores.values()))
    return Table(
        f"Reach, {HANDS[first['task']]}: success in %",
        (
            *("object", "policy", "at the last step", "at any time", "mm from the goal at the end"),
            *("reward per step, of 10", "steps of training"),
        ),
        rows,
        f"{first['episodes']} fresh goals per training, {first['horizon']} control steps each; in brackets "
        f"the 95 % interval (Wilson) of these policies; other trainings may differ.",
    )


def _thousands(steps: Sequence[int]) -> str:
    return "/".join(f"{count / 1000:.0f}k" for count in steps)


def _require_metaworld(*given: Any) -> None:
    import objectfolder.sim.metaworld  # noqa: F401 (it says what to install)


TASK = Task(
    name="reach",
    help="""Move a gripper to a goal past an object: the reach task of Meta-World, with PPO.

Prints success rates at the last step and at any time, on goals not used in training, next to a controller,
random actions and no action. Training curves, policies and animations are written to OUT.

`objectfolder bench reach --preset quick build/mug build/bell`""",
    settings=ReachConfig,
    training="objectfolder.benchmarks.tasks.reach_training:reach",
    # Scores on the validation goals.
    columns=("seed", "steps", "val_last", "val_any", "val_return", "val_distance"),
    table=_table,
    published=(REACH,),
    page="Reach",
    robot=True,
    trains_nets=False,
    single_threaded=True,
)
METAWORLD_REACH = replace(TASK, name="metaworld_reach", check=_require_metaworld)
TASK = replace(
    TASK,
    variant=Variant(
        "metaworld",
        (False, True),
        METAWORLD_REACH,
        "Use the Sawyer arm of Meta-World, which must be installed.",
    ),
)
