"""Workspaces that hold no package."""

import hashlib
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from refusals import refused
from ruamel.yaml import YAML

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import requirement
from objectfolder.cli import app
from objectfolder.engine.dvc.repository import open_repository, start_repository
from objectfolder.engine.status import Outlook, status
from objectfolder.workspace import creation, installed, template
from objectfolder.workspace.check import check_all
from objectfolder.workspace.code_digests import DATA, code_text, digests
from objectfolder.workspace.creation import create_workspace, upgrade_workspace
from objectfolder.workspace.installed import RECORD, changed_files, check_installed, sensor_file
from objectfolder.workspace.layout import code_list
from objectfolder.workspace.objects import add_catalogue
from objectfolder.workspace.params import read
from objectfolder.workspace.presets import default_sections
from objectfolder.workspace.template import first_requirements, next_requirements

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    root = tmp_path_factory.mktemp("made") / "cups"
    create_workspace(root, start_repository)
    return root


@pytest.fixture
def made(first, tmp_path):
    return shutil.copytree(first, tmp_path / "cups")


def graph(root):
    return YAML(typ="safe").load((root / "dvc.yaml").read_text())["stages"]


def files(root):
    return {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()}


def test_it_holds_the_pipeline_and_no_package(made):
    found = files(made)
    assert {"README.md", ".gitignore", "requirements.txt", ".github/workflows/objects.yml"} <= found
    assert (made / "README.md").read_text().startswith("# cups\n")
    for folder in ("stages", "params", "catalogs"):
        own = {path.name: path.read_text() for path in (made / folder).iterdir()}
        assert own == {path.name: path.read_text() for path in (ROOT / folder).iterdir() if path.name in own}
    assert {path.stem for path in (made / "stages").glob("*.py")} == {*graph(ROOT), "__init__"}
    assert not (made / "objectfolder").exists()
    values = read(made / "params.yaml")
    check_all(values)
    assert values["objects"] == values["procedural"] == {}
    assert not any(values["benchmarks"].values())
    assert values.keys() == read(ROOT / "params.yaml").keys()
    quick = default_sections()
    assert {name: values[name] for name in quick} == quick
    assert values["seed"] == 0


def test_settings_of_a_clone_are_its_own(monkeypatch, tmp_path):
    """Another clone's objects and settings neither change the package nor enter a new workspace."""
    clone = tmp_path / "clone"
    clone.mkdir()
    for name in ("objectfolder", "stages", "params", "catalogs", "dvc.yaml", ".dvcignore"):
        (clone / name).symlink_to(ROOT / name)
    shutil.copy(ROOT / "params.yaml", clone)
    monkeypatch.setattr(installed, "INSTALLED", clone)
    before, text = installed.package_digests(), template.first_params()
    (clone / "params.yaml").write_text("seed: 7\n")
    assert installed.package_digests() == before
    assert template.first_params() == text


def test_git_takes_everything_but_what_is_built(made):
    (made / "build/mug").mkdir(parents=True)
    (made / "build/mug/visual.glb").touch()
    (made / "data/objects/mug").mkdir()
    (made / "data/objects/mug/mesh.obj").touch()
    (made / "data/objects/mug.dvc").touch()
    subprocess.run(["git", "add", "."], cwd=made, check=True)
    listed = subprocess.check_output(["git", "ls-files"], cwd=made, text=True).split()
    assert {RECORD, "dvc.yaml", "data/objects/mug.dvc", "data/objects/.gitkeep", ".dvc/config"} <= {*listed}
    assert not [name for name in listed if name.startswith(("build/", "data/objects/mug/", ".dvc/tmp"))]


def test_its_workflow_needs_no_remote(made):
    workflow = YAML(typ="safe").load((made / ".github/workflows/objects.yml").read_text())
    commands = [step.get("run", "") for step in workflow["jobs"]["build"]["steps"]]
    assert "objectfolder build" in commands
    assert not {"objectfolder build --pull", "git diff --exit-code dvc.lock"} & {*commands}


def test_each_dependency_on_the_package_is_one_on_its_digest(made):
    ours, theirs = graph(made), graph(ROOT)
    assert ours.pop("hash_code")["deps"] == ["materials", RECORD, "sensors", "stages"]
    theirs.pop("hash_code")
    of_package = 0
    for name, stage in theirs.items():
        deps = [
            code_list(dep).as_posix() if dep.startswith("objectfolder/") else dep
            for dep in stage["do"]["deps"]
        ]
        of_package += deps != stage["do"]["deps"]
        assert ours[name] == {**stage, "do": {**stage["do"], "deps": deps}}
    assert of_package > 5


def test_digests_are_those_of_the_same_code_in_a_clone(made):
    for stage in ("modal", "train_touch"):
        assert code_text(stage, made) == digests(f"stages/{stage}.py", ROOT)
    for name in DATA:
        assert code_text(name, made) == code_text(name, ROOT) != ""


def test_a_sensor_of_its_own_comes_before_the_packages(made):
    name = "objectfolder/touch/profiles/digit.yaml"
    before, all_before = code_text(name, made), code_text(DATA[2], made)
    text = sensor_file("digit", made).read_text()
    (made / "sensors/mine.yaml").write_text(text.replace("name: digit", "name: mine"))
    assert code_text(name, made) == before
    assert code_text(DATA[2], made).count("\n") == all_before.count("\n") + 1
    (made / "sensors/digit.yaml").write_text(text + "\n")
    assert sensor_file("digit", made) == made / "sensors/digit.yaml"
    assert code_text(name, made) != before


@pytest.mark.parametrize("held", ["notes.txt", ".hidden", "data"])
def test_a_folder_that_holds_files_is_refused(tmp_path, held):
    (tmp_path / "x" / held).mkdir(parents=True)
    refused(rf"x is not empty: it holds {held}", create_workspace, tmp_path / "x", start_repository)
    assert [path.name for path in (tmp_path / "x").iterdir()] == [held]


def test_a_path_with_braces_is_refused_wherever_a_workspace_is_opened(tmp_path, made):
    braced = tmp_path / "br{a}ce"
    with pytest.raises(ObjectFolderError, match=r"has braces in the name 'br\{a\}ce'.*rename the folder"):
        create_workspace(braced / "x", start_repository)
    assert not braced.exists()
    shutil.copytree(made, braced)
    with pytest.raises(ObjectFolderError, match="has braces in the name"), open_repository(braced):
        pass


def test_an_empty_repository_is_taken(tmp_path):
    subprocess.run(["git", "init", "-q", tmp_path / "x"], check=True)
    (tmp_path / "x" / "README.md").write_text("mine\n")
    create_workspace(tmp_path / "x", start_repository)
    assert (tmp_path / "x" / "README.md").read_text() == "mine\n"
    check_installed(tmp_path / "x")


def test_of_two_who_make_a_workspace_one_wins_and_nothing_of_it_goes(tmp_path, monkeypatch):
    root, lock = tmp_path / "x", creation.exclusive

    def late(folder):
        monkeypatch.setattr(creation, "exclusive", lock)
        create_workspace(root, start_repository)  # after the first has found the folder empty
        return lock(folder)

    monkeypatch.setattr(creation, "exclusive", late)
    refused("x is not empty", create_workspace, root, start_repository)
    check_installed(root)
    assert (root / ".dvc/config").is_file()


def test_a_workspace_in_another_is_refused(made):
    with pytest.raises(ObjectFolderError, match=r"inner lies in the workspace .*cups \(dvc.yaml\)"):
        create_workspace(made / "data" / "inner", start_repository)
    refused(r"params\.yaml is a file", create_workspace, made / "params.yaml", start_repository)


def test_without_git_nothing_is_left(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    refused("git is not installed", create_workspace, tmp_path / "x", start_repository)
    (tmp_path / "y").mkdir()
    refused("git is not installed", create_workspace, tmp_path / "y", start_repository)
    assert [path.name for path in tmp_path.iterdir()] == ["y"]
    assert not files(tmp_path)


def test_another_version_is_refused_until_an_upgrade(made, monkeypatch):
    """The record is that of an older package: another modal.py, no errors.py, a module that is gone."""
    check_installed(made)
    lines = (made / RECORD).read_text().splitlines(keepends=True)
    old = [line for line in lines if not line.endswith("  objectfolder/base/errors.py\n")]
    old = ["0" * 64 + line[64:] if line.endswith("/fem/modal.py\n") else line for line in old]
    (made / RECORD).write_text("".join([*old, "1" * 64 + "  objectfolder/gone.py\n"]))
    expected = ["objectfolder/base/errors.py", "objectfolder/gone.py", "objectfolder/sound/fem/modal.py"]
    assert changed_files(made) == expected
    refused(r"another version.*3 files differ .*objectfolder upgrade", check_installed, made)
    refused("another version", status, root=made)
    # Commands say so before they miss a section that older settings lack.
    settings = (made / "params.yaml").read_text()
    (made / "params.yaml").write_text(settings.replace("radiation:", "smell:"))
    monkeypatch.chdir(made)
    for words in (["status"], ["build"], ["add", str(ROOT / "catalogs" / "starter.yaml")]):
        refused("another version", app, words, standalone_mode=False)
    (made / "params.yaml").write_text(settings)
    done = upgrade_workspace(made)
    assert done.changed == tuple(expected)
    assert (done.written, done.removed, done.conflicts, done.params) == ((), (), (), ())
    assert (made / RECORD).read_text() == "".join(lines)
    assert [(one.address, one.outlook) for one in status(root=made)] == [("hash_code", Outlook.RUN)]


def record_as(made, name, text):
    """Let a file be what an older version wrote."""
    digest = hashlib.sha256(text.encode()).hexdigest()
    lines = [line for line in (made / RECORD).read_text().splitlines() if not line.endswith(f"  {name}")]
    (made / RECORD).write_text("\n".join([*lines, f"{digest}  {name}"]) + "\n")


def test_upgrade_replaces_what_nobody_edited(made):
    script, edited, own, gone = (made / f"stages/{name}.py" for name in ("modal", "pack", "evaluate", "old"))
    new = {path: path.read_text() for path in (script, edited)}
    script.write_text("# of an older version\n")
    record_as(made, "stages/modal.py", "# of an older version\n")
    gone.write_text("# removed since\n")
    record_as(made, "stages/old.py", "# removed since\n")
    edited.write_text("# edited here\n")
    record_as(made, "stages/pack.py", "# of an older version\n")
    own.write_text(own.read_text() + "# edited here, and the same in both versions\n")
    done = upgrade_workspace(made)
    assert (done.written, done.removed, done.conflicts) == (
        ("stages/modal.py",),
        ("stages/old.py",),
        ("stages/pack.py",),
    )
    assert script.read_text() == new[script]
    assert not gone.exists()
    assert edited.read_text() == "# edited here\n"
    assert Path(f"{edited}.new").read_text() == new[edited]
    assert own.read_text().endswith("both versions\n")
    again = upgrade_workspace(made)
    assert (again.written, again.removed, again.conflicts, again.changed) == ((), (), (), ())


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("# mine\nobjectfolder[build]==0.0.1\nscipy\n", "# mine\n{now}\nscipy\n"),
        (
            "objectfolder[build] @ git+https://example.org/x@abc\n",
            "objectfolder[build] @ git+https://example.org/x@abc\n",
        ),
        ("objectfolder[build] @ file:///somewhere/else\nscipy\n", "{now}\nscipy\n"),
        ("objectfolder[build,ray]==0.0.1\n", "objectfolder[build,ray]==0.0.1\n"),
        (
            "objectfolder[build] @ https://example.org/x.whl\n",
            "objectfolder[build] @ https://example.org/x.whl\n",
        ),
    ],
)
def test_upgrade_moves_the_pin_and_keeps_other_requirements(made, before, after):
    now = (made / "requirements.txt").read_text().splitlines()[-1]
    assert now.startswith("objectfolder[build]")
    (made / "requirements.txt").write_text(before)
    done = upgrade_workspace(made)
    assert (made / "requirements.txt").read_text() == after.format(now=now)
    assert done.written == (() if before == after else ("requirements.txt",))


def test_requirements_install_this_package_from_where_it_is(made, monkeypatch):
    assert (made / "requirements.txt").read_text().splitlines()[1:] == [requirement("build")]
    assert requirement("build").startswith("objectfolder[build] @ file:///")
    wheel = "objectfolder[build] @ https://example.org/{}.whl"
    assert next_requirements(wheel.format("old")) == wheel.format("old")
    monkeypatch.setattr(template, "requirement", lambda extra: wheel.format("new"))
    assert first_requirements() == wheel.format("new") + "\n"
    assert next_requirements(wheel.format("old")) == wheel.format("new")


def test_upgrade_adds_settings_and_keeps_those_that_are_there(made):
    add_catalogue(ROOT / "catalogs" / "starter.yaml", made)
    path = made / "params.yaml"
    text = path.read_text().replace("max_modes: 256", "max_modes: 8").replace("  damping: loss_factor\n", "")
    text = re.sub(r"^radiation:\n(  .*\n)+", "", text, flags=re.MULTILINE).replace(", bridge: all", "")
    path.write_text(text)
    done = upgrade_workspace(made)
    keys = read(ROOT / "catalogs" / "starter.yaml")["objects"]
    assert {*done.params} == {"modal.damping", "radiation", *(f"objects.{key}.bridge" for key in keys)}
    values, wanted = read(path), read(ROOT / "params.yaml")
    assert values["modal"] == {**wanted["modal"], "max_modes": 8}
    assert values["radiation"] == wanted["radiation"]
    assert "# mesh: path under data/objects" in path.read_text()


def test_upgrade_changes_nothing_if_settings_are_not_of_this_version(made):
    path = made / "params.yaml"
    path.write_text(path.read_text() + "smell: {nose: big}\n")
    before = {name: (made / name).read_bytes() for name in files(made)}
    refused("'smell' is not a section", upgrade_workspace, made)
    assert {name: (made / name).read_bytes() for name in files(made)} == before


def test_a_clone_is_not_upgraded(workspace):
    refused("not a workspace of `objectfolder init`", upgrade_workspace, workspace)
