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
    Stopping,
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


def test_a_terminal_that_cannot_redraw_gets_lines():
    """As in an editor's shell; the live display would show nothing until the end."""
    console = Console(file=io.StringIO(), force_terminal=True, width=100, _environ={"TERM": "dumb"})
    with Progress(console) as progress:
        progress(Planned({"modal@mug": 30.0}))
        progress(Started("modal@mug", Path("x.log")))
        assert "started  modal@mug" in console.file.getvalue()
        progress(Finished(RAN))
    assert "\x1b" not in console.file.getvalue()


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
    assert "0:02:00 elapsed, about 0:04:00 left" in console.file.getvalue()


def test_no_time_left_is_told_before_a_tenth_of_the_work_is_done():
    progress = Progress(Console(file=io.StringIO()))
    progress(Planned({"modal@mug": 10.0, "pack@mug": 1.0, "modal@bell": 90.0}))
    progress(Finished(RAN))
    assert progress.seconds_left() is None
    progress(Finished(SKIPPED))  # which is no work
    assert progress.seconds_left() is not None


def shown(progress, width):
    """Lines of the display in a terminal."""
    console = Console(file=io.StringIO(), width=width)
    console.print(progress._render())
    return console.file.getvalue().splitlines()


def test_the_display_fits_eighty_columns(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("objectfolder.engine.progress.time.monotonic", lambda: clock[0])
    progress = Progress(Console(file=io.StringIO()))
    progress(Planned({f"{stage}@o{i}": 1.0 for i in range(2500) for stage in ("modal", "pack")}))
    for i in range(1000):
        progress(Finished(StageResult(f"modal@o{i}", StageOutcome.RAN)))
        progress(Finished(StageResult(f"pack@o{i}", list(StageOutcome)[i % 5])))
    progress(Started("train_vision@" + "k" * 64, Path("x.log")))
    clock[0] = 80_000.0
    running, bar, counts = shown(progress, 80)
    assert running.startswith("  train_vision@kkk")
    assert bar.endswith("2000/5000 22:13:20 elapsed, about 2 days, 7:33:20 left")
    assert counts == "  1200 ran  200 restored  200 skipped  200 failed  200 blocked"


def test_the_display_says_what_happens_before_the_plan_is_known():
    progress = Progress(Console(file=io.StringIO()))
    assert shown(progress, 80) == ["reading the pipeline ...  0:00:00"]
    progress(Planned({"modal@mug": 30.0}))
    assert "0/1" in shown(progress, 80)[0]
    assert shown(Progress(task="verifying"), 80) == ["verifying ...  0:00:00"]


@pytest.mark.parametrize("terminal", [False, True])
def test_an_interruption_says_what_is_kept(terminal):
    console = Console(file=io.StringIO(), force_terminal=terminal, width=100)
    progress = Progress(console)

    def interrupted_build():
        progress(Planned(dict.fromkeys(("modal@mug", "pack@mug", "modal@bell", "pack@bell", "x"), 1.0)))
        for result in (RAN, SKIPPED, FAILED, BLOCKED):
            progress(Finished(result))
        progress(Stopping())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), progress:
        interrupted_build()
    text = console.file.getvalue()
    assert "stopping: running stages are killed, finished ones are kept" in text
    assert "interrupted: 2 of 5 stages are up to date; `objectfolder build` continues" in text
    with pytest.raises(KeyboardInterrupt), Progress(console):
        raise KeyboardInterrupt
    assert "interrupted\n" in console.file.getvalue().removeprefix(text).replace("\x1b[0m", "")


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
