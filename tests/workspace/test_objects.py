"""What `add` copies is what DVC stores."""

import re
import shutil
from pathlib import Path

import pytest
import trimesh

from objectfolder.base import materials
from objectfolder.base.errors import ObjectFolderError
from objectfolder.engine.dvc.repository import open_repository, track
from objectfolder.workspace import params
from objectfolder.workspace.examine import Candidate, examine
from objectfolder.workspace.objects import add_catalogue, add_mesh, check_new

MATERIALS = Path(materials.__file__).with_suffix("")
SHAPE = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def write_mesh(folder, name="box.obj", library="m.mtl", texture=None):
    """An .obj whose material refers to a texture that the loader does not read."""
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"mtllib {library}\n" + SHAPE)
    if not (folder / library).exists():
        (folder / library).parent.mkdir(parents=True, exist_ok=True)
        (folder / library).write_text("newmtl a\nKd 1 1 1\n" + (f"map_Ks {texture}\n" if texture else ""))
    if texture:
        (folder / texture).parent.mkdir(parents=True, exist_ok=True)
        (folder / texture).write_text("*\n")
    return folder / name


def files(root):
    """All files of a workspace but DVC's own database, with their contents."""
    inside = (p for p in root.rglob("*") if p.is_file() and not {".dvc", ".git"} & set(p.parts))
    return {p.relative_to(root): p.read_bytes() for p in inside}


def refused(mesh, key="crate", **options):
    """The error of an `add` that changes nothing."""
    root = Path.cwd()
    before = files(root)
    options = {"material": "wood", "track": track, **options}
    with pytest.raises(ObjectFolderError) as caught:
        add_mesh(mesh, key, scale=0.1, up=None, **options)
    assert files(root) == before
    assert key not in params.read()["objects"]
    return str(caught.value)


@pytest.mark.parametrize(
    "name",
    [
        *(".dvcignore", ".gitignore", ".DVCIgnore", "skin.dvc", "Skin.DVC", "dvc.yaml", "DVC.lock"),
        *(".dvc/config", ".git/config", "maps/.dvcignore", "maps/dvc.yaml", "a.dvc/skin.png", ".hidden.png"),
    ],
)
def test_names_that_are_reserved_are_refused(workspace, tmp_path, name):
    def never(*arguments):
        raise AssertionError("something was written")

    mesh = write_mesh(tmp_path / "source", texture=name)
    assert f"refers to {name}, a name that is reserved" in refused(mesh, track=never)
    with pytest.raises(ObjectFolderError, match="a name that is reserved"):  # so a dry run says it, too
        examine(Candidate("crate", mesh, "wood"), params.read(), 0.1, None)


def test_a_material_of_ones_own_is_copied_and_named(workspace, tmp_path):
    olive = tmp_path / "olive.yaml"
    olive.write_text((MATERIALS / "wood.yaml").read_text())
    mesh = write_mesh(tmp_path / "source")
    assert "no DVC" in refused(mesh, material=str(olive), track=fail)
    for key in ("crate", "box"):  # the second finds the copy
        assert add_mesh(mesh, key, str(olive), 0.1, None, track=track)["material"] == "materials/olive.yaml"
    assert Path("materials/olive.yaml").read_text() == olive.read_text()
    assert params.read()["objects"]["box"]["material"] == "materials/olive.yaml"
    olive.write_text(olive.read_text().replace("750", "751"))
    assert "is another material than" in refused(mesh, "other", material=str(olive))
    with pytest.raises(ObjectFolderError, match=r"material: .* expected a file in materials/"):
        params.object_entry(
            "box", {"objects": {"box": params.read()["objects"]["box"] | {"material": "x.yaml"}}}
        )


def fail(*arguments):
    raise ObjectFolderError("no DVC")


def test_what_voxelize_refuses_is_refused_before_it_is_added(workspace, tmp_path):
    """A closed solid, but thinner than any grid resolves."""
    needle = tmp_path / "needle.obj"
    mesh = trimesh.creation.box([0.3, 0.0016, 0.0016])
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.5, [1, 2, 3]))
    mesh.export(needle)
    values = params.read()
    values["voxelize"]["sdf_resolution"] = 64
    with pytest.raises(ObjectFolderError, match=r"needle: .*thin"):
        examine(Candidate("needle", needle, "steel"), values, None, None)


@pytest.mark.parametrize(
    ("library", "texture", "more", "said"),
    [
        *(("m.mtl", name, None, f"refers to {name}, a name that") for name in ("mesh.obj", "Mesh.OBJ")),
        *(("m.mtl", name, None, f"refers to {name}, a name that") for name in ("SOURCE.txt", "source.TXT")),
        ("mesh.obj", None, None, "box.obj gets in the workspace; rename it"),
        ("m.mtl", "Skin.png", "skin.png", "refers to skin.png, a name that"),  # another, but for its case
        (
            *("m.mtl", "Mesh.obj/skin.png", None),
            "refers to Mesh.obj/skin.png, in a folder that has the name of a file",
        ),
    ],
)
def test_no_reference_has_a_name_that_is_given(workspace, tmp_path, library, texture, more, said):
    note = tmp_path / "SOURCE.txt"
    note.write_text("licence")
    mesh = write_mesh(tmp_path / "source", library=library, texture=texture)
    if more:
        (mesh.parent / more).write_text("another")
        with (mesh.parent / library).open("a") as stream:
            stream.write(f"map_Ka {more}\n")
    assert said in refused(mesh, attachments=[note])


@pytest.mark.parametrize("name", ["mesh.obj", "box.obj"])
def test_a_mesh_that_names_itself_is_copied(workspace, tmp_path, name):
    mesh = write_mesh(tmp_path / "source", name, library=name)
    add_mesh(mesh, "crate", "wood", 0.1, None, track=track)
    copies = {p.name for p in Path("data/objects/crate").iterdir()}
    assert copies == {"mesh.obj", name}
    assert Path("data/objects/crate/mesh.obj").read_bytes() == mesh.read_bytes()


def test_a_file_that_dvc_does_not_store_undoes_the_addition(workspace, tmp_path):
    """The workspace's own .dvcignore has this name."""
    mesh = write_mesh(tmp_path / "source", texture="__pycache__/skin.png")
    assert "DVC did not store" in refused(mesh)
    assert not list(Path("data/objects").glob("*crate*"))


def test_a_file_that_changes_while_it_is_stored_undoes_the_addition(workspace, tmp_path):
    mesh = write_mesh(tmp_path / "source", texture="skin.png")

    def track_then_edit(path, root):
        from dvc.repo import Repo

        real = Repo.add

        def edited(self, *arguments):
            stages = real(self, *arguments)
            copy = path.resolve() / "skin.png"
            copy.unlink()
            copy.write_text("changed")
            return stages

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Repo, "add", edited)
            track(path, root)

    assert "DVC did not store" in refused(mesh, track=track_then_edit)


def test_what_is_stored_comes_back(workspace, tmp_path):
    mesh = write_mesh(tmp_path / "source", texture="maps/skin.png")
    add_mesh(mesh, "crate", "wood", 0.1, None, track=track)
    home = Path("data/objects/crate")
    before = files(home)
    assert set(map(str, before)) == {"mesh.obj", "m.mtl", "maps/skin.png"}
    for path in before:
        (home / path).unlink()
    with open_repository() as repository:
        repository.repo.checkout(["data/objects/crate.dvc"])
    assert files(home) == before


def test_a_record_that_is_there_is_not_overwritten(workspace, tmp_path):
    """Its data may be in a remote alone."""
    Path("data/objects").mkdir(parents=True)
    Path("data/objects/crate.dvc").write_text("outs: []\n")
    message = refused(write_mesh(tmp_path / "source"))
    assert message == (
        "object 'crate' exists already; choose another name, or remove it: "
        "run `dvc remove --outs data/objects/crate.dvc`"
    )


@pytest.mark.parametrize(
    ("there", "remedy"),
    [
        ("folder", "delete the folder data/objects/crate"),
        ("objects", "delete objects.crate from params.yaml"),
        ("procedural", "delete procedural.crate from params.yaml"),
        (
            "all",
            "delete objects.crate and procedural.crate from params.yaml, then delete the folder "
            "data/objects/crate",
        ),
    ],
)
def test_what_is_in_the_way_of_a_new_object_is_named(workspace, tmp_path, there, remedy):
    groups = ("objects", "procedural")
    values = {group: {"crate": {}} if there in (group, "all") else {} for group in groups}
    if there in ("folder", "all"):
        Path("data/objects/crate").mkdir(parents=True)
    with pytest.raises(ObjectFolderError, match=rf"exists already; .* or remove it: {remedy}$"):
        check_new("crate", values)


def write_catalogue(procedural):
    entry = "{mesh: data/objects/crate/mesh.glb, material: wood, scale: 0.1, up: y}"
    Path("new.yaml").write_text(f"procedural:\n{procedural}\nobjects:\n  crate: {entry}\n")


def test_a_record_that_is_there_is_not_in_the_way_of_a_generated_mesh(workspace):
    """DVC would refuse the whole workspace: two owners of one path."""
    before = Path("params.yaml").read_text()
    Path("data/objects").mkdir(parents=True)
    Path("data/objects/crate.dvc").write_text("outs: []\n")
    write_catalogue("  crate: {generator: die}")
    with pytest.raises(ObjectFolderError, match=r"`dvc remove --outs data/objects/crate\.dvc` if they"):
        add_catalogue(Path("new.yaml"))
    assert Path("params.yaml").read_text() == before
    Path("data/objects/crate.dvc").unlink()
    assert add_catalogue(Path("new.yaml")) == ["crate"]


def test_files_that_a_generated_mesh_would_replace_are_kept(workspace):
    """DVC removes what is where an output will be."""
    write_catalogue("  crate: {generator: die}")
    Path("data/objects/crate").mkdir(parents=True)
    Path("data/objects/crate/notes.txt").write_text("mine")
    with pytest.raises(ObjectFolderError, match="would replace the files in data/objects/crate"):
        add_catalogue(Path("new.yaml"))
    Path("dvc.lock").write_text("schema: '2.0'\nstages:\n  generate@crate:\n    cmd: x\n")
    assert add_catalogue(Path("new.yaml")) == ["crate"]  # of an earlier build


def test_a_catalogue_of_meshes_that_are_not_there_is_refused(workspace):
    write_catalogue("  {}")
    with pytest.raises(ObjectFolderError, match=r"objects\.crate: its mesh .* does not exist"):
        add_catalogue(Path("new.yaml"))
    Path("data/objects/crate").mkdir(parents=True)
    Path("data/objects/crate/mesh.glb").touch()
    assert add_catalogue(Path("new.yaml")) == ["crate"]


@pytest.mark.parametrize("length", [64, 65, 300])
def test_long_keys(workspace, tmp_path, length):
    mesh = write_mesh(tmp_path / "source")
    key = "k" * length
    if length == 64:
        add_mesh(mesh, key, "wood", 0.1, None, track=track)
        assert key in params.read()["objects"]
        return
    message = refused(mesh, key)
    assert f"is not a valid object key (it has {length} characters); expected a letter" in message
    assert len(message) < 300
    Path("params.yaml").write_text(Path("params.yaml").read_text().replace("\n  mug: {", f"\n  {key}: {{"))
    with pytest.raises(ObjectFolderError, match=rf"params\.yaml: objects: .*it has {length} characters"):
        params.read()


def test_edits_by_others_while_a_mesh_is_added_stay(workspace, tmp_path):
    def meanwhile(home, root):
        add_mesh(write_mesh(tmp_path / "second"), "second", "wood", 0.2, None, track=track)
        path = root / params.PARAMS_FILE
        path.write_text(re.sub(r"(?m)^seed: \d+", "seed: 7", path.read_text()))
        track(home, root)

    add_mesh(write_mesh(tmp_path / "first"), "first", "wood", 0.1, None, track=meanwhile)
    values = params.read()
    assert {"first", "second"} < set(values["objects"])
    assert values["seed"] == 7


@pytest.mark.parametrize("name", ["crate", "crate.dvc"])
def test_a_link_to_nothing_is_in_the_way(workspace, tmp_path, name):
    Path("data/objects").mkdir(parents=True, exist_ok=True)
    Path("data/objects", name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ObjectFolderError, match="object 'crate' exists already"):
        add_mesh(write_mesh(tmp_path / "source"), "crate", "wood", 0.1, None, track=track)
    assert not (tmp_path / "elsewhere").exists()


def test_what_another_process_added_under_the_same_name_stays(workspace, tmp_path, monkeypatch):
    copy, calls = shutil.copyfile, []

    def late(source, target):
        calls.append(source)
        if len(calls) == 1:
            add_mesh(write_mesh(tmp_path / "theirs"), "crate", "wood", 0.2, None, track=track)
            Path(target).parent.mkdir(parents=True, exist_ok=True)
        return copy(source, target)

    monkeypatch.setattr(shutil, "copyfile", late)
    with pytest.raises(ObjectFolderError, match="cannot add crate"):
        add_mesh(write_mesh(tmp_path / "mine"), "crate", "steel", 0.1, None, track=track)
    assert params.read()["objects"]["crate"]["material"] == "wood"
    assert Path("data/objects/crate/mesh.obj").is_file()
    assert Path("data/objects/crate.dvc").is_file()


def test_a_catalogue_brings_masses(workspace):
    mesh = Path("data/objects/crate/mesh.glb")
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    entry = "mesh: data/objects/crate/mesh.glb, material: wood, scale: 0.1, up: y, wall: null, bridge: all"
    catalogue, path = Path("new.yaml"), Path("params.yaml")
    catalogue.write_text(f"procedural: {{}}\nobjects:\n  crate: {{{entry}, mass: 0.2}}\n")
    assert add_catalogue(catalogue) == ["crate"]
    assert params.read()["objects"]["crate"]["mass"] == 0.2
    assert add_catalogue(catalogue) == []
    catalogue.write_text(f"procedural: {{}}\nobjects:\n  crate: {{{entry}}}\n")
    with pytest.raises(ObjectFolderError, match=r"objects\.crate differs from the one in params\.yaml"):
        add_catalogue(catalogue)
    path.write_text(path.read_text().replace("mass: 0.2", "mass: null"))
    assert add_catalogue(catalogue) == []
    catalogue.write_text(
        f"procedural: {{}}\nobjects:\n  box: {{{entry.replace('crate', 'box')}, mass: 200}}\n"
    )
    with pytest.raises(
        ObjectFolderError, match=r"objects\.box: mass is 200 kg, in the cube .*: 0\.2 for 200 g"
    ):
        add_catalogue(catalogue)
