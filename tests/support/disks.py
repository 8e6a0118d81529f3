"""Disks of their own, where a test may mount them."""

import errno
import os
import subprocess
from contextlib import contextmanager

import pytest


@contextmanager
def mounted(*arguments):
    """Mount something; its place comes last."""
    done = subprocess.run(["mount", *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"cannot mount here: {done.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", arguments[-1]], check=True)


def no_space(*names):
    """The error of a full disk."""
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), *names)


def small_disk(path, size="1m"):
    path.mkdir(parents=True, exist_ok=True)
    return mounted("-t", "tmpfs", "-o", f"size={size}", "tmpfs", path)
