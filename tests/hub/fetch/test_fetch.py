"""`objectfolder fetch`: a whole run against a local server, and everything that can go wrong with it."""

import json
import re
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import trimesh
from folders import contents
from publisher import addresses, box_obj, gso, polyhaven, tgz, ycb, zipped
from refusals import refused
from typer.testing import CliRunner

from objectfolder.base.download import WAITS, download_to
from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.hub.fetch import run as run_module
from objectfolder.hub.fetch.catalogue import read_catalogue
from objectfolder.hub.fetch.files import find_local
from objectfolder.hub.fetch.run import SIZE_TOLERANCE, FetchStatus, fetch_all, fetch_object, read_checksums
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.workspace import params
from objectfolder.workspace.check import check_all

CATALOGUE = Path("catalogs/objectfolder1.yaml")
OBJECTS = Path(__file__).parents[4] / "shared" / "objects"
MUG, RACER = "/025_mug_google_16k.tgz", "/BUNNY_RACER.zip"
PART = {"ycb_mug.part", "ycb_mug.part.tag"}


@pytest.fixture
def published(workspace, publisher):
    publisher.pages[MUG] = ycb("025_mug")
    publisher.pages[RACER] = gso()
    publisher.pages |= polyhaven(publisher, "Barrel_01")
    return read_catalogue(CATALOGUE, addresses(publisher))


def state():
    """Everything under data/, and the parameters."""
    return contents(Path("data")), Path("params.yaml").read_bytes()


def leftovers():
    return {p.name for p in Path("build/.fetch").iterdir()}


def check_failure(message, key, published, left=()):
    """A fetch is refused and changes nothing; returns the whole message."""
    before = state()
    error = refused(message, fetch_object, key, published)
    assert state() == before
    assert leftovers() == {*left}
    return error


def run(publisher, *arguments):
    options = [f"--url={address}" for address in addresses(publisher)]
    return CliRunner().invoke(app, ["fetch", *options, *arguments])


def test_every_layout_is_fetched_added_and_tracked(published, publisher):
    keys = ["ycb_mug", "gso_bunny_racer", "polyhaven_barrel_01"]
    results = fetch_all(keys, published)
    assert [result.status for result in results] == [FetchStatus.ADDED] * 3
    values = params.read()
    check_all(values)
    assert values["objects"]["ycb_mug"] == {
        **{"mesh": "data/objects/ycb_mug/mesh.obj", "material": "steel", "scale": 0.117, "up": "z"},
        **{"wall": None, "bridge": "all", "mass": 0.118},
    }
    assert results[0].detail.startswith("steel, 0.117 m, 0.118 kg")
    assert values["objects"]["polyhaven_barrel_01"]["up"] == "y"
    assert "mass" not in values["objects"]["polyhaven_barrel_01"]
    expected = {
        "ycb_mug": {"mesh.obj", "textured.mtl", "texture_map.png"},
        "gso_bunny_racer": {"mesh.obj", "model.mtl", "texture.png"},
        "polyhaven_barrel_01": {"mesh.gltf", "Barrel_01.bin", "textures/Barrel_01_diff_1k.png"},
    }
    for key, files in expected.items():
        home = Path("data/objects") / key
        assert contents(home).keys() == {*files, "SOURCE.txt"}
        assert home.with_suffix(".dvc").exists()
        text = (home / "SOURCE.txt").read_text()
        assert published.objects[key].name in text
        assert published.url(key) in text
        entry = values["objects"][key]
        mesh = load_mesh(entry["mesh"], entry["up"])
        # The texture came along. An OBJ without one would be of one pixel.
        assert mesh.texture.shape == (128, 128, 3)
        assert mesh.texture.std() > 50
    extents = np.ptp(load_mesh("data/objects/polyhaven_barrel_01/mesh.gltf", "y").vertices, axis=0)
    np.testing.assert_allclose(extents, [0.5, 0.5, 0.88], atol=1e-6)
    assert set(read_checksums(Path("data/checksums.yaml"))) == set(keys)
    assert set(read_checksums(Path("data/checksums.yaml"))["ycb_mug"]) == {"025_mug_google_16k.tgz"}
    assert leftovers() == set()
    asked = len(publisher.requests)
    assert [result.status for result in fetch_all(keys, published)] == [FetchStatus.PRESENT] * 3
    assert len(publisher.requests) == asked


def test_a_gltf_without_scenes_is_measured_as_it_is_read(published, publisher, tmp_path):
    home = barrel_folder(tmp_path / "mine" / "Barrel_01", publisher)
    gltf = json.loads((home / "Barrel_01_1k.gltf").read_text())
    del gltf["scene"], gltf["scenes"]
    gltf["nodes"][0]["scale"] = [2, 2, 2]
    (home / "Barrel_01_1k.gltf").write_text(json.dumps(gltf))
    (result,) = fetch_all(["polyhaven_barrel_01"], published, home.parent)
    assert result.status is FetchStatus.ADDED
    assert "scaled: the mesh itself measures 1.76 m" in result.detail
    assert "polyhaven_barrel_01" in read_checksums(Path("data/checksums.yaml"))


def test_a_mesh_that_cannot_be_measured_leaves_nothing(published, monkeypatch):
    monkeypatch.setattr(run_module, "load_mesh", Mock(side_effect=ObjectFolderError("no size")))
    check_failure(r"^no size \(from http", "ycb_mug", published)


def test_an_unreachable_host_is_asked_once(published, publisher, monkeypatch, no_waits):
    fetch_object("ycb_mug", published)
    elsewhere = ["ycb=http://127.0.0.1:1/{model}.tgz", *addresses(publisher)[1:]]
    asked = []
    monkeypatch.setattr(run_module, "download_to", lambda *args: asked.append(args[1]) or download_to(*args))
    keys = ["ycb_bowl", "ycb_mug", "ycb_plate", "gso_bunny_racer"]
    results = fetch_all(keys, read_catalogue(CATALOGUE, elsewhere))
    failed = FetchStatus.FAILED
    assert [r.status for r in results] == [failed, FetchStatus.PRESENT, failed, FetchStatus.ADDED]
    assert asked == ["http://127.0.0.1:1/024_bowl.tgz", f"{publisher.url}{RACER}"]
    assert results[0].detail == results[2].detail
    said = r"127\.0\.0\.1:1 cannot be reached \(Connection refused\).*--url SOURCE=TEMPLATE.*--from DIR"
    assert re.search(said, results[0].detail)
    assert no_waits == []


def test_of_two_fetches_of_an_object_the_second_waits_and_finds_it(published, monkeypatch, caplog):
    with ThreadPoolExecutor(1) as pool:
        others = []

        def with_another(*args):
            others.append(pool.submit(fetch_object, "ycb_mug", published))
            while "waiting for another `objectfolder fetch`" not in caplog.text:
                time.sleep(0.01)
            download_to(*args)

        monkeypatch.setattr(run_module, "download_to", with_another)
        assert fetch_object("ycb_mug", published).status is FetchStatus.ADDED
        (other,) = others
        assert other.result().status is FetchStatus.PRESENT
    assert leftovers() == set()


def test_what_a_killed_fetch_left_is_removed(published):
    left = Path("build/.fetch/ycb_mug.k1ll3d_0/tree")
    left.mkdir(parents=True)
    (left / "mesh.obj").write_text("v 0 0 0")
    assert fetch_object("ycb_mug", published).status is FetchStatus.ADDED
    assert leftovers() == set()


def test_a_download_that_breaks_off_goes_on_in_the_next_run(published, publisher, no_waits):
    publisher.drops[MUG] = [20_000, *[0] * len(WAITS)]
    check_failure(r"broke off.*20000 bytes", "ycb_mug", published, PART)
    assert fetch_object("ycb_mug", published).status is FetchStatus.ADDED
    assert publisher.requests[-1][1]["Range"] == "bytes=20000-"
    assert leftovers() == set()


def test_an_interruption_keeps_what_was_downloaded_and_nothing_else(published):
    before = state()

    def interrupt(done, total):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fetch_object("ycb_mug", published, progress=lambda name: interrupt)
    assert state() == before
    assert leftovers() == PART
    assert fetch_object("ycb_mug", published).status is FetchStatus.ADDED


def test_one_that_fails_does_not_stop_the_others(published, publisher):
    del publisher.pages[RACER]
    result = run(publisher, "bunny_racer", "ycb_mug")
    assert result.exit_code == 1
    assert "failed  gso_bunny_racer" in result.output
    assert "/BUNNY_RACER.zip answered 404" in result.output
    assert "added   ycb_mug: steel, 0.117 m, 0.118 kg; published 0.082 is the height" in result.output
    assert "1 added, 1 failed (gso_bunny_racer); next: objectfolder build" in result.output
    assert set(params.read()["objects"]) == {"mug", "die", "bell", "ycb_mug"}
    again = run(publisher, "ycb_mug")
    assert again.exit_code == 0
    assert "present ycb_mug: data/objects/ycb_mug is there already" in again.output
    marked = [line.split()[1] for line in run(publisher, "--list").output.splitlines() if "✓" in line]
    assert marked == ["ycb_mug"]


def test_an_archive_that_no_reader_expects_fails_alone(published, publisher, monkeypatch):
    nameless = zipped({"AA": b"2"}).replace(b"\2\0\0\0AA", b"\0\0\2\0AA")
    publisher.pages[MUG] = nameless.replace(b"\2\0\0\0\0\0", b"\0\0\2\0\0\0")
    results = fetch_all(["ycb_mug", "gso_bunny_racer"], published)
    assert [result.status for result in results] == [FetchStatus.FAILED, FetchStatus.ADDED]
    assert "not trustworthy" in results[0].detail
    monkeypatch.setattr(run_module, "extract", lambda *_: [][0])
    (result,) = fetch_all(["ycb_mug"], published)
    assert result.status is FetchStatus.FAILED
    assert "IndexError('list index out of range')" in result.detail


def test_licences_are_named_once_for_each_source(published, publisher):
    result = run(publisher, "ycb_mug", "ycb_bowl", "gso_frypan")
    assert result.output.count("Calli et al.") == 1
    assert result.output.count("(c) 2020 Google LLC") == 1
    assert "Poly Haven" not in result.output


def test_without_objects_it_says_what_there_is(workspace, publisher, catalogue):
    result = run(publisher)
    assert isinstance(result.exception, ObjectFolderError)
    assert "100 objects (20 polyhaven, 28 ycb, 52 gso), 0 in this workspace" in result.output
    assert "--all" in str(result.exception)
    listed = run(publisher, "--list")
    assert listed.exit_code == 0
    for key, entry in catalogue.objects.items():
        assert f" {key} " in listed.output
        assert f" {entry.name}" in listed.output
    assert publisher.requests == []


def test_all_asks_for_every_object(workspace, publisher, no_waits):
    result = run(publisher, "--all")
    assert result.exit_code == 1
    assert "100 failed" in result.output
    assert len({path for path, _ in publisher.requests}) == 100


BAD_MUGS = {
    "web page": (b"<html>", "neither a zip nor a tar archive.*from http"),
    "truncated": (ycb("025_mug")[:20_000], r"025_mug_google_16k\.tgz is damaged"),
    "path outside": (tgz({"../../evil": b"1"}), r"'\.\./\.\./evil' would be written outside"),
    "no mesh": (tgz({"025_mug/readme.txt": b"soon"}), "no mesh: 025_mug/readme.txt; expected one mesh"),
    "nothing": (tgz({}), "no mesh: nothing"),
    "several meshes": (tgz({"a.obj": b"", "b.ply": b""}), "several meshes: a.obj, b.ply"),
    "empty mesh": (tgz({"textured.obj": b""}), "textured.obj (holds no faces|cannot be read)"),
    "NaN": (tgz({"m.obj": b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n"}), "NaN"),
    "missing material": (tgz({"m.obj": box_obj("gone.mtl")}), "refers to gone.mtl, which does not exist"),
    "missing texture": (
        tgz({"m.obj": box_obj("m.mtl"), "m.mtl": b"newmtl m\nmap_Kd gone.png\n"}),
        "refers to gone.png, which does not exist",
    ),
    "glTF that is none": (tgz({"m.gltf": b"{"}), r"m\.gltf cannot be read as a mesh"),
    "glTF of another shape": (tgz({"m.gltf": b"[]"}), r"m\.gltf cannot be read as a mesh"),
}


@pytest.mark.parametrize("case", BAD_MUGS)
def test_a_bad_archive_leaves_nothing(published, publisher, case):
    publisher.pages[MUG], message = BAD_MUGS[case]
    assert publisher.url in check_failure(message, "ycb_mug", published)
    publisher.pages[MUG] = ycb("025_mug")
    assert fetch_object("ycb_mug", published).status is FetchStatus.ADDED


def test_a_changed_archive_is_refused_until_accepted(published, publisher):
    fetch_object("ycb_mug", published)
    lock = Path("data/checksums.yaml")
    first = read_checksums(lock)["ycb_mug"]["025_mug_google_16k.tgz"]
    forget("ycb_mug")
    publisher.pages[MUG] = ycb("025_mug", sides=(0.1, 0.1, 0.1))
    error = check_failure("--accept-changed", "ycb_mug", published)
    for fact in ("025_mug_google_16k.tgz of ycb_mug", f"expected SHA-256 {first}", str(lock), "got "):
        assert fact in error
    result = fetch_object("ycb_mug", published, accept_changed=True)
    assert "scaled: the mesh itself measures 0.1 m" in result.detail
    second = read_checksums(lock)["ycb_mug"]["025_mug_google_16k.tgz"]
    assert second != first
    assert second in error
    forget("ycb_mug")
    assert fetch_object("ycb_mug", published).status is FetchStatus.ADDED


def barrel_folder(home, publisher):
    """Files of Poly Haven's barrel, as a user has them in a folder."""
    (home / "textures").mkdir(parents=True)
    for path, content in polyhaven(publisher, "Barrel_01").items():
        if path.startswith("/dl/1k/"):
            (home / path.removeprefix("/dl/1k/")).write_bytes(content)
    return home


def forget(key):
    """Remove an object by hand, as a user would."""
    shutil.rmtree(Path("data/objects") / key)
    Path(f"data/objects/{key}.dvc").unlink()
    lines = Path("params.yaml").read_text().splitlines(keepends=True)
    Path("params.yaml").write_text("".join(line for line in lines if not line.startswith(f"  {key}:")))


def test_the_same_archive_gives_the_same_files_and_checksums(published, publisher):
    fetch_object("gso_bunny_racer", published)
    first = state()
    forget("gso_bunny_racer")
    fetch_object("gso_bunny_racer", published)
    assert state() == first


def test_a_damaged_record_is_named(published):
    Path("data").mkdir(exist_ok=True)
    Path("data/checksums.yaml").write_text("ycb_mug: {")
    check_failure(r"checksums\.yaml.* is not valid YAML.*restore it from git", "ycb_mug", published)


@pytest.mark.parametrize(
    ("change", "message"),  # of the entry of the glTF, or another page
    [
        (lambda gltf: gltf["include"].update({"../../evil": gltf["include"]["Barrel_01.bin"]}), "outside"),
        (lambda gltf: gltf.update(url="/evil/.."), "outside the folder"),
        (lambda gltf: gltf["include"]["Barrel_01.bin"].update(md5="0" * 32), "is damaged: its MD5"),
        (lambda gltf: gltf["include"]["Barrel_01.bin"].update(url="file:///etc/passwd"), "expected http"),
        (lambda gltf: gltf["include"]["Barrel_01.bin"].update(size=10), "Barrel_01.bin is larger than"),
        (lambda gltf: gltf["include"]["Barrel_01.bin"].update(size="1" * 5000), "lists no glTF at 1k"),
        (lambda gltf: gltf["include"].pop("Barrel_01.bin"), "Barrel_01"),
        (lambda gltf: gltf.pop("md5"), "lists no glTF at 1k.*md5"),
        (b"no json", "/files/Barrel_01 lists no glTF at 1k"),
        (b"[]", "/files/Barrel_01 lists no glTF at 1k"),
        (b'{"gltf": {"4k": {}}}', "/files/Barrel_01 lists no glTF at 1k"),
        (b"[" * 100_000, "/files/Barrel_01 lists no glTF at 1k"),
    ],
)
def test_a_bad_list_of_files_leaves_nothing(published, publisher, change, message):
    listing = json.loads(publisher.pages["/files/Barrel_01"])
    if callable(change):
        change(listing["gltf"]["1k"]["gltf"])
    publisher.pages["/files/Barrel_01"] = json.dumps(listing).encode() if callable(change) else change
    check_failure(message, "polyhaven_barrel_01", published)


def test_objects_come_from_a_directory_without_a_request(published, publisher, tmp_path):
    mine = tmp_path / "mine"
    barrel_folder(mine / "Barrel_01", publisher)
    (mine / "025_mug_google_16k.tgz").write_bytes(ycb("025_mug"))
    (mine / "bunny racer.zip").write_bytes(gso())
    before = contents(mine)
    result = run(publisher, "--from", str(mine), "ycb_mug", "BUNNY_RACER", "Barrel_01", "ycb_bowl")
    assert "3 added, 1 failed (ycb_bowl)" in result.output
    assert "no archive or folder of ycb_bowl" in result.output
    assert publisher.requests == []
    assert contents(mine) == before
    assert "the folder Barrel_01" in Path("data/objects/polyhaven_barrel_01/SOURCE.txt").read_text()
    # Downloaded, it would be the same files: they are compared.
    lock = Path("data/checksums.yaml")
    forget("polyhaven_barrel_01")
    recorded = read_checksums(lock)
    fetch_object("polyhaven_barrel_01", published)
    assert read_checksums(lock) == recorded


def test_a_mesh_in_another_format_keeps_that_formats_up_axis(published, tmp_path):
    (tmp_path / "mine" / "025_mug").mkdir(parents=True)
    trimesh.creation.box([0.1, 0.117, 0.1]).export(tmp_path / "mine" / "025_mug" / "mug.glb")
    fetch_object("ycb_mug", published, tmp_path / "mine")
    assert params.read()["objects"]["ycb_mug"]["up"] == "y"


def test_a_folder_without_an_entry_is_not_overwritten(published, publisher):
    home = Path("data/objects/ycb_mug")
    home.mkdir(parents=True)
    refused("has no such object; remove the folder", fetch_object, "ycb_mug", published)
    assert list(home.iterdir()) == []
    assert publisher.requests == []


def test_what_is_not_writable_or_no_workspace_is_said_before_downloading(
    published, publisher, tmp_path, monkeypatch
):
    Path("build").write_text("in the way")
    refused(r"cannot write .*build", fetch_object, "ycb_mug", published)
    monkeypatch.chdir(tmp_path)
    refused(r"params\.yaml does not exist", fetch_all, ["ycb_mug"], published)
    assert publisher.requests == []


NEEDS_OBJECTS = pytest.mark.skipif(not OBJECTS.exists(), reason="the set of real objects is not here")
SLOW_KEYS = [pytest.param(key, marks=pytest.mark.slow) for key in ("ycb_mug", "gso_bunny_racer")]


@NEEDS_OBJECTS
@pytest.mark.parametrize("key", ["ycb_nine_hole_peg_test", *SLOW_KEYS])
def test_real_meshes_come_from_their_folders(workspace, catalogue, key):
    result = fetch_object(key, catalogue, OBJECTS)
    assert result.status is FetchStatus.ADDED
    # Where the published size was a slip, ours is the mesh's own: nothing is scaled.
    assert "scaled" not in result.detail
    files = {p.name for p in (OBJECTS / key).iterdir()}
    assert {p.name for p in Path(f"data/objects/{key}").iterdir()} == files | {"SOURCE.txt"}


@NEEDS_OBJECTS
def test_real_folders_are_found_and_only_those(catalogue):
    found = set()
    for key in catalogue.objects:
        with suppress(ObjectFolderError):
            found.add((key, find_local(OBJECTS, catalogue, key).name))
    there = {path.name for path in OBJECTS.iterdir() if path.is_dir()}
    # Not among the paper's hundred.
    there -= {"gso_salad_plate", "ycb_power_drill", "ycb_skillet_lid", "ycb_tomato_soup_can"}
    assert found == {(name, name) for name in there if not name.startswith("polyhaven")}


@NEEDS_OBJECTS
def test_sizes_are_those_of_the_meshes_within_the_tolerance(catalogue):
    paths = [path for path in OBJECTS.glob("*/mesh.obj") if path.parent.name in catalogue.objects]
    assert len(paths) == 10
    for path in paths:
        own = trimesh.load_scene(path, process=False, skip_materials=True).extents.max()
        assert catalogue.objects[path.parent.name].scale == pytest.approx(own, rel=SIZE_TOLERANCE)
