import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True, scope="session")
def _single_thread():
    """As in the stages: the same inputs give the same bytes."""
    torch.set_num_threads(1)
    with threadpool_limits(1):
        yield


@pytest.fixture
def rng():
    return np.random.default_rng(20)
