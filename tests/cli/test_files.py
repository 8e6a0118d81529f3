"""Wherever a command takes an Object File, it takes a sample's name; a path that is not there is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
from brick import SCALE, SIDES
from refusals import refused
from typer.main import get_command

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.run import load_object_files
from objectfolder.cli import app, main
from objectfolder.cli.files import file_or_folder, object_file
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.samples import sample_path
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
        yield words, ["FILE" if param.metavar in SHOWN else f"new{i}" for i, param in enumerate(arguments)]


COMMANDS = list(commands(get_command(app)))


def test_all_commands_are_found():
    names = {" ".join(words) for words, _ in COMMANDS}
    assert names == {
        *("info", "view", "video", "report", "simulate", "sample audio", "sample touch"),
        *(f"query {name}" for name in ("vision", "audio", "touch")),
        *(f"export {name}" for name in ("mjcf", "urdf", "glb", "usd", "nerfstudio", "lerobot")),
        *(f"bench {name.replace('_', '-')}" for name in BENCHMARKS),
    }


@pytest.mark.parametrize(("words", "arguments"), COMMANDS, ids=[" ".join(words) for words, _ in COMMANDS])
def test_every_command_names_the_samples_if_a_file_is_not_there(tmp_path, monkeypatch, words, arguments):
    monkeypatch.chdir(tmp_path)
    given = [argument.replace("FILE", "nosuch.safetensors") for argument in arguments]
    message = r"^nosuch\.safetensors does not exist; expected an Object File, or a sample: bell, die, mug$"
    refused(message, app, [*words, *given], standalone_mode=False)
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_a_samples_name_comes_first_and_a_folder_where_folders_are_taken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert object_file(Path("mug")) == file_or_folder(Path("mug")) == sample_path("mug")
    Path("mug").mkdir()
    assert file_or_folder(Path("mug")) == Path("mug")
    assert object_file(Path("mug")) == sample_path("mug")
    Path("die").write_bytes(b"a file of that name")
    assert object_file(Path("die")) == file_or_folder(Path("die")) == Path("die")
    refused(
        r"^die is neither an Object File nor another readable .*: header",
        app,
        ["info", "die"],
        standalone_mode=False,
    )
    refused(r"^\. is a folder, expected an Object File such as", object_file, Path())


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
        (2.22, {}, "uncertain: the lowest ten may be 222% wrong"),
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
    assert list(load_object_files([file_or_folder(Path(name)) for name in ("mug", "bell")])) == [
        "mug",
        "bell",
    ]


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
        app(["export", kind, str(tmp_path / "afile"), "mug"], standalone_mode=False)
