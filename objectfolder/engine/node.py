"""What runs on a node of a cluster: the command of one stage, with that node's Python and environment.

Imports no DVC, which only the engine needs.
"""

import os
import socket
from dataclasses import replace
from pathlib import Path

from objectfolder.engine.process import Children, Command, CommandResult, stage_environment

#: Variables of the engine's environment that a command gets; all others are the node's own. Paths, GPUs and
#: temporary folders of the machine where the engine runs mean nothing here.
PASSED_ON = "DVC_"


class NotShared(Exception):
    """This node does not see the workspace of the build."""


def check_workspace(marker: Path) -> None:
    """Make sure that this node sees the very workspace of the build, not a folder of the same name.

    Parameters
    ----------
    marker : Path
        A file that the engine has just made in the workspace, of a name never used before.

    Raises
    ------
    NotShared
        If it is not there.
    """
    if not marker.exists():
        raise NotShared(
            f"node {socket.gethostname()} does not see {marker}; the workspace must be on a file system that "
            "all nodes mount at the same path"
        )


def run(command: Command, threads: int, marker: Path) -> CommandResult:
    """Run the command of one stage with the Python that started Ray here, on the GPUs that Ray gives it.

    Parameters
    ----------
    command : Command
        What to run; of its environment only what DVC sets is used.
    threads : int
        Threads that numerical libraries may start.
    marker : Path
        See `check_workspace`.
    """
    import ray

    check_workspace(marker)
    gpus = ",".join(str(gpu) for gpu in ray.get_gpu_ids())
    passed_on = {name: value for name, value in command.env.items() if name.startswith(PASSED_ON)}
    env = {
        **stage_environment({**os.environ, **passed_on}, threads),
        "CUDA_VISIBLE_DEVICES": gpus or "-1",
    }
    return Children().run(replace(command, env=env))
