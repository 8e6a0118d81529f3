import io
from pathlib import Path

import pytest
from rich.console import Console

from objectfolder.engine.progress import Progress, print_summary
from objectfolder.engine.summary import (
    Disturbed,
    Finished,
    Planned,
    StageOutcome,
    StageResult,
    Started,
    Summary,
)

RAN = StageResult("modal@mug", StageOutcome.RAN, 12.34, 654.0, Path("/w/build/.logs/modal@mug.log"))
FAILED = StageResult(
    "modal@bell",
    StageOutcome.FAILED,
    1.0,
    9.0,
    Path("/w/bell.log"),
    "the command exited with code 3",
    ("[a]", "no mesh"),
)
BLOCKED = StageResult("pack@bell", StageOutcome.BLOCKED, error="needs modal@bell")
SKIPPED = StageResult("pack@mug", StageOutcome.SKIPPED)


@pytest.mark.parametrize("terminal", [False, True])
def test_every_event_is_shown_but_skips(terminal):
    console = Console(file=io.StringIO(), force_terminal=terminal, width=100)
    with Progress(console) as progress:
        progress(Planned({"modal@mug": 30.0, "pack@mug": 1.0, "modal@bell": 30.0, "pack@bell": 1.0}))
        progress(Started("modal@mug", Path("x.log")))
        progress(Disturbed("modal@mug", ["a.ply", "b.ply"]))
        progress(Started("modal@mug", Path("x.log")))
        for result in (RAN, SKIPPED, FAILED, BLOCKED):
            progress(Finished(result))
    text = console.file.getvalue()
    assert "again    modal@mug a.ply, b.ply changed while it ran; nothing was saved" in text
    assert "ran      modal@mug [1/4] 12.3 s 654 MB" in text
    assert "failed   modal@bell [3/4] the command exited with code 3" in text
    assert "blocked  pack@bell [4/4] needs modal@bell" in text
    assert "pack@mug" not in text
    assert (progress.done, progress.running) == (4, {})


def test_time_left_is_what_the_rest_takes_at_the_pace_so_far(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("objectfolder.engine.progress.time.monotonic", lambda: clock[0])
    console = Console(file=io.StringIO(), width=200)
    progress = Progress(console)
    progress(Planned({"modal@mug": 30.0, "pack@mug": 1.0, "modal@bell": 50.0, "pack@bell": 10.0}))
    clock[0] = 220.0
    progress(Finished(SKIPPED))
    assert progress.seconds_left() is None
    progress(Finished(RAN))
    assert progress.seconds_left() == 120 * 60 / 30
    assert "2 min 00 s elapsed, about 4 min 00 s left" in console.file.getvalue()


def test_summary_names_what_ran_and_what_failed():
    console = Console(file=io.StringIO(), width=100)
    results = {result.address: result for result in (RAN, SKIPPED, FAILED, BLOCKED)}
    print_summary(Summary(results, 20.0), console)
    text = console.file.getvalue()
    assert "modal  mug     ran    12.3      654" in " ".join(text.split("\n"))
    assert "modal of bell failed: the command exited with code 3" in text
    assert "| [a]\n  | no mesh\n  log: /w/bell.log" in text
    assert "1 ran, 1 skipped, 1 failed, 1 blocked in 20.0 s" in text


def test_summary_of_many_objects_adds_up_by_stage():
    console = Console(file=io.StringIO(), width=100)
    results = {
        f"modal@o{number}": StageResult(f"modal@o{number}", StageOutcome.RAN, float(number), 100.0 + number)
        for number in range(1, 101)
    }
    print_summary(Summary(results, 20.0), console)
    lines = console.file.getvalue().splitlines()
    assert "modal ran 100 5050.0 50.5 100.0 200" in [" ".join(line.split()) for line in lines]
    assert len(lines) < 5
