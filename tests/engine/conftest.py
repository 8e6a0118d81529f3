"""A small DVC workspace: three objects, and the chain prepare -> solve -> pack for each."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from forkserver import ForkServer
from ruamel.yaml import YAML

from objectfolder.engine.build import build
from objectfolder.engine.verify import verify

from . import tiny_project

PIPELINE = r"""
stages:
  prepare:
    foreach: ${objects}
    do:
      cmd: python -m steps prepare ${key}
      deps: [steps.py]
      params: ["objects.${key}.size"]
      outs: ["build/${key}/prepare.txt"]
  solve:
    foreach: ${objects}
    do:
      cmd: python -m steps solve ${key}
      deps: ["build/${key}/prepare.txt"]
      params: ["objects.${key}.material"]
      outs: ["build/${key}/solve"]
  pack:
    foreach: ${objects}
    do:
      cmd: python -m steps pack ${key}
      deps: ["build/${key}/prepare.txt", "build/${key}/solve"]
      outs: ["build/${key}/pack.txt"]
      metrics:
        - metrics/${key}.json:
            cache: false
"""

# `calls` records what really ran; the files under `control` make a stage of an object fail, wait or
# write half.
STEPS = r"""
import os, sys, time
from pathlib import Path

stage, key = sys.argv[1:]
print("hello from", stage, key)
with open("calls", "a") as stream:
    stream.write(f"{stage}@{key} start {time.monotonic()} {os.getpid()} {os.environ['OMP_NUM_THREADS']}\n")
control = Path("control") / f"{stage}@{key}"
if control.exists():
    if control.read_text() == "fail":
        print("the reason of the failure", file=sys.stderr)
        sys.exit(3)
    if control.read_text() == "half":
        Path("build", key).mkdir(parents=True, exist_ok=True)
        Path("build", key, "prepare.txt").write_text("hal")
        control.write_text("60")
    if control.read_text() == "meet":  # two other starts of this stage
        while Path("calls").read_text().count(f"{stage}@") < 3:
            time.sleep(0.05)
    else:
        time.sleep(float(control.read_text()))
build = Path("build") / key
build.mkdir(parents=True, exist_ok=True)
params = Path(os.environ.get("OBJECTFOLDER_PARAMS", "params.yaml"))
lines = [line for line in params.read_text().splitlines() if line.startswith(f"  {key}:")]
if stage == "prepare":
    (build / "prepare.txt").write_text(lines[0].split("size: ")[1].split(",")[0])
elif stage == "solve":
    (build / "solve").mkdir()
    (build / "solve" / "a.txt").write_text((build / "prepare.txt").read_text() + lines[0])
else:
    (build / "pack.txt").write_text((build / "solve" / "a.txt").read_text())
    Path("metrics").mkdir(exist_ok=True)
    metrics = '{"vision": {}, "audio": {"modes": 0}, "touch": {}, "file_bytes": 1}'
    (Path("metrics") / f"{key}.json").write_text(metrics + "\n")
with open("calls", "a") as stream:
    stream.write(f"{stage}@{key} end {time.monotonic()} {os.getpid()} -\n")
"""

KEYS = ("bell", "bowl", "mug")


class Workspace:
    """A workspace and the means to change and inspect it.

    ``root``: where it is; ``server``: runs its commands.
    """

    def __init__(self, root: Path, server: ForkServer):
        self.root = root
        self.server = server

    def copy(self, root: Path) -> "Workspace":
        """Copy it with all that was built."""
        return Workspace(shutil.copytree(self.root, root), self.server)

    def params(self, **objects: dict[str, object]) -> None:
        """Write params.yaml; objects that are not given keep their defaults."""
        lines = ["objects:"]
        for key in KEYS:
            entry = {"size": 1, "material": "steel"} | objects.get(key, {})
            lines.append(f"  {key}: {{size: {entry['size']}, material: {entry['material']}}}")
        (self.root / "params.yaml").write_text("\n".join(lines) + "\n")

    def control(self, address: str, value: str | None) -> None:
        """Make a stage fail ("fail"), wait (seconds, or "meet": for three runs of it), or behave (None)."""
        path = self.root / "control" / address
        path.parent.mkdir(exist_ok=True)
        path.unlink(missing_ok=True)
        if value is not None:
            path.write_text(value)

    def calls(self) -> list[list[str]]:
        """Starts and ends of stage commands so far, as (address, start or end, time, pid, threads)."""
        path = self.root / "calls"
        return [line.split() for line in path.read_text().splitlines()] if path.exists() else []

    def ran(self) -> list[str]:
        """Addresses that ran since the last call of this method, sorted."""
        started = sorted(call[0] for call in self.calls() if call[1] == "start")
        (self.root / "calls").unlink(missing_ok=True)
        return started

    def dvc(self, *arguments: str) -> str:
        """Run the real `dvc` command line and return what it printed."""
        done = self.server.run(("-m", "dvc", *arguments), self.root)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def check_clean(self) -> None:
        """Nothing is left to do by DVC's word, and every file is what was recorded by its bytes."""
        assert "up to date" in self.dvc("status")
        assert verify(root=self.root).findings == ()

    def cached(self, path: str) -> Path:
        """Cached object of an output, or of a file in one, as dvc.lock has it."""
        lock = (self.root / "dvc.lock").read_text()
        folder, _, name = path.rpartition("/")
        if f"- path: {path}\n" in lock:
            oid = lock.partition(f"- path: {path}\n")[2].partition("md5: ")[2].split()[0]
        else:
            members = json.loads(self.cached(folder).read_text())
            oid = next(member["md5"] for member in members if member["relpath"] == name)
        return self.root / ".dvc/cache/files/md5" / oid[:2] / oid[2:]

    def locked(self) -> set[str]:
        """Addresses in dvc.lock."""
        return set(YAML(typ="safe").load(self.root / "dvc.lock")["stages"])


def spoil(path: Path) -> None:
    """Flip a bit in place: same size, same inode, same times, same mode."""
    info = path.stat()
    path.chmod(0o644)
    content = path.read_bytes()
    with path.open("r+b") as stream:
        stream.write(bytes([content[0] ^ 1]))
    path.chmod(info.st_mode)
    os.utime(path, ns=(info.st_atime_ns, info.st_mtime_ns))
    assert (path.stat().st_ino, path.stat().st_size) == (info.st_ino, info.st_size)


def everything(*stages: str) -> list[str]:
    """Addresses of stages for all objects, sorted."""
    return sorted(f"{stage}@{key}" for stage in stages or ("prepare", "solve", "pack") for key in KEYS)


@pytest.fixture(scope="session")
def make(tmp_path_factory, fork_server) -> Callable[[Path, str], Workspace]:
    """Make a workspace with a pipeline at a path."""
    from dvc.repo import Repo

    template = tmp_path_factory.mktemp("template") / "workspace"
    subprocess.run(["git", "init", "-q", template], check=True)
    with Repo.init(str(template)) as repo, repo.config.edit("repo") as config:
        config["core"].update({"analytics": False, "check_update": False})
    (template / ".gitignore").write_text("/build/\n/metrics/\n")
    (template / "steps.py").write_text(STEPS)
    template = Workspace(template, fork_server)
    template.params()

    def make(root: Path, pipeline: str) -> Workspace:
        (template.root / "dvc.yaml").write_text(pipeline)
        return template.copy(root)

    return make


@pytest.fixture
def make_workspace(tmp_path: Path, make: Callable[[Path, str], Workspace]) -> Callable[[str], Workspace]:
    return lambda pipeline: make(tmp_path / "workspace", pipeline)


@pytest.fixture
def workspace(make_workspace: Callable[[str], Workspace]) -> Workspace:
    return make_workspace(PIPELINE)


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """The project in miniature, built."""
    root = tmp_path_factory.mktemp("template") / "workspace"
    tiny_project.make(root)
    assert build(root=root).ok
    return root
