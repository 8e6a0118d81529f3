import os
import shutil
import signal
from pathlib import Path

import forkserver
import numpy as np
import psutil
import pytest
import torch
from brick import build_brick, with_spectrograms
from hypothesis import settings
from publisher import no_waits, publisher  # noqa: F401
from sharing import shared_folder
from threadpoolctl import threadpool_limits

from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.report.inspect_scene import draw_scene

# The same examples everywhere; `make fuzz` tries others. Tests that set a number of examples keep to it.
settings.register_profile("same", derandomize=True, database=None, deadline=None)
settings.register_profile("fuzz", max_examples=2000)
settings.load_profile("same")

MEMORY, ROOM = Path("/dev/shm"), 4 << 30  # of Linux; more than all temporary files of a run
if MEMORY.is_dir() and min(shutil.disk_usage(MEMORY).free, psutil.virtual_memory().available - ROOM) > ROOM:
    # Tests write thousands of small files, for which some disks take longer than the tests.
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    # So starts what a script runs in the background; processes that tests interrupt would inherit it.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items):
    """Start with the longest file: a parallel run that ended with it would wait for one process.

    Then the one that mostly waits for its cluster.
    """
    first = ("test_pipeline.py", "test_ray.py")
    items.sort(key=lambda item: first.index(item.path.name) if item.path.name in first else len(first))


@pytest.fixture(scope="session", autouse=True)
def _site_cache(tmp_path_factory):
    """DVC keeps a folder for every workspace, outside of it: here those of tests end with them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DVC_SITE_CACHE_DIR", str(tmp_path_factory.mktemp("dvc")))
        yield


@pytest.fixture(autouse=True, scope="session")
def _single_thread():
    """As in the stages: the same inputs give the same bytes."""
    torch.set_num_threads(1)
    with threadpool_limits(1):
        yield


@pytest.fixture
def rng():
    return np.random.default_rng(20)


@pytest.fixture(scope="session")
def brick_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("brick") / "ObjectFile.safetensors"
    build_brick().save(path)
    return path


@pytest.fixture(scope="session")
def brick(brick_path):
    return ObjectFile.load(brick_path)


@pytest.fixture(scope="session")
def spectrograms(brick):
    return with_spectrograms(brick)


@pytest.fixture(scope="session")
def opengl():
    """Pictures of meshes need OpenGL, which a bare machine may lack; nothing else does."""
    try:
        draw_scene(lambda plotter: None)
    except ObjectFolderError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def fork_server(tmp_path_factory):
    """Runs Python commands in forks that have imported the libraries."""
    with forkserver.fork_server(shared_folder(tmp_path_factory) / "forks", hash_seed=0) as server:
        yield server


@pytest.fixture(scope="session")
def other_fork_server(tmp_path_factory):
    """As `fork_server`, with another hash seed and other addresses in memory."""
    with forkserver.fork_server(shared_folder(tmp_path_factory) / "other_forks", hash_seed=1) as server:
        yield server
