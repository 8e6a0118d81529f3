"""Functions that Ray runs on a cluster node, with the Python and environment of that node.

This module must not import DVC, which nodes need not have.
"""

import os
import socket
from dataclasses import replace
from pathlib import Path

from objectfolder.engine.process import Children, Command, CommandResult, stage_environment

#: Prefixes of the variables that a command gets from the engine's environment. All others come from the node,
#: because paths, GPUs and temporary folders differ between machines.
FORWARDED_PREFIXES = ("DVC_", "OBJECTFOLDER_")


class NotShared(Exception):
    """The workspace of the build is not visible on this node."""


def check_workspace(marker: Path) -> None:
    """Check that this node sees the workspace of the build, not another folder at the same path.

    ``marker``: file with a unique name that the engine has created in the workspace. Raises NotShared if the
    marker does not exist.
    """
    if not marker.exists():
        raise NotShared(
            f"node {socket.gethostname()} does not see {marker}; the workspace must be on a file system that "
            "all nodes mount at the same path"
        )


def run(command: Command, threads: int, marker: Path) -> CommandResult:
    """Run the command of one stage with the Python of this Ray node, on the GPUs that Ray assigned.

    ``command``: command of the stage; of its environment only DVC's and this project's variables are used;
    ``threads``: threads that numerical libraries may start; ``marker``: see `check_workspace`.
    """
    import ray

    check_workspace(marker)
    gpus = ",".join(str(gpu) for gpu in ray.get_gpu_ids())
    passed_on = {name: value for name, value in command.env.items() if name.startswith(FORWARDED_PREFIXES)}
    env = {**stage_environment({**os.environ, **passed_on}, threads), "CUDA_VISIBLE_DEVICES": gpus or "-1"}
    return Children().run(replace(command, env=env))
