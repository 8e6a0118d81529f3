import pytest
from own_workspace import ROOT, workspace  # noqa: F401
from publisher import publisher  # noqa: F401

from objectfolder.hub.fetch import download
from objectfolder.hub.fetch.catalogue import read_catalogue


@pytest.fixture(scope="session")
def catalogue():
    return read_catalogue(ROOT / "catalogs/objectfolder1.yaml")


@pytest.fixture
def no_waits(monkeypatch):
    """The waits between attempts, which are recorded instead."""
    waits = []
    monkeypatch.setattr(download.time, "sleep", waits.append)
    return waits
