"""A real cluster of two nodes on this machine: `head` with one core, `worker` with two and a GPU."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from refusals import refused
from typer.testing import CliRunner

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import install_command
from objectfolder.cli import app
from objectfolder.engine import resources
from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.journal import read_journal
from objectfolder.engine.ray import Node, RayWorkers, fit_to_nodes, ray_workers
from objectfolder.engine.resources import Needs

from .conftest import STEPS, Workspace, everything
from .processes import PATH, alive, started, wait_for
from .test_edits import Editing, check_reverted_edit_of_a_file, check_reverted_edit_of_params, copying  # noqa: F401

pytest.importorskip("ray", reason="needs the extra [ray]")
pytestmark = pytest.mark.slow  # a cluster of two nodes on one machine

ROOT = Path(__file__).parents[2]
#: Node deaths are noticed within seconds, and nothing is sent anywhere.
SETTINGS = {
    "RAY_health_check_period_ms": "500",
    "RAY_health_check_timeout_ms": "2000",
    "RAY_health_check_failure_threshold": "4",
    "RAY_USAGE_STATS_ENABLED": "0",
}
ENGINE = """
import sys
from rich.console import Console
from objectfolder.engine import resources
from objectfolder.engine.build import build
from objectfolder.engine.progress import Progress
from objectfolder.engine.ray import ray_workers
resources.NEEDS["solve"] = resources.Needs(gpus=1.0)
with Progress(Console(file=sys.stdout)) as progress:
    sys.exit(not build(on_event=progress, make_workers=ray_workers(sys.argv[1])).ok)
"""


class Cluster:
    """Nodes started with the command line of Ray, each a session of processes of its own."""

    def __init__(self, folder: Path):
        self.folder = folder
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.address = f"127.0.0.1:{probe.getsockname()[1]}"
        self.sessions: dict[str, int] = {}

    def start(self, name: str, cpus: int, *arguments: str) -> None:
        command = [sys.executable, "-m", "ray.scripts.scripts", "start", f"--num-cpus={cpus}"]
        command += [f"--temp-dir={self.folder / name}", "--object-store-memory=80000000"]
        command += ["--include-log-monitor=false", *arguments]
        # The name tells a stage where it runs; nobody else's cluster is asked for or heard of.
        environment = {key: value for key, value in os.environ.items() if not key.startswith("RAY_")}
        environment |= SETTINGS | {"TEST_NODE": name, "PYTHONPATH": str(ROOT)}
        with (self.folder / f"{name}.log").open("w") as log:
            process = subprocess.Popen(
                command, env=environment, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
            )
            self.sessions[name] = process.pid
            assert process.wait(60) == 0, (self.folder / f"{name}.log").read_text()

    def start_head(self) -> None:
        self.start("head", 1, "--head", f"--port={self.address.split(':')[1]}", "--include-dashboard=false")

    def start_worker(self) -> None:
        self.start("worker", 2, f"--address={self.address}", "--num-gpus=1")

    def kill(self, name: str) -> None:
        """Kill every process of a node, as a power cut does."""
        session = self.sessions.pop(name)
        for process in [process for process in psutil.process_iter() if _session(process.pid) == session]:
            process.kill()


def _session(pid: int) -> int | None:
    try:
        return os.getsid(pid)
    except ProcessLookupError:
        return None


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    # Not pytest's own folder: the path of a socket may have 107 characters.
    folder = Path(tempfile.mkdtemp(prefix="of-ray-"))
    nodes = Cluster(folder)
    try:
        nodes.start_head()
        nodes.start_worker()
        yield nodes
    finally:
        for name in list(nodes.sessions):
            nodes.kill(name)
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def located(workspace: Workspace) -> Workspace:
    """The small workspace; its stages write down where they run."""
    where = (
        "import os; where = [os.environ.get(name, '?') for name in ('TEST_NODE', 'CUDA_VISIBLE_DEVICES')]\n"
    )
    where += "open('where', 'a').write(' '.join((os.environ['DVC_STAGE'], *where)) + '\\n')\n"
    (workspace.root / "steps.py").write_text(where + STEPS)
    return workspace


def places(workspace: Workspace, address: str) -> list[list[str]]:
    """Nodes and GPUs of the runs of a stage so far."""
    lines = [line.split() for line in (workspace.root / "where").read_text().splitlines()]
    return [line[1:] for line in lines if line[0] == address]


def start(workspace: Workspace, cluster: Cluster) -> subprocess.Popen[str]:
    environment = os.environ | {"PATH": PATH, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, "-c", ENGINE, cluster.address],
        cwd=workspace.root,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def test_stages_run_on_both_nodes_with_the_python_and_environment_of_the_node(located, cluster, monkeypatch):
    monkeypatch.setenv("TEST_NODE", "the engine's own")
    for key in ("bell", "bowl", "mug"):
        located.control(f"prepare@{key}", "meet")  # three at a time fill both nodes
    summary = build(root=located.root, make_workers=ray_workers(cluster.address))
    assert summary.ok
    assert [call[1] for call in located.calls()][:6] == ["start"] * 3 + ["end"] * 3
    used = [places(located, address)[0] for address in everything("prepare")]
    assert sorted(used) == [["head", "-1"], ["worker", "-1"], ["worker", "-1"]]
    assert located.ran() == everything()
    assert "hello from solve mug" in summary.stages["solve@mug"].log.read_text()
    assert 1 < summary.stages["solve@mug"].peak_mb < 60
    assert "up to date" in located.dvc("status")
    assert not list((located.root / "build/.logs").glob("cluster-*"))


@pytest.mark.slow
def test_stages_of_half_a_gpu_share_it(make_workspace, cluster, monkeypatch):
    workspace = make_workspace(
        "stages:\n"
        "  meet:\n"
        "    foreach: [bell, mug]\n"
        "    do: {cmd: 'python meet.py ${item}', outs: ['build/${item}']}\n"
    )
    (workspace.root / "meet.py").write_text(
        "import os, sys, time\n"
        "from pathlib import Path\n"
        "Path('build').mkdir(exist_ok=True)\n"
        "Path('build', sys.argv[1]).write_text(os.environ['CUDA_VISIBLE_DEVICES'])\n"
        "while not (Path('build/bell').exists() and Path('build/mug').exists()):\n"
        "    time.sleep(0.05)\n"
    )
    monkeypatch.setitem(resources.NEEDS, "meet", Needs(gpus=0.5, timeout=30))
    assert build(root=workspace.root, make_workers=ray_workers(cluster.address)).ok
    assert (workspace.root / "build/bell").read_text() == "0"
    assert (workspace.root / "build/mug").read_text() == "0"


@pytest.mark.slow
def test_stages_of_a_whole_gpu_take_turns_and_too_large_ones_are_cut_down(located, cluster, monkeypatch):
    monkeypatch.setitem(resources.NEEDS, "prepare", Needs(gpus=1.0))
    monkeypatch.setitem(resources.NEEDS, "solve", Needs(cpus=64, gpus=8.0, memory_mb=10**8))
    targets = ["prepare@bell", "solve@mug"]
    assert build(targets, root=located.root, make_workers=ray_workers(cluster.address)).ok
    assert [call[1] for call in located.calls()] == ["start", "end"] * 3
    for address in ("prepare@bell", "prepare@mug", "solve@mug"):
        assert places(located, address) == [["worker", "0"]]
    assert located.calls()[-2][4] == "2"  # threads: the cores that the stage got


@pytest.mark.slow
def test_jobs_limit_the_cores_of_the_whole_cluster(located, cluster):
    options = BuildOptions(jobs=1)
    assert build(["prepare"], options, located.root, make_workers=ray_workers(cluster.address)).ok
    assert [call[1] for call in located.calls()] == ["start", "end"] * 3


def test_reverted_edit_of_params_is_not_read_on_a_node(copying, cluster):  # noqa: F811
    check_reverted_edit_of_params(Editing(copying, {"make_workers": ray_workers(cluster.address)}))


def test_reverted_edit_of_a_file_does_not_count_on_a_node(copying, cluster):  # noqa: F811
    editing = Editing(copying, {"make_workers": ray_workers(cluster.address)})
    check_reverted_edit_of_a_file(editing, "source/mesh.obj")


def test_node_without_the_workspace_is_named(workspace, cluster, monkeypatch):
    monkeypatch.setattr(RayWorkers, "_mark", lambda self: None)
    refused(
        f"node {socket.gethostname()} does not see {workspace.root}/",
        build,
        root=workspace.root,
        make_workers=ray_workers(cluster.address),
    )


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGKILL, -9), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_stages_die_with_the_engine_and_the_next_build_completes(located, cluster, number, code):
    located.control("solve@mug", "60")
    engine = start(located, cluster)
    wait_for(lambda: started(located, "solve@mug"), 60)
    stage = started(located, "solve@mug")
    wait_for(lambda: (state := read_journal(located.root)) and "solve@mug" in state.running)
    engine.send_signal(number)
    engine.communicate(timeout=60)
    assert engine.returncode == code
    state = read_journal(located.root)
    assert (state and not state.alive) if number == signal.SIGKILL else state is None
    wait_for(lambda: not alive(stage), 20 if number == signal.SIGKILL else 1)
    located.control("solve@mug", None)
    assert build(root=located.root).ok
    assert "up to date" in located.dvc("status")


@pytest.mark.slow
def test_stage_whose_node_dies_runs_again_on_another(located, cluster):
    located.control("solve@mug", "60")
    engine = start(located, cluster)
    wait_for(lambda: started(located, "solve@mug"), 60)
    stage = started(located, "solve@mug")
    located.control("solve@mug", None)
    cluster.kill("worker")
    output, _ = engine.communicate(timeout=100)
    assert engine.returncode == 0, output
    assert not alive(stage)
    runs = places(located, "solve@mug")
    assert runs[0] == ["worker", "0"]
    assert runs[-1] == ["head", "-1"]  # no node with a GPU is left
    lines = output.splitlines()
    assert any(line.startswith("lost     solve@mug its ") for line in lines), output
    # Ray's own lines would spoil the display.
    assert {line.split()[0] for line in lines} == {"9", "started", "ran", "lost"}, output
    assert "up to date" in located.dvc("status")


SMALL = Node("1", "small", cpus=64, gpus=0, memory_mb=256_000)
LARGE = Node("2", "large", cpus=8, gpus=2, memory_mb=32_000)


@pytest.mark.parametrize(
    ("given", "nodes", "jobs", "expected"),
    [
        ((16, 0.0, 64_000), (SMALL, LARGE), None, (16, 0.0, 64_000)),
        ((16, 0.5, 64_000), (SMALL, LARGE), None, (8, 0.5, 32_000)),
        ((1, 4.0, 1000), (SMALL, LARGE), None, (1, 2.0, 1000)),
        ((1, 1.0, 1000), (SMALL,), None, (1, 0.0, 1000)),
        ((16, 0.0, 1000), (SMALL,), 4, (4, 0.0, 1000)),
    ],
)
def test_needs_are_cut_to_the_closest_node(given, nodes, jobs, expected):
    given, expected = (Needs(cpus=c, gpus=g, memory_mb=m) for c, g, m in (given, expected))
    assert fit_to_nodes(given, nodes, jobs) == expected


def test_what_runs_on_a_node_needs_no_dvc():
    code = "import sys, objectfolder.engine.node; print(not {'dvc', 'psutil', 'ray'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


def test_missing_ray_and_missing_clusters_are_named(workspace, monkeypatch):
    def refusal(address: str) -> str:
        with pytest.raises(ObjectFolderError) as caught:
            build(root=workspace.root, make_workers=ray_workers(address))
        return str(caught.value)

    with socket.socket() as unheard:
        unheard.bind(("127.0.0.1", 0))  # bound, so that nobody else gets it, but nobody listens
        port = unheard.getsockname()[1]
        assert f"no Ray cluster answers at '127.0.0.1:{port}'" in refusal(f"127.0.0.1:{port}")
        monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{port}")
        assert f"no Ray cluster answers at '127.0.0.1:{port}'" in refusal("auto")
    assert "no Ray cluster answers at 'nonsense'" in refusal("nonsense")
    assert "make this machine a node" in refusal("ray://127.0.0.1:10001")
    monkeypatch.setitem(sys.modules, "ray", None)
    assert refusal("auto").endswith(f"`--engine ray` needs: {install_command('ray')}")
    assert not workspace.ran()


def test_an_address_without_the_engine_is_refused():
    result = CliRunner().invoke(app, ["build", "--address", "10.0.0.1:6379"])
    assert isinstance(result.exception, ObjectFolderError)
    assert "--engine ray" in str(result.exception)
