"""Help of all commands, the grammar of their arguments and options, and their progress without a terminal."""

import io
import re

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from objectfolder.base.materials import material_names
from objectfolder.base.terminal import Terminal
from objectfolder.cli import FORMER, PANELS, app, console, doctor
from objectfolder.engine.summary import NO_OBJECTS, StageOutcome, StageResult, Summary


def _walk(command, *path):
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from _walk(inner, *path, name)


COMMANDS = dict(_walk(get_command(app)))


def run(*words, **env):
    done = CliRunner().invoke(app, words, prog_name="objectfolder", env={"TERMINAL_WIDTH": "200"} | env)
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_help_shows_what_is_typed_instead_of_types(path):
    text = run(*path, "-h")
    for kind in ("<", "range [", "list[", "[x", "}...", "]...]", "{F", "{O"):
        assert kind not in text.replace("train-{000000..000003}", "")
    assert {"-h", "--help"} <= {*text.split()}


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_eighty_columns_break_no_word_to_be_typed(path, monkeypatch):
    """What options take is shown whole, as are their names."""
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", 80)
    text = run(*path, "-h")
    assert max(map(len, text.splitlines())) <= 80
    for one in COMMANDS[path].params:
        words = [*one.opts, *(one.metavar or "").split()] if one.param_type_name == "option" else []
        assert [word for word in words if word not in text] == []


def test_a_place_has_its_numbers_and_a_count_is_n():
    text = run("simulate", "--help")
    assert "SCENE.xml [FILE...]" in text
    for form in (r"--listener +X Y Z  ", r"--resolution +WIDTH HEIGHT  ", r"--fps +N  "):
        assert re.search(form, text)


def test_commands_are_in_panels():
    text = run("--help")
    places = [text.index(f"─ {panel} ─") for panel in PANELS]
    assert places == sorted(places)
    assert text.index("─ Query ─") < text.index("│ sample ") < text.index("─ Publish ─")


def test_out_is_the_last_argument_and_options_have_one_name():
    for path, command in COMMANDS.items():
        arguments = [one.name for one in command.params if one.param_type_name == "argument"]
        assert "out" not in arguments[:-1], path
        assert not {f"--{name}" for name in FORMER} & {name for one in command.params for name in one.opts}


def test_materials_and_costs_are_in_help():
    text = run("add", "--help")
    assert all(name in text for name in material_names())
    assert "faithful: months of CPU time per object" in " ".join(
        run("preset", "--help").replace("│", "").split()
    )


def test_a_shell_completes_commands():
    asked = {"COMP_WORDS": "objectfolder que", "COMP_CWORD": "1"}
    assert run(_OBJECTFOLDER_COMPLETE="complete_bash", **asked).split() == ["query"]


def test_without_a_terminal_long_work_says_how_far_it_is_each_minute(monkeypatch, capsys):
    now = iter((0, 30, 61, 61, 70, 100))
    monkeypatch.setattr(console.time, "monotonic", lambda: next(now))
    assert list(console.track_progress("abcd", "examining", 4)) == [*"abcd"]
    assert capsys.readouterr().err.splitlines() == ["examining: 2 of 4"]


def test_a_status_is_shown_each_minute(monkeypatch, capsys):
    monkeypatch.setattr(console, "MINUTE", 0)
    with console.show_status("begun") as show:
        show("1 of 3 views")
    assert capsys.readouterr() == ("", "1 of 3 views\n")


def test_doctor_cuts_nothing_in_eighty_columns(monkeypatch):
    terminal = Terminal(file=io.StringIO(), width=80, force_terminal=True)
    monkeypatch.setattr(doctor, "console", terminal)
    long = "x" * 70
    monkeypatch.setattr(doctor, "examine", lambda: [doctor.Part("LLVM 19", "", False, long, long)])
    doctor.doctor()
    text = terminal.file.getvalue()
    assert "…" not in text
    assert text.count("x") == 140


def test_a_build_without_objects_says_how_to_add_one(monkeypatch):
    done = {"hash_code": StageResult("hash_code", StageOutcome.SKIPPED)}
    monkeypatch.setattr("objectfolder.engine.unchanged.recall", lambda *given, **options: Summary(done, 0.1))
    assert NO_OBJECTS in run("build")
    monkeypatch.setattr(
        "objectfolder.engine.unchanged.recall",
        lambda *given, **options: Summary(
            done | {"pack@mug": StageResult("pack@mug", StageOutcome.SKIPPED)}, 0.1
        ),
    )
    assert NO_OBJECTS not in run("build")
