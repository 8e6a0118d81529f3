"""What is made once in a run of several processes."""

import fcntl
import os
from contextlib import contextmanager


def shared_folder(tmp_path_factory):
    """Folder that all processes of a parallel run have in common."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@contextmanager
def once(tmp_path_factory, name):
    """Path in the common folder, and whether it has still to be made; others wait meanwhile."""
    path = shared_folder(tmp_path_factory) / name
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield path, not path.exists()
