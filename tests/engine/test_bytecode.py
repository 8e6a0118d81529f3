"""A stage runs the code that is recorded, not an older one that Python has compiled."""

import os

import pytest

from objectfolder.engine.build import build

from . import tiny_project
from .tiny_project import Sources


@pytest.mark.parametrize("name", ["generate", pytest.param("shape", marks=pytest.mark.slow)])
def test_an_edit_of_the_same_size_within_a_second_is_seen(tmp_path, monkeypatch, name):
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)  # of the stages
    root = tmp_path / "workspace"
    tiny_project.make(root)
    assert build(root=root).ok
    sources = Sources().with_one("versions", name, "2")
    for path, text in sources.files().items():
        if text != Sources().files()[path]:
            info = (root / path).stat()
            assert len(text) == info.st_size
            (root / path).write_text(text)
            os.utime(root / path, ns=(info.st_atime_ns, info.st_mtime_ns // 10**9 * 10**9))
    assert build(root=root).ok
    for files in tiny_project.outputs(sources).values():
        assert {path: (root / path).read_text() for path in files} == files
