"""Builds shared through remotes: a directory, and a server that speaks S3."""

import importlib.util
import shutil
import subprocess
import sys
from types import SimpleNamespace

import pytest
from dvc.repo import Repo
from refusals import refused

from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.summary import Planned, StageOutcome

from .conftest import PIPELINE, Workspace, everything

PULL = BuildOptions(jobs=2, pull=True)

SERVER = """
import signal
from moto.server import ThreadedMotoServer
server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
server.start()
print(server.get_host_and_port()[1], flush=True)
signal.pause()
"""


@pytest.fixture
def server(monkeypatch):
    """An S3 server on loopback, in a process of its own; ``stop`` ends it."""
    for name in ("dvc_s3", "moto", "flask"):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"{name} is not installed: pip install -e '.[dev]'")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "testing")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")  # else an outage is believed after ten seconds
    with subprocess.Popen([sys.executable, "-c", SERVER], stdout=subprocess.PIPE, text=True) as process:

        def stop():
            process.kill()
            process.wait()

        yield SimpleNamespace(url=f"http://127.0.0.1:{process.stdout.readline().strip()}", stop=stop)
        stop()


def git(root, *arguments):
    identity = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "protocol.file.allow=always")
    subprocess.run(["git", *identity, *arguments], cwd=root, check=True, capture_output=True)


@pytest.fixture
def shared(make_workspace):
    """A workspace all of whose outputs are cached."""
    workspace = make_workspace(PIPELINE.replace(".json:\n            cache: false", ".json"))
    with (workspace.root / ".gitignore").open("a") as stream:
        stream.write("/calls\n/control/\n__pycache__/\n")
    return workspace


def configure(workspace, **remote):
    """What `dvc remote add -d store URL` and `dvc remote modify store OPTION VALUE` do, but quicker."""
    with Repo(str(workspace.root)) as repo, repo.config.edit("repo") as config:
        config["core"]["remote"] = "store"
        config["remote"]["store"] = remote


def add_directory(workspace):
    store = workspace.root.parent / "store"
    configure(workspace, url=str(store))
    return store


def add_s3(workspace, server):
    import boto3

    boto3.client("s3", endpoint_url=server.url).create_bucket(Bucket="objects")
    configure(workspace, url="s3://objects/ours", endpointurl=server.url)


def clone(workspace, name="clone"):
    """Clone what git has into a fresh directory."""
    git(workspace.root, "add", "-A")
    git(workspace.root, "commit", "-q", "--allow-empty", "-m", "Built")
    root = workspace.root.parent / name
    git(root.parent, "clone", "-q", str(workspace.root), str(root))
    assert not (root / "build").exists()
    assert not (root / ".dvc/cache").exists()
    return Workspace(root, workspace.server)


def content(workspace):
    files = [path for folder in ("build", "metrics") for path in (workspace.root / folder).rglob("*")]
    return {
        path.relative_to(workspace.root).as_posix(): path.read_bytes()
        for path in files
        if path.is_file() and ".logs" not in path.parts
    }


@pytest.mark.parametrize("kind", ["directory", pytest.param("s3", marks=pytest.mark.slow)])
def test_fresh_clone_gets_a_whole_build_without_running_a_stage(shared, kind, request):
    if kind == "s3":
        add_s3(shared, request.getfixturevalue("server"))
    else:
        add_directory(shared)
    build(root=shared.root)
    shared.dvc("push", "--run-cache")

    pulled = clone(shared, "pulled")
    pulled.dvc("pull", "--run-cache")
    summary = build(root=pulled.root)
    assert len(summary.with_status(StageOutcome.SKIPPED)) == len(everything())

    fresh = clone(shared, "fresh")
    summary = build(root=fresh.root, options=PULL)
    assert sorted(result.address for result in summary.with_status(StageOutcome.RESTORED)) == everything()
    assert "up to date" in fresh.dvc("status")

    for workspace in (pulled, fresh):
        assert workspace.ran() == []
        assert content(workspace) == content(shared)
        # The run cache came too: a build without the lock file runs nothing either.
        (workspace.root / "dvc.lock").unlink()
        assert build(root=workspace.root).ok
        assert workspace.ran() == []


@pytest.mark.slow
def test_earlier_states_come_from_the_remote_and_one_object_alone_is_fetched(shared):
    add_directory(shared)
    build(root=shared.root)
    shared.dvc("push", "--run-cache")
    before = content(shared)
    shared.params(mug={"material": "glass"})
    build(root=shared.root)
    shared.dvc("push", "--run-cache")
    fresh = clone(shared)
    fresh.params()  # dvc.lock knows the glass mug only
    assert build(["mug"], root=fresh.root, options=PULL).ok
    assert fresh.ran() == []
    assert content(fresh) == {name: data for name, data in before.items() if "mug" in name}
    assert build(root=fresh.root).ok
    # What the others alone have was not fetched; the rest has the same content for all.
    assert fresh.ran() == ["solve@bell", "solve@bowl"]


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["missing", "damaged"])
def test_object_that_the_remote_lacks_or_has_damaged_is_built_again(shared, fault, caplog):
    store = add_directory(shared)
    build(root=shared.root)
    shared.dvc("push", "--run-cache")
    path = shared.root / "build/mug/solve/a.txt"
    (copy,) = (p for p in store.rglob("*") if p.is_file() and p.read_bytes() == path.read_bytes())
    # pack.txt has the same content, so the object serves two stages.
    copy.chmod(0o644)
    if fault == "missing":
        copy.unlink()
    else:
        copy.write_bytes(copy.read_bytes()[::-1])
    fresh = clone(shared)
    assert build(root=fresh.root, options=PULL).ok
    assert "solve@mug" in fresh.ran()
    assert content(fresh) == content(shared)
    assert (
        "files are missing in remote store" if fault == "missing" else "is damaged and was removed"
    ) in caplog.text
    assert "up to date" in fresh.dvc("status")


@pytest.mark.slow
def test_outage_is_said_and_the_build_goes_on_from_what_is_here(shared, server, caplog):
    add_s3(shared, server)
    build(root=shared.root)
    shared.ran()
    before = content(shared)
    server.stop()
    shutil.rmtree(shared.root / "build/mug")
    (shared.root / "steps.py").write_text((shared.root / "steps.py").read_text() + "# new\n")
    assert build(["solve@mug", "bell"], root=shared.root, options=PULL).ok
    assert shared.ran() == ["prepare@bell", "prepare@mug"]
    assert f'endpoint URL: "{server.url}' in caplog.text
    assert "cannot fetch from remote store (s3://objects/ours)" in caplog.text
    assert content(shared) == {name: data for name, data in before.items() if name != "build/mug/pack.txt"}


@pytest.mark.slow
def test_outage_during_a_build_is_said_once_and_the_stages_are_built(shared, server, caplog):
    add_s3(shared, server)
    build(root=shared.root)
    shared.dvc("push", "--run-cache")
    shared.params(mug={"material": "glass"}, bell={"material": "glass"})
    build(root=shared.root)
    fresh = clone(shared)
    fresh.params()

    def stop(event):
        if isinstance(event, Planned):
            server.stop()

    assert build(["mug", "bell"], root=fresh.root, options=PULL, on_event=stop).ok
    assert {"solve@mug", "solve@bell"} <= set(fresh.ran())
    assert caplog.text.count("lost connection to the remote") == 1


def test_remote_directory_that_is_not_there_is_said(shared, caplog):
    configure(shared, url=str(shared.root.parent / "nowhere"))
    assert build(["prepare@mug"], root=shared.root, options=PULL).ok
    assert "nowhere) is empty or does not exist" in caplog.text


def test_pull_without_a_remote_or_what_speaks_to_it_is_refused(shared):
    refused(r"no default remote .* `dvc remote add -d NAME URL`", build, root=shared.root, options=PULL)
    if importlib.util.find_spec("dvc_gs") is not None:
        pytest.skip("dvc-gs is installed, so nothing is missing")
    configure(shared, url="gs://objects")
    refused(r"dvc-gs.*pip install", build, root=shared.root, options=PULL)
    assert shared.ran() == []
