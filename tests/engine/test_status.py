"""What `status` and `build --dry-run` say, against what a build then does."""

import hashlib
import io
import json
import re
import shutil
from pathlib import Path

import pytest
from refusals import refused
from rich.console import Console

from objectfolder.cli.statusview import as_json, print_details, print_outlook, print_table
from objectfolder.engine.build import build
from objectfolder.engine.dvc.repository import open_repository
from objectfolder.engine.status import Outlook, StageStatus, State, status
from objectfolder.engine.summary import NO_OBJECTS, StageOutcome

from . import tiny_project
from .conftest import KEYS, everything


@pytest.fixture
def workspace(workspace):
    """Objects of different sizes: equal files of two objects are one in the cache, and come back together."""
    workspace.sizes = {key: {"size": size} for size, key in enumerate(KEYS)}
    write = workspace.params
    workspace.params = lambda **changes: write(
        **{k: v | changes.get(k, {}) for k, v in workspace.sizes.items()}
    )
    workspace.params()
    return workspace


def states(workspace, *targets):
    return {one.address: one.state for one in status(targets, workspace.root)}


def one(workspace, address):
    return next(found for found in status((), workspace.root) if found.address == address)


def not_fresh(workspace):
    return {address: state for address, state in states(workspace).items() if state is not State.FRESH}


def fingerprint(root):
    """Bytes of every file of the workspace but DVC's own scratch space, in which its lock lies."""
    files = (path for path in root.rglob("*") if path.is_file() and ".dvc/tmp" not in path.as_posix())
    return {
        str(path): (hashlib.sha256(path.read_bytes()).hexdigest(), path.stat().st_mtime_ns) for path in files
    }


def check_prediction(workspace):
    """Build, and compare what happened with what was said before, without a byte having changed."""
    before = fingerprint(workspace.root)
    said = {found.address: found.outlook for found in status((), workspace.root)}
    assert fingerprint(workspace.root) == before
    workspace.ran()
    did = {address: result.status for address, result in build(root=workspace.root).stages.items()}
    meaning = {
        Outlook.SKIP: {StageOutcome.SKIPPED},
        Outlook.RESTORE: {StageOutcome.RESTORED},
        Outlook.RUN: {StageOutcome.RAN, StageOutcome.FAILED},
        Outlook.PERHAPS: set(StageOutcome),
    }
    assert {a: (said[a], did[a]) for a in said if did[a] not in meaning[said[a]]} == {}
    return said


def test_never_built_then_fresh(workspace):
    assert set(states(workspace).values()) == {State.NEVER}
    assert set(check_prediction(workspace).values()) == {Outlook.RUN}
    assert set(states(workspace).values()) == {State.FRESH}
    assert set(check_prediction(workspace).values()) == {Outlook.SKIP}
    assert list(states(workspace, "solve@mug")) == ["prepare@mug", "solve@mug"]


def test_changed_parameter_is_named_with_both_values(workspace):
    build(root=workspace.root)
    workspace.params(mug={"material": "glass"})
    assert not_fresh(workspace) == {"solve@mug": State.STALE, "pack@mug": State.UPSTREAM}
    assert one(workspace, "solve@mug").reasons == ("objects.mug.material: steel -> glass",)
    assert one(workspace, "pack@mug").waits_for == ("solve@mug",)
    said = check_prediction(workspace)
    assert (said["solve@mug"], said["pack@mug"]) == (Outlook.RUN, Outlook.PERHAPS)


def test_what_the_run_cache_has_is_known_to_come_back_all_the_way_down(workspace):
    build(root=workspace.root)
    workspace.params(mug={"material": "glass"})
    build(root=workspace.root)
    workspace.params()
    said = check_prediction(workspace)
    assert (said["solve@mug"], said["pack@mug"]) == (Outlook.RESTORE, Outlook.RESTORE)
    assert workspace.ran() == []


@pytest.mark.parametrize("lost", [["build", "metrics"], ["build", "metrics", "dvc.lock"]])
def test_outputs_that_are_all_lost_are_known_to_come_back(workspace, lost):
    build(root=workspace.root)
    workspace.ran()
    for name in lost:
        path = workspace.root / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert set(check_prediction(workspace).values()) == {Outlook.RESTORE}
    assert workspace.ran() == []


@pytest.mark.parametrize(
    "harm",
    [
        lambda entry: entry.write_text(entry.read_text().partition("outs:")[0]),
        lambda entry: entry.write_text(entry.read_text().replace("steps pack", "steps  pack")),
        lambda entry: entry.write_bytes(b"\xff"),
        lambda entry: entry.write_bytes(bytes(100)),
        Path.unlink,
    ],
    ids=["cut off", "changed", "not UTF-8", "zeros", "gone"],
)
@pytest.mark.parametrize("locked", [True, False])
def test_a_damaged_saved_run_is_removed_by_a_build_only(workspace, harm, locked):
    build(root=workspace.root)
    workspace.ran()
    runs = [path for path in (workspace.root / ".dvc/cache/runs").glob("*/*/*") if path.is_file()]
    (entry,) = (path for path in runs if "steps pack mug" in path.read_text())
    harm(entry)
    (workspace.root / "build/mug/pack.txt").unlink()
    if not locked:
        (workspace.root / "dvc.lock").unlink()
    before = fingerprint(workspace.root)
    said = states(workspace)
    assert said["pack@mug"] is (State.MISSING if locked else State.NEVER)
    assert fingerprint(workspace.root) == before
    check_prediction(workspace)
    assert workspace.ran() == ([] if locked else ["pack@mug"])
    assert set(states(workspace).values()) == {State.FRESH}


def test_damaged_files_of_dvc_outside_the_workspace_are_named(workspace):
    build(root=workspace.root)
    with open_repository(workspace.root) as repository:
        site = Path(repository.repo.site_cache_dir)
    kept = [path for path in site.rglob("cache.db") if path.is_file()]
    assert kept
    for path in kept:
        for log in path.parent.glob("cache.db-*"):
            log.unlink()
        path.write_bytes(b"damaged" * 1000)
    for command in (states, lambda w: build(root=w.root)):
        refused(re.escape(f"its databases in {site.parents[1]}"), command, workspace)
    shutil.rmtree(site)
    assert set(states(workspace).values()) == {State.FRESH}


def test_changed_dependency_and_command(workspace):
    build(root=workspace.root)
    with (workspace.root / "steps.py").open("a") as stream:
        stream.write("# a comment\n")
    assert one(workspace, "prepare@bowl").reasons == ("steps.py changed",)
    pipeline = workspace.root / "dvc.yaml"
    pipeline.write_text(pipeline.read_text().replace("steps pack ${key}", "steps  pack ${key}"))
    assert one(workspace, "pack@bowl").reasons == ("its command changed",)
    assert one(workspace, "pack@bowl").waits_for == ("prepare@bowl", "solve@bowl")
    check_prediction(workspace)


def test_missing_and_changed_outputs(workspace):
    build(root=workspace.root)
    (workspace.root / "build/mug/prepare.txt").unlink()
    (workspace.root / "build/bowl/solve/a.txt").write_text("other")
    (workspace.root / "metrics/bell.json").unlink()
    assert not_fresh(workspace) == {
        "prepare@mug": State.MISSING,
        "solve@bowl": State.STALE,
        "pack@bell": State.MISSING,
    }
    assert one(workspace, "prepare@mug").reasons == ("build/mug/prepare.txt is missing",)
    assert one(workspace, "solve@bowl").reasons == ("build/bowl/solve changed",)
    said = check_prediction(workspace)
    assert [said[a] for a in ("prepare@mug", "solve@bowl", "pack@bell")] == [Outlook.RESTORE] * 3
    shutil.rmtree(workspace.root / ".dvc/cache/files")
    assert set(not_fresh(workspace)) == set(everything())
    assert "gone from the cache" in one(workspace, "solve@mug").reasons[0]
    check_prediction(workspace)


def test_failure_is_remembered_until_an_input_changes_or_it_succeeds(workspace):
    build(root=workspace.root)
    workspace.control("solve@mug", "fail")
    workspace.params(mug={"material": "glass"})
    build(root=workspace.root)
    found = one(workspace, "solve@mug")
    assert found.state is State.FAILED
    assert found.reasons[0] == "the command exited with code 3; the reason of the failure"
    assert found.log.endswith("build/.logs/solve@mug.log")
    assert one(workspace, "pack@mug").state is State.UPSTREAM

    workspace.params(mug={"material": "wood"})
    assert one(workspace, "solve@mug").state is State.STALE
    workspace.params(mug={"material": "glass"})
    assert one(workspace, "solve@mug").state is State.FAILED
    workspace.control("solve@mug", None)
    assert build(root=workspace.root).ok
    assert not_fresh(workspace) == {}
    assert not list((workspace.root / "build/.logs").glob("*.failed"))


def test_changed_and_missing_data(make_workspace):
    workspace = make_workspace(
        "stages:\n  copy: {cmd: cp data.txt out.txt, deps: [data.txt], outs: [out.txt]}\n"
    )
    data = workspace.root / "data.txt"
    data.write_text("one")
    workspace.dvc("add", "-q", "data.txt")
    build(root=workspace.root)
    assert set(states(workspace).values()) == {State.FRESH}
    data.unlink()
    assert not_fresh(workspace) == {"data.txt.dvc": State.MISSING}
    assert one(workspace, "data.txt.dvc").outlook is Outlook.RESTORE
    assert build(root=workspace.root).stages["copy"].status is StageOutcome.SKIPPED
    data.unlink()
    data.write_text("two")
    assert not_fresh(workspace) == {"data.txt.dvc": State.STALE, "copy": State.UPSTREAM}
    assert one(workspace, "copy").outlook is Outlook.RUN
    check_prediction(workspace)


def printed(show, found, width=100, **options):
    console = Console(file=io.StringIO(), width=width, no_color=True, **options)
    show(found, console)
    return console.file.getvalue()


@pytest.mark.parametrize("terminal", [False, True])
def test_printed(workspace, terminal):
    build(root=workspace.root)
    workspace.params(mug={"material": "glass"})
    found = status((), workspace.root)
    shows = (print_table, print_details, print_outlook)
    table, details, outlook = (printed(show, found, force_terminal=terminal) for show in shows)
    assert "mug" in table
    assert "bowl" not in table
    assert "7 stages fresh, 1 stale, 1 upstream stale; 2 of 3 objects complete\n" in table
    assert "objects.mug.material: steel -> glass" in table
    assert "    objects.mug.material: steel -> glass" in details
    assert "solve@mug  objects.mug.material: steel -> glass" in outlook
    assert details.endswith("\n7 stages fresh, 1 stale, 1 upstream stale\n")
    assert outlook.endswith("\n7 up to date, 1 to run, 1 perhaps to run\n")
    entries = {entry["address"]: entry for entry in json.loads(json.dumps(as_json(found)))}
    assert entries["solve@mug"]["state"] == "stale"
    assert entries["solve@mug"]["object"] == "mug"


def test_splits_of_benchmarks_are_no_objects():
    addresses = ("pack@mug", "evaluate@mug", "pack@bell", "recognize@seen")
    found = [StageStatus(address, State.FRESH, Outlook.SKIP) for address in addresses]
    assert printed(print_table, found) == "4 stages fresh; 2 of 2 objects complete\n"


@pytest.mark.parametrize(
    ("states", "counts"),
    [
        (("never built",) * 12 + ("fresh",), "12 stages never built; no object is complete"),
        (("fresh", "failed", "fresh"), "1 stage fresh, 1 failed; no object is complete"),
        (("fresh", "fresh", "fresh"), "2 stages fresh; 1 of 1 object complete"),
        (("fresh", "stale"), "1 stage fresh, 1 source stale; 1 of 1 object complete"),
        (
            ("missing",),
            f"no stages, 1 source missing; {NO_OBJECTS}",
        ),
    ],
)
def test_a_source_is_no_stage(states, counts):
    """The last one is the .dvc file of an added mesh."""
    addresses = [*(f"stage_{i}@mug" for i in range(len(states) - 1)), "data/objects/mug.dvc"]
    found = [StageStatus(address, State(state), Outlook.SKIP) for address, state in zip(addresses, states)]
    assert counts in printed(print_table, found).splitlines()


def test_a_dry_run_counts_no_source_that_is_up_to_date():
    states = {"data/objects/mug.dvc": Outlook.SKIP, "hash_code": Outlook.RUN, "pack@mug": Outlook.SKIP}
    found = [StageStatus(address, State.FRESH, outlook) for address, outlook in states.items()]
    assert printed(print_outlook, found).endswith("\n1 up to date, 1 to run\n")
    found = [StageStatus("data/objects/mug.dvc", State.STALE, Outlook.RUN)]
    assert printed(print_outlook, found).endswith("\n1 to run\n")


def test_what_is_of_no_object_is_no_row_of_the_table():
    addresses = ("hash_code", "pack@anvil", "pack@mug")
    text = printed(print_table, [StageStatus(address, State.NEVER, Outlook.RUN) for address in addresses])
    lines = [line.split() for line in text.splitlines()]
    assert lines[:4] == [["-", "hash_code", "never", "built"], ["pack"], ["anvil", "-"], ["mug", "-"]]


def test_without_objects_it_says_how_to_add_one():
    found = [StageStatus("hash_code", State.NEVER, Outlook.RUN)]
    assert printed(print_table, found, width=60).splitlines() == [
        "- hash_code  never built",
        f"1 stage never built; {NO_OBJECTS}",
    ]


def test_a_directory_of_outputs_that_come_back_is_predicted(template, tmp_path):
    root = shutil.copytree(template.parent, tmp_path / "copy") / template.name
    start = tiny_project.Sources()
    for sources in (start.with_parameter(("objects", "bell", "wall"), 0.5), start):
        (root / "params.yaml").write_text(sources.params())
        said = {one.address: one.outlook for one in status(root=root)}
        did = {address: one.status for address, one in build(root=root).stages.items()}
    stages = ("normalize@bell", "observe@bell", "recognize")
    assert {said[address] for address in stages} == {Outlook.RESTORE}
    assert {did[address] for address in stages} == {StageOutcome.RESTORED}
    assert said["normalize@mug"] == Outlook.SKIP


@pytest.mark.parametrize("name", ["dvc.lock", "dvc.yaml", "params.yaml"])
def test_a_merge_conflict_is_named_with_its_line_and_a_remedy(workspace, name):
    assert build(root=workspace.root).ok
    lines = (workspace.root / name).read_text().splitlines(keepends=True)
    (workspace.root / name).write_text("".join([*lines[:2], "<<<<<<< HEAD\n", *lines[2:]]))
    message = rf"{name}, line 3 has a merge conflict of Git; keep one side, .*git checkout --ours \S*{name}"
    refused(message, status, (), workspace.root)
