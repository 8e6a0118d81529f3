"""What the tests of simulations share: the brick as a rigid body, and small textures."""

import pytest

from objectfolder.sim import visual
from objectfolder.sim.body import rigid_body
from objectfolder.sim.hulls import cached_hulls


@pytest.fixture(scope="session")
def body(brick):
    """The brick with one hull, 10 cm x 6 cm x 3 cm of plastic: 193 g."""
    return rigid_body(brick, [brick.to_mesh().convex_hull])


@pytest.fixture(scope="session")
def hulls(brick, tmp_path_factory):
    """A folder of cached hulls, so that environments need not compute them."""
    folder = tmp_path_factory.mktemp("hulls")
    cached_hulls(brick, folder)
    return folder


@pytest.fixture(scope="module")
def small_textures():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(visual, "TEXELS", 64)
        yield
