"""Commands test where they write before the work whose result goes there."""

import shutil
from pathlib import Path

import pytest
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace import params

COMMANDS = {
    "video": "video mug --out BAD/a.mp4",
    "simulate": "simulate none.xml --out BAD/a.mp4",
    "view": "view mug --out BAD/a.html --no-open",
    "report": "report mug --out BAD/site --no-open",
    "page of a report": "report mug --single-file --out BAD/a.html --no-open",
    "listening": "listening make none none --out BAD/a.html",
    "reconstruct": "reconstruct none.png BAD/a.obj --model none.safetensors",
    "import": "import none.pth BAD/a.safetensors",
    "sensor fit": "sensor fit none.png --radius 0.004 --out BAD/a.yaml",
    "sensor export": "sensor export none --taxim BAD/a",
    "sample audio": "sample audio mug BAD/a.npy",
    "sample touch": "sample touch mug a.npy --gelinfo BAD/a.npy",
    "query vision": "query vision mug none.npy BAD/out",
    "query audio": "query audio mug none.npy BAD/out",
    "query touch": "query touch mug none.npy BAD/out",
    "export mjcf": "export mjcf mug BAD/out",
    "export webdataset": "export webdataset none BAD/out",
    "release": "release BAD/out",
}


def worked(*arguments, **options):
    raise AssertionError("it has begun to work")


@pytest.mark.parametrize("name", COMMANDS)
def test_a_place_that_cannot_be_written_is_refused_first(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ObjectFile, "load", worked)
    monkeypatch.setattr(params, "read", worked)
    monkeypatch.setattr(shutil, "which", lambda program: f"/bin/{program}")
    Path("bad").write_text("")
    refused(r"cannot write .*bad", app, COMMANDS[name].replace("BAD", "bad").split(), standalone_mode=False)
    assert [path.name for path in Path().iterdir()] == ["bad"]


@pytest.mark.parametrize("words", ["query audio mug none.npy out", "export mjcf mug out", "release out"])
def test_a_link_to_nothing_is_no_folder(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("out").symlink_to("nowhere")
    with pytest.raises(ObjectFolderError, match="out is a file, expected a folder; choose another name"):
        app(words.split(), standalone_mode=False)
    assert [path.name for path in Path().iterdir()] == ["out"]
