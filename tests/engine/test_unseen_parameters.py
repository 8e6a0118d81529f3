"""DVC's run cache does not see parameters called ``size`` or ``nfiles``; nothing is restored wrongly."""

import re
import shutil

import pytest

from objectfolder.engine.build import build
from objectfolder.engine.status import Outlook, status
from objectfolder.engine.verify import verify

PIPELINE = """
stages:
  copy:
    cmd: cp params.yaml "{held}" && cp "{held}" read && echo run >> calls
    deps: [steps.py]
    params: [table]
    outs: [read]
  use:
    cmd: cp read used
    deps: [read]
    outs: [used]
""".replace("{held}", "held.yaml")
#: Nested as deeply as it may be, and beside others.
TEXT = "table: {{rows: [{{{name}: {value}, other: 1}}]}}\n"


@pytest.fixture(params=["size", "nfiles"])
def table(request, make_workspace):
    """A workspace with a stage that reads a parameter of such a name, and a function that sets it."""
    workspace = make_workspace(PIPELINE)

    def set_value(value):
        (workspace.root / "params.yaml").write_text(TEXT.format(name=request.param, value=value))

    set_value("one")
    return workspace, set_value


def runs(workspace):
    return (workspace.root / "calls").read_text().count("run")


def read(workspace):
    texts = {(workspace.root / name).read_text() for name in ("read", "used")}
    assert len(texts) == 1
    return texts.pop().partition(": ")[2].partition(": ")[2].partition(": ")[2].partition(",")[0]


def test_back_and_forth_gives_what_each_value_gives(table):
    workspace, set_value = table
    seen = []
    for value in ("one", "two", "one", "three", "two", "one"):
        set_value(value)
        said = {one.address: one.outlook for one in status(root=workspace.root)}
        assert build(root=workspace.root).ok
        assert read(workspace) == value
        seen.append((runs(workspace), said["copy"]))
    run, back = Outlook.RUN, Outlook.RESTORE
    assert seen == [(1, run), (2, run), (2, back), (3, run), (3, back), (3, back)]


def test_equal_outputs_of_other_values_are_saved_too(table):
    workspace, set_value = table
    pipeline = workspace.root / "dvc.yaml"
    pipeline.write_text(pipeline.read_text().replace("cp params.yaml", "echo same >"))
    for value in ("one", "two"):
        set_value(value)
        assert build(root=workspace.root).ok
    shutil.rmtree(workspace.root / ".dvc/tmp")
    (workspace.root / "dvc.lock").unlink()
    assert build(root=workspace.root).ok
    assert runs(workspace) == 2


def test_what_dvc_has_restored_wrongly_is_found_and_repaired(table):
    workspace, set_value = table
    workspace.dvc("repro")
    set_value("two")
    workspace.dvc("repro")
    assert read(workspace) == "one"  # the fault of DVC, which this engine must not take for the truth
    (finding,) = verify(root=workspace.root).findings
    assert (finding.address, finding.path) == ("copy", "dvc.lock")
    assert re.search("table.rows: .*one.* -> .*two", finding.problem)
    assert verify(["use"], workspace.root).findings == (finding,)
    assert verify(root=workspace.root, repair=True).findings == ()
    assert build(root=workspace.root).ok
    assert read(workspace) == "two"
    set_value("one")
    assert build(root=workspace.root).ok
    assert read(workspace) == "one"
    assert verify(root=workspace.root).findings == ()
