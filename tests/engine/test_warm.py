"""Stages that start as forks: what they do, print and report is what a new Python does."""

import json
import logging
import os
import signal
import threading
from queue import SimpleQueue

import psutil
import pytest

from objectfolder.engine.process import Children, Command, NotStarted, describe_result, stage_environment
from objectfolder.engine.resources import Machine, Needs
from objectfolder.engine.warm import Starter, is_stage
from objectfolder.engine.workers import LocalWorkers, WorkerLost

from .processes import alive, meanwhile, start, wait_for

#: Says everything that a program can see of how it was started.
LOOK = """
import fcntl, json, os, resource, signal, sys, threading, warnings
from objectfolder import shape

def disposition(number):
    return getattr(signal.getsignal(number), "__name__", repr(signal.getsignal(number)))

main = sys.modules["__main__"]
streams = (sys.stdin, sys.stdout, sys.stderr)
print(json.dumps({
    "arguments": [sys.argv, sys.orig_argv, sys.flags, sys.warnoptions],
    "python": [sys.executable, sys.prefix, sys.path],
    "main": [vars(main) is globals(), __name__, __file__, __spec__.name, __package__],
    "names": sorted({*vars(main)} - {"__annotations__"}),
    "streams": [[s.fileno(), s.encoding, s.errors, s.line_buffering, s.write_through] for s in streams],
    "files": sorted(n for n in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{n}")),
    "signals": {n: disposition(n) for n in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}},
    "blocked": sorted(signal.pthread_sigmask(signal.SIG_BLOCK, [])),
    "filters": [str(entry) for entry in warnings.filters],
    "process": [os.getcwd(), os.getsid(0) == os.getpgrp() != os.getpid(), os.nice(0), os.umask(0)],
    "limits": [resource.getrlimit(n) for n in range(10)],
    "threads": [threading.current_thread() is threading.main_thread(), len(os.listdir("/proc/self/task"))],
    "project": sorted(name for name in sys.modules if name.partition(".")[0] in ("objectfolder", "stages")),
    "environment": {name: value for name, value in os.environ.items() if name != "_"},
    "hash": hash("the same in every process"),
}, default=str))
"""
#: Ends in many ways, as its argument says.
END = """
import atexit, os, signal, sys, threading, time
import tools
from objectfolder import shape

atexit.register(print, "at exit", flush=True)
print("on stdout", shape.SIZE, end="")
print(tools.WORD, file=sys.stderr)

def late():
    time.sleep(0.2)
    print("a thread is waited for")

def broken():
    try:
        1 / 0
    except ZeroDivisionError as error:
        raise ValueError("the second") from error

how = sys.argv[1]
if how == "thread":
    threading.Thread(target=late).start()
elif how in ("text", "code", "none"):
    sys.exit({"text": "a reason", "code": 3, "none": None}[how])
elif how == "error":
    broken()
elif how == "hard":
    os._exit(7)
elif how == "wait":
    os.system("sleep 60 & echo $! > child; echo %d > stage; wait" % os.getpid())
elif how == "memory":
    block = b"1" * 100_000_000
elif how != "plain":
    os.kill(os.getpid(), getattr(signal, how))
    time.sleep(60)
"""
THREAD = "import threading, time; threading.Thread(target=time.sleep, args=(600,), daemon=True).start()"


@pytest.fixture
def root(tmp_path):
    """A project with two stages."""
    files = {
        "stages/look.py": LOOK,
        "stages/end.py": END,
        "stages/threads.py": "import restless\nprint('done')\n",
        "stages/broken.py": "print('before'\n",
        "lib/restless.py": THREAD,
        "tools.py": "WORD = 'old'\n",
        "stages/__init__.py": "",
        "objectfolder/__init__.py": "",
        "objectfolder/shape.py": "import json\nSIZE = 1\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def command(root, *words, timeout=None, **env):
    env = {**os.environ, "PYTHONPATH": str(root / "lib"), **env}
    env = stage_environment({**env, "PYTHONHASHSEED": "3", "PYTHONWARNINGS": "once"})
    return Command([" ".join(["python -m", *words])], root, env, root / "log", timeout)


@pytest.fixture
def starter(root):
    starter = Starter(command(root).env)
    yield starter
    starter.close()


def text_of(run):
    return run.log.read_text()


def test_a_fork_sees_what_a_new_python_sees(root, starter):
    run = command(root, "stages.look", "mug", OF_THE_STAGE="1")
    seen = []
    for begin in ({}, {"start": starter.start}):
        assert Children().run(run, **begin).code == 0, text_of(run)
        first, _, rest = text_of(run).partition("\n")
        assert first == "$ python -m stages.look mug"
        seen.append(json.loads(rest))
    cold, warm = seen
    assert set(cold.pop("filters")) <= set(warm.pop("filters"))  # libraries add some
    assert warm.keys() == cold.keys()
    different = {name for name in warm if warm[name] != cold[name]}
    assert {name: (cold[name], warm[name]) for name in different} == {}
    assert warm["environment"]["OF_THE_STAGE"] == "1"


@pytest.mark.parametrize(
    "how", ["plain", "thread", "text", "code", "none", "error", "hard", "SIGSEGV", "SIGTERM", "SIGINT"]
)
def test_a_fork_ends_as_a_new_python_does(root, starter, how):
    run = command(root, "stages.end", how)
    cold = describe_result(Children().run(run)), text_of(run)
    warm = describe_result(Children().run(run, starter.start)), text_of(run)
    assert warm[0] == cold[0]
    said = signal.strsignal(getattr(signal, how)) + "\n" if how.startswith("SIG") else ""  # by the shell
    assert warm[1] == cold[1].removesuffix(said)
    assert "on stdout 1" in warm[1]


@pytest.mark.parametrize("module", ["stages.broken", "stages.absent"])
def test_a_stage_that_cannot_be_imported_says_why(root, starter, module):
    run = command(root, module)
    assert Children().run(run).code == 1
    cold = text_of(run)
    assert Children().run(run, starter.start).code == 1
    # Python's own words name the program.
    assert text_of(run).splitlines()[-1].endswith(cold.splitlines()[-1].rpartition(": ")[2])


def test_an_edit_between_two_forks_is_seen(root, starter):
    run = command(root, "stages.end", "plain")
    Children().run(run, starter.start)
    assert text_of(run).splitlines()[1:] == ["on stdout 1old", "at exit"]
    (root / "tools.py").write_text("WORD = 'newer'\n")  # of another length: Python compares seconds and sizes
    (root / "objectfolder/shape.py").write_text("SIZE = 22\n")
    (root / "stages/end.py").write_text(END + "print('edited')\n")
    Children().run(run, starter.start)
    assert text_of(run).splitlines()[1:] == ["on stdout 22newer", "edited", "at exit"]


def test_memory_of_a_fork_is_its_own(root, starter):
    small = Children().run(command(root, "stages.end", "plain"), starter.start)
    large = Children().run(command(root, "stages.end", "memory"), starter.start)
    assert 5 < small.peak_mb < 60
    assert 90 < large.peak_mb - small.peak_mb < 110


def numbers(root):
    wait_for(lambda: (root / "stage").exists() and (root / "stage").read_text().strip())
    return [int((root / name).read_text()) for name in ("stage", "child")]


def check_dead(pids):
    wait_for(lambda: not any(alive(pid) for pid in pids), seconds=5)


def test_timeout_ends_a_fork_and_what_it_started(root, starter):
    run = command(root, "stages.end", "wait", timeout=2)
    result = Children().run(run, starter.start)
    assert result.timed_out
    assert 2 <= result.seconds < 4
    check_dead(numbers(root))
    assert Children().run(command(root, "stages.end", "plain"), starter.start).code == 0


def test_kill_ends_forks_and_what_they_started(root, starter):
    children, results = Children(), []
    run = command(root, "stages.end", "wait")
    thread = threading.Thread(target=lambda: results.append(children.run(run, starter.start)))
    thread.start()
    pids = numbers(root)
    children.kill()
    thread.join(5)
    assert results[0].code == -signal.SIGKILL
    check_dead(pids)
    assert children.run(run, starter.start).code == -signal.SIGKILL


@pytest.mark.parametrize("whom", ["stage", "supervisor"])
def test_a_killed_fork_is_reported_as_any_other(root, starter, whom):
    def kill():
        stage, _ = numbers(root)
        os.kill(stage if whom == "stage" else os.getsid(stage), signal.SIGKILL)

    with meanwhile(kill):
        result = Children().run(command(root, "stages.end", "wait"), starter.start)
    assert describe_result(result) == describe_result(type(result)(137, 0, 0))
    check_dead(numbers(root))


@pytest.fixture
def workers():
    workers = LocalWorkers(Machine(1, memory_mb=1000, gpus=["0"]), SimpleQueue())
    yield workers
    workers.kill()
    workers.close()


def outcome(workers, run, **needs):
    workers.submit("it", run, Needs(**needs))
    address, outcome = workers.finished.get(timeout=60)
    workers.finish(address)
    return outcome


def test_the_starter_dies_and_stages_run_without_it(root, workers, caplog):
    def kill():
        numbers(root)
        os.kill(workers._starter._process.pid, signal.SIGKILL)

    with meanwhile(kill):
        lost = outcome(workers, command(root, "stages.end", "wait"))
    assert isinstance(lost, WorkerLost)  # so the engine starts it again
    check_dead(numbers(root))
    for _ in range(2):
        assert outcome(workers, command(root, "stages.end", "plain")).code == 0
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "died" in caplog.text


def test_a_library_with_threads_is_not_forked(root, workers, caplog):
    for _ in range(2):
        run = command(root, "stages.threads")
        assert outcome(workers, run).code == 0
        assert text_of(run) == "$ python -m stages.threads\ndone\n"
    (record,) = caplog.records
    assert record.getMessage().endswith("a library started a thread, which a fork would lack")


def test_a_starter_that_cannot_start_is_done_without(root, workers, caplog, monkeypatch):
    monkeypatch.setattr("objectfolder.engine.warm.BOOT", "raise SystemExit(1)")
    assert outcome(workers, command(root, "stages.end", "plain")).code == 0
    assert len(caplog.records) == 1


@pytest.mark.parametrize("needs", [{"gpus": 0.5}, {"cpus": 2}])
def test_stages_with_gpus_or_threads_start_cold(root, workers, needs):
    assert outcome(workers, command(root, "stages.end", "plain"), **needs).code == 0
    assert workers._starter is None


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["python -m stages.modal mug"], True),
        (["python -m stages.hash_code"], True),
        (["python -m stages.recognize 50/a-b.c_d"], True),
        (["python -m stages.modal $KEY"], False),
        (["python -m stages.modal mug > log"], False),
        (["python -m stages.modal 'mug'"], False),
        (["python -m stages.modal mug; true"], False),
        (["python -S -m stages.modal mug"], False),
        (["python -m other mug"], False),
        (["python -m stages.modal mug", "true"], False),
        ([], False),
    ],
)
def test_only_plain_commands_start_warm(root, lines, expected):
    assert is_stage(Command(lines, root, {}, root / "log")) is expected


def test_nothing_starts_once_the_starter_has_ended(root, starter):
    starter.kill()
    starter._process.wait()
    with pytest.raises(NotStarted):
        Children().run(command(root, "stages.end", "plain"), starter.start)


PIPELINE = "stages: {end: {cmd: python -m stages.end wait, outs: [stage, child]}}\n"
ENGINE = "from objectfolder.engine.build import build; build()"


@pytest.mark.parametrize(
    ("number", "stopped"),
    [(signal.SIGKILL, False), (signal.SIGKILL, True), (signal.SIGINT, False), (signal.SIGTERM, False)],
)
def test_forks_end_with_the_engine(make_workspace, root, number, stopped):
    workspace = make_workspace(PIPELINE)
    for name in ("stages", "objectfolder", "tools.py"):
        (root / name).rename(workspace.root / name)
    engine = start(workspace, "-c", ENGINE)
    pids = numbers(workspace.root)
    (starter,) = (child.pid for child in psutil.Process(engine.pid).children())
    if stopped:
        os.kill(starter, signal.SIGSTOP)
    engine.send_signal(number)
    engine.wait(60)
    check_dead([starter, *pids])
