"""What reaches a terminal."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hostile import CONTROLS, LINES, WORDS
from rich.live import Live
from rich.table import Table
from rich.text import Text

import objectfolder
from objectfolder.base.terminal import Terminal
from objectfolder.base.text import visible
from objectfolder.cli.console import print_line, print_wide
from objectfolder.engine.progress import Progress, print_summary
from objectfolder.engine.summary import Finished, Planned, StageOutcome, StageResult, Started, Summary
from objectfolder.hub.fetch.report import download_progress, print_result
from objectfolder.hub.fetch.run import FetchResult, FetchStatus

ALL = " ".join(WORDS)
# Rich's own: colours, the cursor of a live display, and what clears its lines.
OWN = re.compile(r"\x1b\[[0-9;]*m|\x1b\[\?25[hl]|\x1b\[[0-9]*[AK]|\r")


def table(text):
    grid = Table(text, title=text, caption=text)
    grid.add_row(text)
    grid.add_row(Text(text))
    return grid


def live(console):
    with Live(table(ALL), console=console):
        console.print(ALL)


def build(console):
    failed = StageResult(ALL, StageOutcome.FAILED, error=ALL, tail=(ALL,), log=Path(ALL))
    with Progress(console, ALL) as progress:
        for event in (Planned({ALL: 1.0}), Started(ALL, Path(ALL)), Finished(failed)):
            progress(event)
    ran = StageResult(ALL, StageOutcome.RAN)
    print_summary(Summary({"a": failed, "b": ran}, 1.0), console)


def download(console):
    with download_progress(console) as progress:
        progress(ALL)(1, 2)
    print_result(FetchResult("a", FetchStatus.FAILED, ALL), console)


SHOWS = (
    lambda console: console.print(ALL),
    lambda console: console.print(Text(ALL), soft_wrap=True),
    lambda console: console.print(table(ALL)),
    lambda console: print_wide(table(ALL), console),
)


@pytest.mark.parametrize("show", [*SHOWS, live, build, download])
@pytest.mark.parametrize("terminal", [False, True])
def test_nothing_printed_is_obeyed(show, terminal):
    console = Terminal(file=io.StringIO(), force_terminal=terminal, width=2000, color_system="truecolor")
    show(console)
    shown = OWN.sub("", console.file.getvalue())
    assert re.sub(r"[\n\t]", "", shown).isprintable()
    assert r"a\x1b]0;b\x1b[2Jc" in shown  # rich itself drops the bell
    assert r"a\u202eb" in shown
    assert "[red]a[/red] [link=http://a.b]b[/link]" in shown
    assert shown.encode()


@pytest.mark.parametrize("text", [*LINES, *CONTROLS])
def test_a_line_is_one_line(capsys, text):
    print_line(text)
    assert capsys.readouterr().out == f"{visible(text)}\n"


def run(*command, ok=True):
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict", "TERM": "dumb"}
    done = subprocess.run([sys.executable, *command], capture_output=True, env=environment)
    assert (done.returncode == 0) == ok, done.stderr
    shown = (done.stdout + done.stderr).decode()
    assert re.sub(r"[\n\t]", "", shown).isprintable(), shown
    return shown


MAIN = ("-c", "from objectfolder.cli import main; main()")
EVIL = "a\x1b]0;b\x07\x1b[2J\u202e\udce9\nerror: [red]c[/red]"
SHOWN = r"a\x1b]0;b\x07\x1b[2J\u202e\udce9"


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", EVIL),
        ("info", "mug", EVIL),
        ("info", f"--{EVIL}"),
        (EVIL,),
        ("view", "mug", "--out", f"{EVIL}.txt"),
        ("import", EVIL, "out.safetensors"),
        ("query", "touch", "mug", EVIL, "out"),
        ("listening", "score", EVIL),
        ("report", EVIL),
        ("view", "mug", "--out", f"/proc/{EVIL}/a.html"),
    ],
)
def test_names_of_files_and_options_in_errors(arguments):
    shown = run(*MAIN, *arguments, ok=False)
    assert "Traceback" not in shown
    assert not re.search(r"^error: \[red", shown, re.M)  # a second message
    assert SHOWN[:12] in shown


def test_a_file_of_such_a_name_is_reported(tmp_path):
    path = tmp_path / f"{EVIL.replace('/', '')}.safetensors"
    path.write_text("no Object File")
    shown = run(*MAIN, "report", str(path), "--no-open", "--single-file", "--out", f"{path}.html", ok=False)
    assert shown.count(SHOWN) >= 2
    assert "1 object, 1 failed" in shown


UNCAUGHT = """
import logging, sys, threading, warnings
from objectfolder.base.terminal import guard_streams
evil = sys.argv[1]
guard_streams()
warnings.warn("warned " + evil)
logging.getLogger("a").warning("logged %s", evil)
thread = threading.Thread(target=lambda: {}[evil])
thread.start()
thread.join()
raise RuntimeError("raised " + evil)
"""


def test_logs_warnings_and_tracebacks():
    shown = run("-c", UNCAUGHT, EVIL, ok=False)
    for name in ("warned", "logged", "raised"):
        assert f"{name} {SHOWN}" in shown
    assert "KeyError" in shown
    assert shown.count("Traceback") == 2


PLAIN = """
import sys
from rich.progress import track
from rich.table import Table
from objectfolder.base.terminal import Terminal, guard_streams
guard_streams()
table = Table("cm³", title="Tasse à café")
table.add_row("2 · 3 − 1 °")
for stderr in (False, True):
    Terminal(stderr=stderr).print(table)
    list(track([1, 2], "café", console=Terminal(stderr=stderr)))
print("cm³ ✓ 杯", file=sys.stderr)
"""


@pytest.mark.parametrize("encoding", ["ascii", "cp437", "latin-1"])
def test_a_terminal_that_is_not_utf_8_gets_plain_characters(monkeypatch, encoding):
    monkeypatch.setenv("PYTHONIOENCODING", encoding)
    process = subprocess.run([sys.executable, "-c", PLAIN], capture_output=True, check=True)
    for text in (process.stdout.decode(encoding), process.stderr.decode(encoding)):
        assert ("cm³" if encoding == "latin-1" else "cm3") in text
        assert ("Tasse a cafe" if encoding == "ascii" else "Tasse à café") in text
    assert process.stderr.decode(encoding).splitlines()[-1] == f"cm{'³' if encoding == 'latin-1' else 3} + ?"


def test_no_module_prints_around_it():
    """Consoles of rich show control characters, and markup, of whoever wrote them."""
    around = re.compile(r"\bConsole\(|rich\.markup|from_markup|rich import print")
    for folder in (Path(objectfolder.__file__).parent, Path(__file__).parents[1] / "stages"):
        found = [path.name for path in folder.rglob("*.py") if around.search(path.read_text())]
        assert found in ([], ["terminal.py"])
