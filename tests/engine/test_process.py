import os
import subprocess
import sys
import threading
import time

import psutil

from objectfolder.engine.process import Children, Command, describe_exit, stage_environment, tail


def command(tmp_path, *lines):
    return Command(
        lines=lines, cwd=tmp_path, env=stage_environment(os.environ), log=tmp_path / "logs" / "x.log"
    )


def test_measures_time_and_memory(tmp_path):
    small = Children().run(command(tmp_path, "python -S -c 'import time; time.sleep(0.3)'"))
    large = Children().run(command(tmp_path, "python -S -c 'x = b\"1\" * 100_000_000'; true"))
    assert small.code == large.code == 0
    assert small.seconds >= 0.3
    # Smaller than this process: the engine's own memory is not counted.
    assert 1 < small.peak_mb < 40
    assert large.peak_mb > 95


def test_counts_the_processor_time_of_a_command_and_its_children(tmp_path):
    busy = "import time\nwhile time.process_time() < 0.3: pass"
    run = Children().run(command(tmp_path, f"python -S -c '{busy}'; sleep 0.2", "sleep 0.1"))
    assert run.code == 0
    assert 0.3 <= run.cpu_seconds < run.seconds - 0.25


def test_log_holds_both_streams_and_tail_its_end(tmp_path):
    run = command(tmp_path, "for i in $(seq 30); do echo line $i; done; echo oops >&2; exit 5", "echo never")
    assert Children().run(run).code == 5
    lines = tail(run.log)
    assert len(lines) == 15
    assert lines[-2:] == ("line 30", "oops")
    assert tail(tmp_path / "absent.log") == ()


def test_python_is_this_interpreter_and_libraries_get_one_thread(tmp_path):
    run = command(tmp_path, "command -v python; echo $OMP_NUM_THREADS $OPENBLAS_NUM_THREADS $MKL_NUM_THREADS")
    assert Children().run(run).code == 0
    python, threads = tail(run.log)[1:]
    assert os.path.dirname(python) == os.path.dirname(sys.executable)  # noqa: PTH120
    assert threads == "1 1 1"


def test_kill_reaches_grandchildren(tmp_path):
    children = Children()
    outcomes = []
    run = command(tmp_path, "(sleep 60; echo late) | cat; true")
    thread = threading.Thread(target=lambda: outcomes.append(children.run(run)))
    thread.start()
    while not run.log.exists() or not run.log.read_text():
        time.sleep(0.02)
    children.kill()
    thread.join(5)
    assert outcomes[0].code < 0
    assert children.run(run).code < 0  # and nothing starts afterwards


def test_exit_in_words():
    assert "code 3" in describe_exit(3)
    assert "SIGKILL" in describe_exit(-9)
    assert "memory" in describe_exit(137)


def test_processes_end_with_a_command_that_is_killed(tmp_path):
    script = tmp_path / "wait.py"
    script.write_text(
        "import os, pathlib, sys, time\n"
        "from objectfolder.engine.process import in_processes\n"
        "def wait(folder):\n"
        "    (pathlib.Path(folder) / str(os.getpid())).touch()\n"
        "    time.sleep(600)\n"
        "if __name__ == '__main__':\n"
        "    list(in_processes(wait, [(sys.argv[1],)] * 2, 2))\n"
    )
    started = tmp_path / "started"
    started.mkdir()
    with subprocess.Popen([sys.executable, script, started]) as command:
        deadline = time.monotonic() + 60
        while len(list(started.iterdir())) < 2:
            assert command.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        workers = [psutil.Process(int(path.name)) for path in started.iterdir()]
        command.kill()
    assert not psutil.wait_procs(workers, timeout=20)[1]
