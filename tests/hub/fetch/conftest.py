import pytest
from own_workspace import ROOT, workspace  # noqa: F401

from objectfolder.hub.fetch.catalogue import read_catalogue


@pytest.fixture(scope="session")
def catalogue():
    return read_catalogue(ROOT / "catalogs/objectfolder1.yaml")
