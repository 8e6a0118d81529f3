import shutil

import pytest
from refusals import refused

from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.records import recall_costs
from objectfolder.engine.summary import Finished, Planned, StageOutcome, Started

from .conftest import everything


def statuses(summary):
    return {address: str(result.status) for address, result in summary.stages.items()}


def test_builds_once_and_leaves_dvc_content(workspace):
    events = []
    summary = build(root=workspace.root, on_event=events.append)
    assert summary.ok
    assert workspace.ran() == everything()
    assert isinstance(events[0], Planned)
    assert sum(isinstance(event, Started) for event in events) == 9
    assert sum(isinstance(event, Finished) for event in events) == 9
    result = summary.stages["solve@mug"]
    assert (result.stage, result.key, result.status) == ("solve", "mug", StageOutcome.RAN)
    assert result.seconds > 0
    assert 1 < result.peak_mb < 60
    assert result.log == workspace.root / "build/.logs/solve@mug.log"
    assert "hello from solve mug" in result.log.read_text()
    cost = recall_costs(workspace.root, "mug")["solve"]
    assert cost.seconds == pytest.approx(result.seconds, abs=0.01)
    assert 0 < cost.cpu_seconds < 60

    assert "up to date" in workspace.dvc("status")
    lock = (workspace.root / "dvc.lock").read_bytes()
    assert "up to date" in workspace.dvc("repro")
    assert workspace.ran() == []

    again = build(root=workspace.root)
    assert set(statuses(again).values()) == {"skipped"}
    assert workspace.ran() == []
    assert (workspace.root / "dvc.lock").read_bytes() == lock

    forced = build(["prepare@mug"], root=workspace.root, options=BuildOptions(force=True))
    assert statuses(forced) == {"prepare@mug": "ran"}


def test_lock_file_is_the_one_dvc_writes(workspace):
    build(root=workspace.root)
    ours = (workspace.root / "dvc.lock").read_text()
    workspace.dvc("commit", "-f")
    assert (workspace.root / "dvc.lock").read_text() == ours


def test_change_of_one_object_reruns_only_what_depends_on_it(workspace):
    build(root=workspace.root)
    workspace.ran()
    workspace.params(mug={"material": "glass"})
    summary = build(root=workspace.root)
    assert workspace.ran() == ["pack@mug", "solve@mug"]
    assert summary.counts()[StageOutcome.SKIPPED] == 7
    assert "up to date" in workspace.dvc("status")


def test_stage_whose_input_comes_out_the_same_is_skipped(workspace):
    build(root=workspace.root)
    workspace.ran()
    with (workspace.root / "steps.py").open("a") as stream:
        stream.write("# a comment\n")
    build(root=workspace.root)
    assert workspace.ran() == everything("prepare")


def test_failure_blocks_its_branch_only_and_the_fix_resumes(workspace):
    workspace.control("solve@bowl", "fail")
    summary = build(root=workspace.root)
    assert not summary.ok
    (failure,) = summary.failures
    assert failure.address == "solve@bowl"
    assert "code 3" in failure.error
    assert failure.tail[-1] == "the reason of the failure"
    assert failure.log.is_file()
    assert [result.address for result in summary.with_status(StageOutcome.BLOCKED)] == ["pack@bowl"]
    assert summary.counts()[StageOutcome.RAN] == 7
    assert workspace.locked() == set(everything()) - {"solve@bowl", "pack@bowl"}
    workspace.ran()

    workspace.control("solve@bowl", None)
    assert build(root=workspace.root).ok
    assert workspace.ran() == ["pack@bowl", "solve@bowl"]


def test_missing_output_and_missing_dependency_are_failures(make_workspace):
    workspace = make_workspace(
        "stages:\n"
        "  lazy: {cmd: 'true', outs: [never.txt]}\n"
        "  orphan: {cmd: 'true', deps: [nowhere.txt], outs: [x.txt]}\n"
    )
    summary = build(root=workspace.root)
    assert "'never.txt' does not exist" in summary.stages["lazy"].error
    assert "put it there" not in summary.stages["lazy"].error
    assert "nowhere.txt does not exist; put it there" in summary.stages["orphan"].error
    assert not (workspace.root / "dvc.lock").exists()


def test_outputs_come_back_from_the_run_cache(workspace):
    build(root=workspace.root)
    workspace.ran()
    metrics = (workspace.root / "metrics/mug.json").read_bytes()

    shutil.rmtree(workspace.root / "build/mug")
    (workspace.root / "metrics/mug.json").unlink()
    summary = build(root=workspace.root)
    assert recall_costs(workspace.root, "mug") == {}  # another run wrote what there is now
    assert [result.address for result in summary.with_status(StageOutcome.RESTORED)] == [
        "prepare@mug",
        "solve@mug",
        "pack@mug",
    ]

    # An older state that the lock file no longer knows.
    workspace.params(mug={"material": "glass"})
    build(root=workspace.root)
    workspace.ran()
    workspace.params()
    (workspace.root / "dvc.lock").unlink()
    summary = build(root=workspace.root)
    assert summary.ok
    assert workspace.ran() == []
    assert "steel" in (workspace.root / "build/mug/pack.txt").read_text()
    assert (workspace.root / "metrics/mug.json").read_bytes() == metrics
    assert "up to date" in workspace.dvc("status")


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("solve@mug", ["prepare@mug", "solve@mug"]),
        ("solve", everything("prepare", "solve")),
        ("mug", ["pack@mug", "prepare@mug", "solve@mug"]),
        ("build/mug/solve/a.txt", ["prepare@mug", "solve@mug"]),
        ("build/mug/prepare.txt", ["prepare@mug"]),
    ],
)
def test_targets(workspace, target, expected):
    assert sorted(build([target], root=workspace.root).stages) == expected
    assert workspace.ran() == expected


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("solve@mugg", "did you mean.*solve@mug"),
        ("sovle", "did you mean.*solve"),
        ("mog", "did you mean.*mug"),
        ("build/mug/pack.tx", "did you mean.*build/mug/pack.txt"),
        ("zzzz", "; the objects are bell, bowl, mug; `dvc stage list`"),
    ],
)
def test_unknown_target_suggests_close_ones_or_lists_the_objects(workspace, target, said):
    refused(f"unknown target '{target}'.*{said}", build, [target], root=workspace.root)


def test_unknown_target_of_a_workspace_without_objects(make_workspace):
    root = make_workspace("stages: {}\n").root
    refused("there are no objects yet; run `objectfolder add MESH", build, ["mug"], root=root)


def test_two_jobs_overlap(workspace):
    for key in ("bell", "mug"):
        workspace.control(f"prepare@{key}", "1.5")
    build(["prepare@bell", "prepare@mug"], options=BuildOptions(jobs=2), root=workspace.root)
    kinds = [call[1] for call in workspace.calls()]
    assert kinds == ["start", "start", "end", "end"]


def test_wrong_arguments_and_workspaces(workspace, tmp_path):
    refused("jobs is 0", BuildOptions, jobs=0)
    for timeout in (-1.0, float("inf"), float("nan")):
        refused(r"expected 0 \(never\) to 1e\+08", BuildOptions, timeout=timeout)
    refused("not a directory", build, root=tmp_path / "nowhere")
    outside = tmp_path / "outside"
    outside.mkdir()
    refused(r"outside/params\.yaml does not exist; .*`objectfolder init DIR`", build, root=outside)
    (outside / "params.yaml").write_text("")
    refused("dvc init", build, root=outside)
    (workspace.root / "dvc.yaml").write_text("stages: 3\n")
    refused("cannot read the workspace", build, root=workspace.root)
    (workspace.root / "dvc.yaml").unlink()
    refused(r"no dvc\.yaml", build, root=workspace.root)
