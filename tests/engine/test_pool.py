import subprocess
import sys
import time

import psutil


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
