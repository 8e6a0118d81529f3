"""Make a folder a Git and DVC repository."""

import shutil
import subprocess
from pathlib import Path

from dvc.exceptions import DvcException
from dvc.repo import Repo

from objectfolder.engine.dvc.repository import quiet
from objectfolder.errors import ObjectFolderError

#: As in this project's own repository: DVC calls nobody, and adds nothing to Git's index by itself.
CORE = {"analytics": False, "check_update": False, "autostage": False}


def start_repository(root: Path) -> None:
    """Initialise Git, unless the folder is a repository already, and DVC.

    Raises
    ------
    ObjectFolderError
        If Git is not installed, or one of them refuses.
    """
    if shutil.which("git") is None:
        raise ObjectFolderError(
            "git is not installed, which a workspace needs; install it (Debian: apt-get install git)"
        )
    if not (root / ".git").exists():
        command = ["git", "init", "--quiet", "--initial-branch", "main", str(root)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise ObjectFolderError(f"git cannot make a repository in {root}: {done.stderr.strip()}")
    try:
        with quiet(), Repo.init(str(root)) as repo, repo.config.edit("repo") as config:
            config["core"].update(CORE)
    except DvcException as error:
        raise ObjectFolderError(f"DVC cannot make a repository in {root}: {error}") from error
