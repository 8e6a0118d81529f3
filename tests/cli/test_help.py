"""Help of all commands, and completion in a shell."""

import re

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from objectfolder.base.materials import material_names
from objectfolder.cli import PANELS, app
from objectfolder.cli.files import bounded


def paths(command, path=()):
    yield path
    for name, below in getattr(command, "commands", {}).items():
        yield from paths(below, (*path, name))


def said(*words, width=100):
    result = CliRunner().invoke(app, words, env={"COLUMNS": str(width), "TERMINAL_WIDTH": str(width)})
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("path", [*paths(get_command(app))], ids=" ".join)
def test_help_shows_forms_and_no_types(path):
    text = said(*path, "-h")
    assert not re.search(r"<[a-z]|\[x|x>=|<=x", text), text


def test_help_shows_what_is_typed():
    audio = said("query", "audio", "-h")
    assert re.search(r"--listener +X Y Z +Listener position", audio)
    assert re.search(r"--duration +SECONDS ", audio)
    assert re.search(r"--forces +FORCES\.npy ", audio)
    assert re.search(r"--jobs +-j +N +Number of cores to use, at least 1", said("build", "-h"))


def test_commands_stand_in_panels_by_purpose():
    titles = re.findall(r"^╭─ (\w+)", said("-h"), re.MULTILINE)
    assert titles == ["Options", *PANELS]


def test_help_of_add_lists_the_materials():
    text = " ".join(said("add", "-h", width=200).split())
    assert ", ".join(material_names()) in text


@pytest.mark.parametrize("text", ["0", "11", "2.5", "few", "nan"])
def test_a_number_out_of_bounds_is_refused_in_words(text):
    with pytest.raises(typer.BadParameter, match=f"'{text}', expected a whole number from 1 to 10"):
        bounded(1, 10)["parser"](text)


def test_numbers_within_bounds_are_read():
    assert [bounded(1, 10)["parser"](text) for text in ("1", "10")] == [1, 10]
    assert bounded(0, kind=float)["parser"]("0.5") == 0.5


def test_a_shell_completes_commands():
    shell = {"_OBJECTFOLDER_COMPLETE": "complete_bash", "COMP_WORDS": "objectfolder lis", "COMP_CWORD": "1"}
    result = CliRunner().invoke(app, env=shell, prog_name="objectfolder")
    assert result.output.split() == ["listening"]
