"""Processes that start warm: forks of a server that has imported the libraries, but nothing of the project.

A fork imports the project itself, from its working directory, as a new process would. What a test says of
signals or process groups needs a real process instead.
"""

import fcntl
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path

LIBRARIES = """
    concurrent.futures dvc.cli dvc.commands.repro dvc.commands.status dvc.repo dvc.repo.reproduce
    dvc.repo.status dvc.stage.cache dvc.stage.run embreex igl jsonschema manifold3d matplotlib.figure
    networkx numpy PIL.Image PIL.ImageDraw psutil pydantic pymetis pypardiso rich.console rich.live
    rich.markdown rich.progress rich.table ruamel.yaml safetensors.torch scipy.fft scipy.interpolate
    scipy.ndimage scipy.optimize scipy.signal scipy.sparse.csgraph scipy.sparse.linalg scipy.spatial
    scipy.special scipy.stats skimage.measure skimage.metrics skimage.morphology soundfile threadpoolctl
    torch torch.nn.functional trimesh typer.main
"""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
#: Stands for ``python`` in the forks: stages become forks as well, anything else a process of its own.
SHIM = """#!{python} -IS
import os, sys
if sys.argv[1:2] != ["-m"] or not sys.argv[2].startswith("stages."):
    os.execv({python!r}, [{python!r}, *sys.argv[1:]])
sys.path.insert(0, {support!r})
from forkserver import Process
sys.exit(Process({path!r}, sys.argv[1:], os.getcwd(), dict(os.environ), (0, 1, 2)).wait())
"""


class ForkServer:
    """Client of a server; ``path``: its socket, and beside it the program ``bin/python``."""

    def __init__(self, path: Path):
        self.path = path

    def run(self, command, cwd, timeout=500, **env) -> subprocess.CompletedProcess:
        """Run ``python COMMAND...`` and capture what it prints, like subprocess.run."""
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            code = self.start(command, cwd, out, err, **env).wait(timeout)
            texts = [os.pread(file.fileno(), os.fstat(file.fileno()).st_size, 0) for file in (out, err)]
        return subprocess.CompletedProcess(list(command), code, *(text.decode() for text in texts))

    def start(self, command, cwd, out, err, **env) -> "Process":
        """Start ``python COMMAND...`` with open files for its output."""
        with open(os.devnull) as null:  # noqa: PTH123
            files = [stream.fileno() for stream in (null, out, err)]
            return Process(self.path, list(command), str(cwd), {**os.environ, **ONE_THREAD, **env}, files)


class Process:
    """Fork that runs a command, in a session of its own; it dies with this object.

    ``path``: socket of the server; ``command``: ``-c CODE ...`` or ``-m MODULE ...``; ``files``: standard
    input, output and error.
    """

    def __init__(self, path, command, cwd, env, files):
        self.connection = socket.socket(socket.AF_UNIX)
        self.connection.connect(str(path))
        text = json.dumps({"command": command, "cwd": cwd, "env": env}).encode() + b"\n"
        socket.send_fds(self.connection, [text[:1]], files)
        self.connection.sendall(text[1:])
        self.pid = struct.unpack("i", self.connection.recv(4, socket.MSG_WAITALL))[0]

    def wait(self, timeout=None) -> int:
        """Return the exit code; minus the number of the signal that killed it."""
        self.connection.settimeout(timeout)
        with self.connection:
            return struct.unpack("i", self.connection.recv(4, socket.MSG_WAITALL))[0]

    def send_signal(self, number) -> None:
        """Send it a signal."""
        os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Kill it, and nothing that it has started."""
        self.send_signal(signal.SIGKILL)


@contextmanager
def fork_server(folder: Path, hash_seed: int):
    """Client of a server in a folder, started unless it is there; it ends with the last client."""
    path = folder / "socket"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if (lease := _connected(path)) is None:
            _start(path, hash_seed)
            lease = _connected(path)
    with closing(lease):
        yield ForkServer(path)


def _connected(path):
    connection = socket.socket(socket.AF_UNIX)
    try:
        connection.connect(str(path))
    except OSError:
        connection.close()
        return None
    connection.sendall(b"lease\n")
    return connection


def _start(path, hash_seed):
    shim = path.parent / "bin" / "python"
    shim.parent.mkdir(exist_ok=True)
    support = str(Path(__file__).parent)
    shim.write_text(SHIM.format(python=sys.executable, support=support, path=str(path)))
    shim.chmod(0o755)
    path.unlink(missing_ok=True)
    environment = {**os.environ, **ONE_THREAD, "PYTHONHASHSEED": str(hash_seed)}
    command = [sys.executable, __file__, path, shim]
    with (path.parent / "log").open("w") as log:
        server = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
    deadline = time.monotonic() + 500
    while not path.exists():
        assert server.poll() is None, (path.parent / "log").read_text()
        assert time.monotonic() < deadline, "the fork server does not start"
        time.sleep(0.02)
    server.returncode = 0  # it is not ours to wait for: other clients may need it longer


def serve(path: str, shim: str) -> None:
    """Answer until the last lease ends. Returns in forks only, having run nothing yet."""
    for name in LIBRARIES.split():
        importlib.import_module(name)
    threads = [*Path("/proc/self/task").iterdir()]
    assert len(threads) == 1, f"a fork would lose {len(threads) - 1} threads"
    gc.collect()
    gc.freeze()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the attendants
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(path + ".new")
    listener.listen(64)
    Path(path + ".new").rename(path)
    leases, started = set(), False
    while leases or not started:
        ready, _, _ = select.select([listener, *leases], [], [], None if started else 60)
        if not ready:  # who started it was killed meanwhile
            break
        for connection in ready:
            if connection is not listener:
                leases.discard(connection)  # it never says more: it has ended
                connection.close()
                continue
            client, _ = listener.accept()
            text, files, _, _ = socket.recv_fds(client, 1 << 16, 3)
            if text.startswith(b"lease"):
                leases.add(client)
                started = True
            elif os.fork() == 0:
                for other in (listener, *leases):
                    other.close()
                return attend(client, text, files, shim)
            else:
                for file in files:
                    os.close(file)
                client.close()
    sys.exit()


def attend(client: socket.socket, text: bytes, files: list[int], shim: str) -> None:
    """Fork the command and report its exit code; end it if the client ends. Returns in the command's fork."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    while not text.endswith(b"\n"):
        text += client.recv(1 << 16)
    asked = json.loads(text)
    if (worker := os.fork()) == 0:
        client.close()
        os.setsid()
        return become(asked["command"], asked["cwd"], asked["env"], files, shim)
    for file in files:
        os.close(file)
    watched = os.pidfd_open(worker)
    client.sendall(struct.pack("i", worker))
    ready, _, _ = select.select([watched, client], [], [])
    if watched not in ready:
        with suppress(ProcessLookupError):
            os.killpg(worker, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1])
    with suppress(OSError):
        client.sendall(struct.pack("i", code))
    os._exit(0)


def become(command: list[str], cwd: str, env: dict[str, str], files, shim: str) -> None:
    """Look like a process that was just started with ``python COMMAND...``."""
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    sys.stdin, sys.stdout, sys.stderr = (open(i, "w" if i else "r", closefd=False) for i in range(3))  # noqa: SIM115
    sys.stdout.reconfigure(write_through="PYTHONUNBUFFERED" in env)
    sys.stderr.reconfigure(line_buffering=True, errors="backslashreplace")
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(env)
    sys.executable = shim
    sys.path[0] = cwd
    sys.argv = ["-c", *command[2:]] if command[0] == "-c" else command[1:]
    sys.orig_argv = [shim, *command]
    importlib.invalidate_caches()


def main() -> None:
    """Serve; in a fork, run the command."""
    sys.path.insert(1, str(Path(__file__).parents[2]))
    from objectfolder.engine.warm import forget_project, run_to_exit

    forget_project()
    del sys.path[1]
    serve(*sys.argv[1:])
    run_to_exit(partial(_run, sys.orig_argv[1:]))


def _run(command: list[str]) -> None:
    if command[0] == "-c":
        exec(compile(command[1], "<string>", "exec"), {"__name__": "__main__"})
    else:
        assert command[0] == "-m", command
        runpy.run_module(command[1], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
