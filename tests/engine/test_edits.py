"""Edits while a stage runs: what is recorded is what it has read."""

import os
import shutil
from dataclasses import dataclass
from functools import partial

import pytest

from objectfolder.engine.build import build, local_workers
from objectfolder.engine.status import State, status
from objectfolder.engine.summary import Disturbed, Lost, StageOutcome
from objectfolder.engine.workers import WorkerLost

from .conftest import Workspace
from .processes import meanwhile, wait_for

#: Writes what it reads, between two points at which a test may edit; runs through if both have passed.
PIPELINE = """
stages:
  record:
    cmd: mkdir -p build/.code && sha256sum code.sh > build/.code/copy.sha256
    deps: [code.sh]
    outs: [build/.code]
  copy:
    cmd: sh -c "$(cat code.sh)"
    deps: [build/.code/copy.sha256, source, profile.yaml]
    params: [objects.mug.size, objects.mug.material]
    outs: [build/read]
"""
CODE = """
echo run >> calls
touch started
until [ -e edited ]; do sleep 0.02; done
grep "  mug:" "${OBJECTFOLDER_PARAMS:-params.yaml}" > build/part
cat source/* profile.yaml >> build/part
mv build/part build/read
touch read
until [ -e reverted ]; do sleep 0.02; done
"""
FILES = ("source/mesh.obj", "profile.yaml", "code.sh")


@pytest.fixture
def copying(make_workspace) -> Workspace:
    workspace = make_workspace(PIPELINE)
    (workspace.root / "source").mkdir()
    for name, text in zip(FILES, ("mesh\n", "profile\n", CODE)):
        (workspace.root / name).write_text(text)
    return workspace


@dataclass
class Editing:
    """Builds `PIPELINE`, and edits before and after the stage reads."""

    workspace: Workspace  #: the workspace
    options: dict  #: further arguments of `build`

    def build(self, edit, revert=lambda: None):
        """Build; return the summary and the events."""
        root = self.workspace.root

        def work():
            for action, before, after in ((edit, "started", "edited"), (revert, "read", "reverted")):
                wait_for((root / before).exists)
                action()
                (root / after).touch()

        events = []
        with meanwhile(work):
            summary = build(root=root, on_event=events.append, **self.options)
        return summary, [event for event in events if isinstance(event, Disturbed | Lost)]

    @property
    def output(self) -> str:
        """What the stage has written."""
        return (self.workspace.root / "build/read").read_text()

    @property
    def runs(self) -> int:
        """Number of runs so far."""
        return (self.workspace.root / "calls").read_text().count("run")

    def rebuilt(self) -> str:
        """Output that comes back from the run cache after everything else is lost."""
        shutil.rmtree(self.workspace.root / "build")
        (self.workspace.root / "dvc.lock").unlink()
        runs = self.runs
        assert build(root=self.workspace.root).ok
        assert self.runs == runs
        return self.output


def check_reverted_edit_of_params(editing: Editing) -> None:
    """The values are those that were recorded, and the next build has nothing to do."""
    edit = partial(editing.workspace.params, mug={"size": 30}, bowl={"size": 7})
    summary, disturbed = editing.build(edit, editing.workspace.params)
    assert summary.ok
    assert (editing.runs, disturbed) == (1, [])
    assert "size: 1," in editing.output
    editing.workspace.check_clean()
    assert build(root=editing.workspace.root).counts()[StageOutcome.SKIPPED] == 2
    assert "size: 1," in editing.rebuilt()


def check_reverted_edit_of_a_file(editing: Editing, name: str) -> None:
    """Nothing of the run is kept, not even if the file looks as before; the next run counts."""
    path = editing.workspace.root / name
    text, times = path.read_text(), path.stat()

    def revert():
        path.write_text(text)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))

    summary, disturbed = editing.build(partial(path.write_text, text[::-1]), revert)
    assert summary.ok
    assert (editing.runs, disturbed) == (2, [Disturbed("copy", [name])])
    assert editing.output.endswith("mesh\nprofile\n")
    editing.workspace.check_clean()
    assert build(root=editing.workspace.root).counts()[StageOutcome.SKIPPED] == 2
    assert editing.rebuilt().endswith("mesh\nprofile\n")


def test_reverted_edit_of_params_is_not_read(copying):
    check_reverted_edit_of_params(Editing(copying, {}))


@pytest.mark.parametrize("name", FILES)
def test_reverted_edit_of_a_file_does_not_count(copying, name):
    check_reverted_edit_of_a_file(Editing(copying, {}), name)


def test_edit_of_params_is_for_the_next_build(copying):
    editing = Editing(copying, {})
    summary, _ = editing.build(partial(copying.params, mug={"size": 30}))
    assert summary.ok
    assert editing.runs == 1
    assert "size: 1," in editing.output
    found = {stage.address: stage for stage in status(root=copying.root)}
    assert found["copy"].state is State.STALE
    assert found["copy"].reasons == ("objects.mug.size: 1 -> 30",)
    assert build(root=copying.root).ok
    assert "size: 30," in editing.output
    copying.params()
    assert build(root=copying.root).counts()[StageOutcome.RESTORED] == 1
    assert "size: 1," in editing.output


def test_edit_of_another_object_disturbs_nothing(copying):
    editing = Editing(copying, {})
    summary, disturbed = editing.build(partial(copying.params, bowl={"size": 7}))
    assert summary.ok
    assert (editing.runs, disturbed) == (1, [])
    copying.check_clean()
    assert build(root=copying.root).counts()[StageOutcome.SKIPPED] == 2


@pytest.mark.parametrize(
    ("edit", "named", "expected"),
    [
        (lambda root: (root / "profile.yaml").write_text("new\n"), "profile.yaml", "mesh\nnew\n"),
        (lambda root: (root / "source/more").write_text("more\n"), "source/more", "mesh\nmore\nprofile\n"),
        (
            lambda root: (root / "source/mesh.obj").rename(root / "source/m"),
            "source/mesh.obj",
            "mesh\nprofile\n",
        ),
    ],
    ids=["edit", "new file", "rename"],
)
def test_edit_of_a_file_is_built(copying, edit, named, expected):
    editing = Editing(copying, {})
    summary, (disturbed,) = editing.build(partial(edit, copying.root))
    assert summary.ok
    assert named in disturbed.files
    assert editing.runs == 2
    assert editing.output.endswith(expected)
    copying.check_clean()
    assert editing.rebuilt().endswith(expected)


def test_edit_of_code_fails_the_stage_until_the_next_build(copying):
    editing = Editing(copying, {})
    code = copying.root / "code.sh"
    summary, disturbed = editing.build(
        partial(code.write_text, CODE.replace(">> build/part", ">>build/part"))
    )
    assert disturbed == [Disturbed("copy", ["code.sh"])]
    (failure,) = summary.failures
    assert failure.address == "copy"
    assert failure.error == "code.sh was edited after this build had recorded the code; build again"
    assert copying.locked() == {"record"}
    assert build(root=copying.root).ok
    copying.check_clean()
    code.write_text(CODE)
    assert [r.address for r in build(root=copying.root).with_status(StageOutcome.RAN)] == ["copy"]


def test_failure_of_a_stage_whose_input_changed_does_not_count(copying):
    (copying.root / "code.sh").write_text(CODE + "grep profile build/read || exit 3\n")
    profile = copying.root / "profile.yaml"
    summary, disturbed = Editing(copying, {}).build(
        partial(profile.write_text, "half\n"), partial(profile.write_text, "profile\n")
    )
    assert summary.ok
    assert disturbed == [Disturbed("copy", ["profile.yaml"])]


def test_input_that_always_changes_is_named_and_nothing_is_saved(make_workspace):
    workspace = make_workspace(
        "stages: {own: {cmd: 'cat in > out; echo more >> in; echo run >> calls', deps: [in], outs: [out]}}\n"
    )
    (workspace.root / "in").write_text("now\n")
    (failure,) = build(root=workspace.root).failures
    assert (
        failure.error
        == "none of its 4 runs counts; of the last, in changed while it ran; stop what writes there"
    )
    assert (workspace.root / "calls").read_text() == "run\n" * 4
    assert not (workspace.root / "dvc.lock").exists()
    assert not list((workspace.root / ".dvc/cache").rglob("runs/??/*"))


def test_new_links_to_an_input_that_a_linked_cache_shares_are_no_edits(copying):
    profile = copying.root / "profile.yaml"
    os.link(profile, copying.root / "cached")
    editing = Editing(copying, {})
    summary, disturbed = editing.build(partial(os.link, profile, copying.root / "another"))
    assert summary.ok
    assert (editing.runs, disturbed) == (1, [])


def test_stage_that_runs_again_does_not_get_the_outputs_of_other_parameters(workspace):
    def losing(jobs, finished):
        workers = local_workers(jobs, finished)
        submit = workers.submit

        def lose(address, command, needs):
            workers.machine.take(address, needs)
            workers.submit = submit
            workers.finish = give
            finished.put((address, WorkerLost("a test says so")))

        def give(address):
            del workers.finish
            workers.machine.give(address)

        workers.submit = lose
        return workers

    build(["prepare@mug"], root=workspace.root)
    workspace.params(mug={"size": 2})
    summary = build(["prepare@mug"], root=workspace.root, make_workers=losing)
    assert summary.stages["prepare@mug"].status is StageOutcome.RAN
    assert (workspace.root / "build/mug/prepare.txt").read_text() == "2"
