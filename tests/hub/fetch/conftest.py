import pytest
from own_workspace import ROOT, workspace  # noqa: F401
from publisher import Publisher

from objectfolder.hub.fetch import download
from objectfolder.hub.fetch.catalogue import read_catalogue


@pytest.fixture(scope="session")
def catalogue():
    return read_catalogue(ROOT / "catalogs/objectfolder1.yaml")


@pytest.fixture
def publisher(monkeypatch):
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    server = Publisher()
    yield server
    server.close()


@pytest.fixture
def no_waits(monkeypatch):
    """The waits between attempts, which are recorded instead."""
    waits = []
    monkeypatch.setattr(download.time, "sleep", waits.append)
    return waits
