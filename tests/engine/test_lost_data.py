"""A tracked mesh that is gone comes back as it was recorded, or is said to be lost: never less of it."""

import shutil

import pytest

from objectfolder.engine.build import build
from objectfolder.engine.status import Outlook, State, status

MESH = "data/objects/bell.dvc"


@pytest.fixture
def root(template, tmp_path):
    shutil.copytree(template, tmp_path / "workspace", symlinks=True)
    return tmp_path / "workspace"


def said(root):
    return next((found.state, found.outlook) for found in status(root=root) if found.address == MESH)


def cached_mesh(root):
    text = (root / "data/objects/bell/mesh.obj").read_text()
    (path,) = (p for p in (root / ".dvc/cache/files/md5").rglob("*") if p.is_file() and p.read_text() == text)
    return path


def spoil(path):
    path.chmod(0o644)
    path.write_text("other")


@pytest.mark.parametrize("folder", ["gone", "empty"])
def test_a_mesh_that_is_gone_comes_back(root, folder):
    mesh = root / "data/objects/bell/mesh.obj"
    text, recorded = mesh.read_text(), (root / MESH).read_text()
    shutil.rmtree(mesh.parent)
    if folder == "empty":  # so a killed restore leaves it
        mesh.parent.mkdir()
    assert said(root) == (State.MISSING, Outlook.RESTORE)
    assert build(root=root).ok
    assert mesh.read_text() == text
    assert (root / MESH).read_text() == recorded
    assert said(root) == (State.FRESH, Outlook.SKIP)


@pytest.mark.parametrize("harm", [spoil, lambda path: path.unlink()], ids=["damaged", "missing"])
@pytest.mark.parametrize("folder", ["gone", "empty"])
def test_a_mesh_that_is_lost_is_an_error_and_stays_recorded(root, harm, folder):
    mesh, recorded = root / "data/objects/bell/mesh.obj", (root / MESH).read_text()
    cached = cached_mesh(root)
    content = cached.read_bytes()
    harm(cached)
    shutil.rmtree(mesh.parent)
    if folder == "empty":
        mesh.parent.mkdir()
    for _ in range(2):
        summary = build(root=root)
        errors = {failure.address: failure.error for failure in summary.failures}
        assert "is missing, and its copy in DVC's cache is missing or damaged, too" in errors[MESH]
        assert (root / MESH).read_text() == recorded
        assert said(root)[0] is State.MISSING
    cached.write_bytes(content)  # from a backup
    assert build(root=root).ok
    assert mesh.read_bytes() == content
