"""Whatever names Object Files does so for every command; what is not there is refused."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from brick import SCALE, SIDES
from index_rows import MUG
from refusals import refused
from typer.main import get_command

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.run import load_object_files
from objectfolder.cli import app, main
from objectfolder.cli.files import object_file, object_files
from objectfolder.hub.release.entries import index_text
from objectfolder.objectfile.dataset import IndexEntry
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.samples import sample_path
from objectfolder.workspace.layout import Build
from objectfolder.workspace.lookup import FORMS
from objectfolder.workspace.stages import BENCHMARKS

#: How commands show arguments that are Object Files.
SHOWN = ("FILE", "FILE...", "[FILE]...", "[FILE...]")


def commands(command, *words):
    """Commands with an Object File among their arguments: their words, and those that stand for arguments."""
    for name, inner in getattr(command, "commands", {}).items():
        if not inner.hidden:  # a former name
            yield from commands(inner, *words, name)
    arguments = [param for param in command.params if param.param_type_name == "argument"]
    if any(param.metavar in SHOWN for param in arguments):
        assert f" a {FORMS}" in next(param.help for param in arguments if param.metavar in SHOWN), words
        yield words, ["FILE" if param.metavar in SHOWN else f"new{i}" for i, param in enumerate(arguments)]


COMMANDS = list(commands(get_command(app)))


def test_all_commands_are_found():
    names = {" ".join(words) for words, _ in COMMANDS}
    assert names == {
        *("info", "view", "video", "report", "simulate", "sample audio", "sample touch"),
        *(f"query {name}" for name in ("vision", "audio", "touch")),
        *(f"export {name}" for name in ("mjcf", "urdf", "glb", "usd", "splats", "nerfstudio", "lerobot")),
        *(f"bench {name.replace('_', '-')}" for name in BENCHMARKS),
    }


@pytest.mark.parametrize(("words", "arguments"), COMMANDS, ids=[" ".join(words) for words, _ in COMMANDS])
def test_every_command_says_what_it_looked_for_if_a_file_is_not_there(
    tmp_path, monkeypatch, words, arguments
):
    monkeypatch.chdir(tmp_path)
    given = [argument.replace("FILE", "nosuch.safetensors") for argument in arguments]
    message = f"^{re.escape(f'nosuch.safetensors does not exist; expected a {FORMS}')}$"
    refused(message, app, [*words, *given], standalone_mode=False)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def built(brick, tmp_path, monkeypatch):
    """A folder with builds of bricks whose keys are lid and mug, and a release of them."""
    monkeypatch.chdir(tmp_path)
    Path("out/objects").mkdir(parents=True)
    rows = []
    for key in ("lid", "mug"):
        Build(key).dir.mkdir(parents=True)
        ObjectFile(brick.header | {"key": key}, brick.tensors).save(Build(key).object_file)
        rows.append(MUG | {"key": key, "path": f"objects/{key}.safetensors", "material": brick.material})
        shutil.copy(Build(key).object_file, Path("out", rows[-1]["path"]))
    Path("out/objects.csv").write_text(index_text([IndexEntry(**row) for row in rows]))


def test_a_name_is_a_path_then_a_key_then_a_sample(built, capsys):
    builds = [Build("lid").object_file, Build("mug").object_file]
    released = [Path("out/objects/lid.safetensors"), Path("out/objects/mug.safetensors")]
    found = object_files([Path(name) for name in ("out", "lid", "build", "bell")])
    assert found == [*released, builds[0], *builds, sample_path("bell")]
    assert capsys.readouterr().err == ""
    Path("mug").mkdir()  # without Object Files
    assert object_file(Path("mug")) == builds[1]
    said = "note: mug is build/mug/ObjectFile.safetensors, not the sample of that name\n"
    assert capsys.readouterr().err == said
    shutil.copy(builds[0], "mug")
    assert object_file(Path("mug")) == Path("mug/ObjectFile.safetensors")
    Path("lid").write_bytes(b"a file of that name")
    assert object_file(Path("lid")) == Path("lid")
    refused(r"^build has 2 Object Files, expected one, such as build/lid/", object_file, Path("build"))
    refused(r"^no Object Files in out/objects: no ObjectFile\.safe", object_file, Path("out/objects"))
    refused(r"^cup does not exist; .*; `objectfolder build` builds objects$", object_file, Path("cup"))


def test_commands_take_keys_and_releases(built, capsys):
    app(["info", "lid"], standalone_mode=False)
    assert "lid (" in capsys.readouterr().out
    app(["view", "out", "--out", "page.html", "--no-open"], standalone_mode=False)
    assert all(f'data-object="{key}"' in Path("page.html").read_text() for key in ("lid", "mug"))
    assert list(load_object_files([Path("out")])) == list(load_object_files(None)) == ["lid", "mug"]
    refused("both contain lid; give each object once", load_object_files, [Path("out"), Path("lid")])


def test_the_frequency_above_which_modes_are_not_stored_is_shown(brick, tmp_path, capsys):
    audio = brick.header["audio"] | {"truncated": True, "band_hz": [0.0, 8408.4]}
    ObjectFile(brick.header | {"audio": audio}, brick.tensors).save(tmp_path / "cut.safetensors")
    app(["info", str(tmp_path / "cut.safetensors")], standalone_mode=False)
    assert "Hz, truncated above 8408 Hz" in re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    app(["info", "mug"], standalone_mode=False)
    assert "truncated" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "mark", "said"),
    [
        (3e-4, {}, "lowest ten within 0.1%"),
        (0.017, {}, "lowest ten within about 1.7%"),
        (2.22, {}, "Hz, the lowest ten may be 222% wrong"),
        (0.48, {"uncertain": True}, "may be 48% wrong; the sound is marked uncertain"),
    ],
)
def test_how_far_frequencies_may_be_off_is_shown(brick, tmp_path, capsys, error, mark, said):
    header = brick.header | {"audio": brick.header["audio"] | {"frequency_uncertainty": error} | mark}
    ObjectFile(header, brick.tensors).save(tmp_path / "brick.safetensors")
    app(["info", str(tmp_path / "brick.safetensors")], standalone_mode=False)
    shown = re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    assert said in shown
    assert ("marked" in shown) == bool(mark)
    mass = np.prod(SIDES) * SCALE**3 * header["material_properties"]["density"]
    assert float(re.search(r"mass (\S+) kg", shown)[1]) == pytest.approx(mass, rel=0.01)


def test_the_real_mass_is_shown_beside_that_of_the_solid(brick, tmp_path, capsys):
    ObjectFile(brick.header | {"mass": 0.118}, brick.tensors).save(tmp_path / "brick.safetensors")
    app(["info", str(tmp_path / "brick.safetensors")], standalone_mode=False)
    shown = re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    assert "mass 0.118 kg (given; solid volume x density would be 0.193 kg)" in shown


def test_a_sample_is_shown_sampled_queried_and_seen(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    app(["info", "mug"], standalone_mode=False)
    assert re.search(r"mug \(\d+ kB\)", capsys.readouterr().out)
    app(["sample", "audio", "mug", "s.npy", "-n", "1"], standalone_mode=False)
    app(["query", "audio", "mug", "s.npy", "out", "--duration", "0.1"], standalone_mode=False)
    assert [path.name for path in Path("out").iterdir()] == ["1.wav"]
    np.save("v.npy", [[2.0, 1, 1, 0.5, 0.5, 1]])
    app(["query", "vision", "die", "v.npy", "seen", "--resolution", "8"], standalone_mode=False)
    assert [path.name for path in Path("seen").iterdir()] == ["1.png"]
    app(["view", "mug", "die", "--out", "both.html", "--no-open"], standalone_mode=False)
    assert Path("both.html").is_file()
    assert list(load_object_files([Path("mug"), Path("bell")])) == ["mug", "bell"]


@pytest.mark.parametrize(
    "words", [("view", "mug", "--no-open"), ("report", "mug", "--no-open", "--single-file")]
)
def test_a_page_does_not_replace_an_object_file(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    Path("bell.safetensors").write_bytes(b"an object")
    with pytest.raises(ObjectFolderError, match=r"expected the name of a page, such as bell\.html"):
        app([*words, "--out", "bell.safetensors"], standalone_mode=False)
    assert Path("bell.safetensors").read_bytes() == b"an object"


def test_a_report_does_not_replace_another_site(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("site").mkdir()
    Path("site/index.html").write_text("precious")
    with pytest.raises(ObjectFolderError, match=r"site holds an index\.html that is not of a report"):
        app(["report", "mug", "--no-open"], standalone_mode=False)
    assert Path("site/index.html").read_text() == "precious"


@pytest.mark.parametrize("name", ["rep.html", "rep.HTM"])
def test_a_site_has_no_name_of_a_page(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    message = f"--out {name}: expected a folder; for one page, add --single-file"
    with pytest.raises(ObjectFolderError, match=re.escape(message)):
        app(["report", "mug", "bell", "--out", name, "--no-open"], standalone_mode=False)
    assert list(tmp_path.iterdir()) == []


def test_names_between_colons_are_printed_as_they_are(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["objectfolder", "info", ":bell:.safetensors"])
    with pytest.raises(SystemExit):
        main()
    assert ":bell:.safetensors does not exist" in capsys.readouterr().err


def test_the_name_of_a_sample_is_no_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(r"mug does not exist; ObjectFile\.sample\('mug'\) is", ObjectFile.load, "mug")


@pytest.mark.parametrize("kind", ["mjcf", "glb", "nerfstudio", "lerobot", "webdataset", "datasets"])
def test_an_export_into_a_file_is_refused_before_any_work(tmp_path, kind):
    (tmp_path / "afile").touch()
    with pytest.raises(ObjectFolderError, match="afile is a file, expected a folder; choose another name"):
        app(["export", kind, "mug", str(tmp_path / "afile")], standalone_mode=False)
