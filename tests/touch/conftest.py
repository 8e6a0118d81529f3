from dataclasses import replace

import pytest
import torch
import trimesh
from touch_solids import caster

from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import load_profile


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def digit():
    return load_profile("digit")


@pytest.fixture(scope="session")
def flat(digit):
    """A DIGIT with a flat, rigid gel."""
    return replace(digit, gel_curvature=0.0, gel="rigid")


@pytest.fixture(scope="session")
def optics(digit):
    return Optics(digit)


@pytest.fixture(scope="session")
def ball():
    """A ball of radius 10 mm around the origin, in metres."""
    return caster(trimesh.creation.icosphere(5, radius=0.01))
