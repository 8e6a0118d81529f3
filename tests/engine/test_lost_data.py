"""A tracked mesh that is gone comes back as it was recorded, or is said to be lost: never less of it."""

import shutil

import pytest
import yaml

from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.status import Outlook, State, status

MESH = "data/objects/bell.dvc"


@pytest.fixture
def root(template, tmp_path):
    shutil.copytree(template, tmp_path / "workspace", symlinks=True)
    return tmp_path / "workspace"


def said(root):
    return next((found.state, found.outlook) for found in status(root=root) if found.address == MESH)


def cached_listing(root):
    digest = yaml.safe_load((root / MESH).read_text())["outs"][0]["md5"]
    return root / ".dvc/cache/files/md5" / digest[:2] / digest[2:]


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
@pytest.mark.parametrize("copy_of", [cached_listing, cached_mesh])
@pytest.mark.parametrize("folder", ["gone", "empty"])
def test_a_mesh_that_is_lost_is_an_error_and_stays_recorded(root, harm, copy_of, folder):
    mesh, recorded = root / "data/objects/bell/mesh.obj", (root / MESH).read_text()
    copy = copy_of(root)
    text, content = mesh.read_bytes(), copy.read_bytes()
    harm(copy)
    shutil.rmtree(mesh.parent)
    if folder == "empty":
        mesh.parent.mkdir()
    for _ in range(2):
        summary = build(root=root)
        errors = {failure.address: failure.error for failure in summary.failures}
        assert "is missing, and its copy in DVC's cache is missing or damaged, too" in errors[MESH]
        assert (root / MESH).read_text() == recorded
        assert said(root)[0] is State.MISSING
    copy.write_bytes(content)  # from a backup
    assert build(root=root).ok
    assert mesh.read_bytes() == text


@pytest.mark.parametrize("copy_of", [cached_listing, cached_mesh])
@pytest.mark.parametrize("force", [False, True])
def test_a_damaged_copy_of_a_mesh_is_replaced(root, copy_of, force):
    copy = copy_of(root)
    content = copy.read_bytes()
    spoil(copy)
    assert said(root)[0] is State.MISSING
    assert build(options=BuildOptions(force=force), root=root).ok
    assert copy.read_bytes() == content
    assert {found.state for found in status(root=root)} == {State.FRESH}
