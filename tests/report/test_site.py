"""The site of a report."""

import base64
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from folders import contents
from own_workspace import ROOT
from refusals import refused
from web_pages import NEEDS_CHROMIUM, check_whole, heard, page_data, run_node, seen

from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.base.io import file_digest, read_json, write_json
from objectfolder.cli import app
from objectfolder.engine.process import CommandResult
from objectfolder.engine.records import LOGS, record_cost
from objectfolder.objectfile.file import ObjectFile
from objectfolder.report.facts import object_report
from objectfolder.report.site import write_site
from objectfolder.stored.header import PARTS
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.workspace.layout import Build


def rows_of(page):
    """Rows of the overview."""
    return page_data(page.read_text(), 'id="data"')["rows"]


@pytest.fixture(scope="module")
def workspace(brick, tmp_path_factory):
    """A workspace whose truth is what the brick answers."""
    build = Build("brick", tmp_path_factory.mktemp("workspace"))
    brick.save(build.object_file)
    cameras = look_at(np.array([[2.0, 1, 1], [-1.5, 1, 1.5]]))
    light = np.array([[0.5, 0.5, 0.9], [-0.5, 0.5, 0.9]])
    intrinsics = Intrinsics.square(32)
    views = {"rgba": brick.render(cameras, light, intrinsics=intrinsics).rgba, "camera_to_world": cameras}
    views |= {"light": light, "focal": np.float64(intrinsics.focal), "center": np.full((2, 2), 16.0)}
    write_npz(build.views("test"), **views)
    points = brick.sample_surface(6, seed=3)
    touches = {"points": points, "depths": np.full(6, 1e-3), "angles": np.linspace(0, 1, 6)}
    images = brick.touch(*touches.values())
    write_npz(build.touch("test"), **touches, images=images, obstructed=np.array([0, 0, 0, 0, 0, 0.2]))
    tuning = brick.tuning()
    modes = {name: getattr(tuning, name).double().numpy() for name in ("damped_frequency", "damping")}
    modes |= {"points": points / brick.scale, "shapes": brick.mode_shapes(points)}
    write_npz(build.modes, **modes, split=np.array([0, 0, 0, 1, 2, 2]))
    vision = {"psnr": 40.0, "baseline_white": 9.0, "views": 2}
    vision |= {"best_view": 0, "median_view": 1, "worst_view": 1}
    scores = {"vision": vision, "audio": {}, "touch": {}, "file_bytes": 1000}
    write_json(build.metrics, scores | {"file_sha256": file_digest(build.object_file)})
    logs = build.root / LOGS
    record_cost(logs, "evaluate@brick", CommandResult(0, 3.0, 300.0, cpu_seconds=2.0))
    record_cost(logs, "modal@brick", CommandResult(0, 12.3456, 456.0, cpu_seconds=23.456))
    record_cost(logs, "modal@bricks", CommandResult(0, 1.0, 1.0, cpu_seconds=1.0))
    return build


@pytest.fixture(scope="module")
def report(brick_path):
    return object_report(brick_path)


@pytest.fixture
def quick(report, monkeypatch):
    """Sites hold the report of the brick that is made once."""
    monkeypatch.setattr("objectfolder.report.site.object_report", lambda path, costs: report)


def test_a_sound_that_is_marked_uncertain_is_warned_of(brick, report, tmp_path):
    audio = brick.header["audio"] | {"uncertain": True, "frequency_uncertainty": 0.48}
    ObjectFile(brick.header | {"audio": audio}, brick.tensors).save(tmp_path / "marked.safetensors")
    marked = object_report(tmp_path / "marked.safetensors").row
    assert [
        text for text in marked["warnings"] if "marked uncertain: its lowest frequencies may be 48%" in text
    ]
    assert marked["failed"] == [*report.row["failed"], "Estimated error of frequencies"]
    assert not any("uncertain" in text for text in report.row["warnings"])


def test_truth_that_the_file_answers_differs_by_nothing(workspace):
    report = object_report(workspace.object_file)
    assert report.row["scores"] == {"vision.psnr": 40.0, "file_bytes": 1000.0}
    assert [view["title"] for view in report.detail["views"]] == [
        *("studio light", "studio light", "studio light"),
        *("worst: view 2, one point light", "best: view 1, one point light"),
    ]
    studio, compared = report.detail["views"][:3], report.detail["views"][3:]
    assert all("score" not in view for view in studio)
    for strip in (*compared, *report.detail["touches"]):
        assert strip["score"] > 60
        truth, answer, difference = np.split(seen(strip["source"]).astype(int), 3, axis=1)
        assert np.abs(truth - answer).mean() < 4  # lossy
        assert difference.mean() > 250  # white
    assert report.detail["touches"][-1]["title"] == "1 mm deep, obstructed"
    assert report.detail["costs"] == [["modal", 23.46, 12.35, 456.0], ["evaluate", 2.0, 3.0, 300.0]]
    for sound in report.detail["sounds"]:
        truth, answer = (heard(sound[name])[0] for name in ("truth", "answer"))
        assert np.abs(truth).max() == pytest.approx(0.9, abs=1e-3)
        assert np.abs(truth - answer).max() < 1e-3


def test_a_file_alone_is_reported_without_truth_and_always_the_same(brick, brick_path, report):
    assert object_report(brick_path) == report
    assert report.row["thumbnail"].startswith("data:image/webp")
    assert report.row["failed"] == []
    assert all("score" not in strip for strip in (*report.detail["views"], *report.detail["touches"]))
    assert all(sound["truth"] is None for sound in report.detail["sounds"])
    assert report.detail["costs"] == []
    assert base64.b64decode(report.detail["file"]) == brick_path.read_bytes()
    frequency, decay, quality, _ = np.array(report.detail["modes"], float).T
    np.testing.assert_allclose(frequency, brick.frequencies, rtol=1e-3)
    np.testing.assert_allclose(quality, np.pi * frequency * decay / np.log(1000), rtol=2e-3)


def played(file, path):
    """Sounds of a file's report and their sample rate."""
    file.save(path)
    sounds = object_report(path).detail["sounds"]
    answers, rates = zip(*[heard(sound["answer"]) for sound in sounds])
    return sounds, answers, {*rates}


@pytest.mark.parametrize(("highest", "rate"), [(7990, 16000), (20000, 48000)])
def test_every_mode_is_heard_and_drawn(brick, tmp_path, caplog, highest, rate):
    damped = np.linspace(0.7, 1, 12, dtype=np.float32) * 2 * np.pi * highest
    file = ObjectFile(brick.header, dict(brick.tensors) | {"audio.damped_frequency": damped}, "brick")
    sounds, answers, rates = played(file, tmp_path / "high.safetensors")
    assert rates == {rate}
    assert "silent" not in caplog.text
    for sound, answer in zip(sounds, answers):
        assert np.abs(answer).max() == pytest.approx(0.9, abs=1e-3)
        top, levels = min(rate / 2, 20000), seen(sound["source"]).mean((1, 2))
        assert re.fullmatch(rf"0 to {top / 1000:g} kHz upwards, 0 to (0.\d|1) s to the right", sound["axes"])
        assert 0.69 * highest < (1 - levels.argmax() / len(levels)) * top < 1.01 * highest


def test_stored_spectrograms_are_played_at_their_own_rate(spectrograms, tmp_path):
    assert played(spectrograms, tmp_path / "stored.safetensors")[2] == {16000}


def test_contacts_that_nothing_blocks_are_shown_first(brick, brick_path, monkeypatch):
    blocked = np.arange(18) % 2 * 0.2
    real = ObjectFile.press

    def press(self, points, depth):
        done = real(self, points, depth)
        return replace(done, obstructed=blocked) if len(points) == 18 else done

    monkeypatch.setattr(ObjectFile, "press", press)
    touches = object_report(brick_path).detail["touches"]
    assert [touch["title"] for touch in touches] == ["1 mm deep"] * 6
    blocked[2:] = 0.2
    touches = object_report(brick_path).detail["touches"]
    assert [touch["title"] for touch in touches] == ["1 mm deep"] + ["1 mm deep, obstructed"] * 5


@pytest.mark.parametrize("part", PARTS)
def test_an_object_without_a_part_is_reported_with_the_others(brick, tmp_path, part):
    header = {name: value for name, value in brick.header.items() if name not in (part, "radiation")}
    path = tmp_path / "ObjectFile.safetensors"
    ObjectFile(header, brick.tensors, "brick").save(path)
    report = object_report(path)
    assert report.row["failed"] == []
    assert ("thumbnail" in report.row) == bool(report.detail["views"]) == (part not in ("vision", "geometry"))
    assert bool(report.row["modes"]) == bool(report.detail["modes"]) == (part != "audio")
    assert bool(report.detail["sounds"]) == (part not in ("audio", "geometry"))
    assert bool(report.detail["touches"]) == (part not in ("touch", "geometry"))


@pytest.mark.usefixtures("quick")
def test_a_site_has_its_title_and_loads_nothing_but_its_own_scripts(brick_path, tmp_path):
    missing = {"spoon": {"material": "steel", "scale": 0.2}}
    page = write_site([brick_path], tmp_path / "site", missing, title="Pots & pans")
    assert "<title>Pots &amp; pans: report</title>" in page.read_text()
    assert "<h1>Pots &amp; pans</h1>" in page.read_text()
    assert page == tmp_path / "site" / "index.html"
    assert contents(page.parent).keys() == {"index.html", "objects/brick.js", "viewer.js"}
    check_whole(page.read_text())
    spoon, brick = rows_of(page)
    assert (spoon["missing"], spoon["material"], brick["key"]) == (True, "steel", "brick")
    detail = (page.parent / "objects" / "brick.js").read_text()
    assert json.loads(detail[len("objectfolderReport(") : -3])["key"] == "brick"
    assert "</script" not in detail


@pytest.mark.usefixtures("quick")
def test_a_single_file_holds_everything(brick_path, tmp_path):
    page = write_site([brick_path], tmp_path / "report.html", single_file=True)
    assert list(tmp_path.iterdir()) == [page]
    text = page.read_text()
    assert base64.b64decode(page_data(text, 'data-report="brick"')["file"]) == brick_path.read_bytes()
    assert len(page_data(text, 'id="viewer"')) > 50_000


def renamed(report, key):
    return replace(report, row=report.row | {"key": key}, detail=report.detail | {"key": key})


@pytest.fixture
def hundred(report, monkeypatch, tmp_path):
    """Site of a hundred objects, which are the brick under other names."""
    monkeypatch.setattr("objectfolder.report.site.object_report", lambda path, _: renamed(report, path.name))
    monkeypatch.setattr("objectfolder.report.site.read_key", lambda path: path.name)
    return write_site([Path(f"brick_{n}") for n in range(100)], tmp_path / "site")


def test_the_overview_of_a_hundred_objects_holds_none_of_their_files(hundred):
    assert hundred.stat().st_size < 1e6
    assert len(list((hundred.parent / "objects").iterdir())) == 100


@pytest.mark.usefixtures("quick")
def test_two_files_of_one_object_are_refused(brick_path, tmp_path):
    for paths, missing in (([brick_path] * 2, {}), ([brick_path], {"brick": {"material": "steel"}})):
        taken = "another file holds an object of the key brick"
        refused(taken, write_site, paths, tmp_path / "site", missing)
    assert not (tmp_path / "site").exists()


@pytest.fixture
def three(brick, report, tmp_path, monkeypatch):
    """Files of three objects, the second truncated; the report of the others is that of the brick."""

    def reported(path, costs):
        return object_report(path, costs) if path.stem == "two" else renamed(report, path.stem)

    monkeypatch.setattr("objectfolder.report.site.object_report", reported)
    paths = [tmp_path / f"{key}.safetensors" for key in ("one", "two", "three")]
    for path in paths:
        ObjectFile(brick.header | {"key": path.stem}, brick.tensors).save(path)
    paths[1].write_bytes(paths[1].read_bytes()[:-1])
    return paths


def test_a_mode_that_does_not_decay_has_no_time_to_decay(brick, tmp_path):
    damping = np.zeros_like(np.asarray(brick.tensors["audio.damping"]))
    tensors = dict(brick.tensors.items()) | {"audio.damping": damping}
    file = tmp_path / "rings.safetensors"
    ObjectFile(brick.header, tensors).save(file)
    modes = object_report(file, True).detail["modes"]
    assert [row[1:] for row in modes] == [[None, None, None]] * len(brick.frequencies)


def test_a_damaged_object_fails_alone(three, tmp_path, capsys):
    site = tmp_path / "site"
    assert app(["report", *map(str, three), "--no-open", "--out", str(site)], standalone_mode=False) == 1
    one, two, last = rows_of(site / "index.html")
    assert (one["key"], two["key"], last["key"]) == ("one", "two", "three")
    assert two["failed"] == ["Object can be reported"]
    assert "neither an Object File nor another readable" in two["warnings"][0]
    assert one["failed"] == last["failed"] == []
    assert sorted(path.name for path in (site / "objects").iterdir()) == ["one.js", "three.js"]
    assert "3 objects, 1 failed" in capsys.readouterr().out


def test_a_damaged_file_is_not_taken_for_the_object_of_its_name(three, tmp_path):
    failed, missing = [], {"two": {"material": "steel"}}
    page = write_site(three[:2], tmp_path / "site", missing, on_failure=lambda key, error: failed.append(key))
    assert failed == [str(three[1])]
    assert {row["key"] for row in rows_of(page)} == {"one", "two", str(three[1])}


def test_a_site_is_written_whole_or_not_at_all(three, tmp_path):
    site = tmp_path / "site"
    write_site(three[:1], site)
    before = contents(site)
    refused("neither an Object File", write_site, three[::-1], site)
    assert contents(site) == before


@pytest.fixture
def bare(monkeypatch):
    """Reports hold no pictures and sounds, which take seconds."""
    for name in ("_views", "_sounds", "_touches"):
        monkeypatch.setattr(f"objectfolder.report.facts.{name}", lambda *arguments: [])
    monkeypatch.setattr("objectfolder.report.facts.file_checks", lambda file: [])
    monkeypatch.setattr("objectfolder.report.facts._seen", lambda file: False)


@pytest.fixture
def copied(workspace, tmp_path):
    """A copy of the workspace."""
    return Build("brick", shutil.copytree(workspace.root, tmp_path / "workspace"))


@pytest.mark.usefixtures("bare")
def test_costs_are_left_out_if_not_asked_for(workspace):
    assert len(object_report(workspace.object_file).detail["costs"]) == 2
    assert object_report(workspace.object_file, costs=False).detail["costs"] == []


@pytest.mark.usefixtures("bare")
def test_scores_of_another_file_are_left_out(copied):
    build = copied
    write_json(build.metrics, read_json(build.metrics) | {"file_sha256": "0" * 64})
    report = object_report(build.object_file)
    assert report.row["scores"] == {"file_bytes": float(f"{build.object_file.stat().st_size:.4g}")}
    assert report.row["warnings"] == [
        "its scores and truth are of another Object File and left out: run `objectfolder build brick`"
    ]
    assert "Looks better than an empty picture" not in [check["name"] for check in report.detail["checks"]]


@pytest.fixture
def moved_on(copied, monkeypatch):
    """The workspace after its modes and touches were made again, for another material and sensor."""
    build = copied
    modes = read_npz(build.modes)
    write_npz(build.modes, **modes | {"damped_frequency": modes["damped_frequency"] * 1.1})
    touches = read_npz(build.touch("test"))
    write_npz(build.touch("test"), **touches | {"images": touches["images"][:, ::2]})
    for name in ("file_checks", "build_checks", "_views"):
        monkeypatch.setattr(f"objectfolder.report.facts.{name}", lambda *arguments: [])
    return build


@pytest.mark.parametrize("scored", [True, False])
def test_truth_of_another_file_is_left_out(workspace, moved_on, scored):
    """Whether the truth itself shows it, or only the scores."""
    if not scored:
        shutil.copy(workspace.modes, moved_on.modes)
        shutil.copy(workspace.touch("test"), moved_on.touch("test"))
        write_json(moved_on.metrics, read_json(moved_on.metrics) | {"file_sha256": "0" * 64})
    detail = object_report(moved_on.object_file).detail
    assert [sound["truth"] for sound in detail["sounds"]] == [None, None]
    assert len(detail["touches"]) == 6
    assert all("score" not in touch for touch in detail["touches"])


@pytest.mark.usefixtures("bare")
def test_a_link_into_the_cache_is_of_its_workspace(copied):
    cached = copied.root / ".dvc/cache/files/md5/ab/cdef"
    cached.parent.mkdir(parents=True)
    copied.object_file.rename(cached)
    copied.object_file.symlink_to(cached)
    report = object_report(copied.object_file)
    assert report.row["scores"]["vision.psnr"] == 40.0
    assert len(report.detail["costs"]) == 2


def test_report_reports_on_a_workspace(copied, monkeypatch, capsys):
    params = (ROOT / "params.yaml").read_text()
    (copied.root / "params.yaml").write_text(params.replace("  mug: {mesh", "  brick: {mesh"))
    monkeypatch.chdir(copied.root)
    app(["report", "--no-open"], standalone_mode=False)
    missing = {row["key"]: bool(row.get("missing")) for row in rows_of(Path("site/index.html"))}
    assert missing == {"die": True, "bell": True, "brick": False}
    assert capsys.readouterr().out.endswith(": 1 object\n")


def test_report_says_that_nothing_is_built_or_a_file_not_there(tmp_path, monkeypatch):
    command = ["report", str(tmp_path / "absent.safetensors"), "--no-open"]
    refused(r"absent\.safetensors does not exist; expected", app, command, standalone_mode=False)
    shutil.copy(ROOT / "params.yaml", tmp_path)
    monkeypatch.chdir(tmp_path)
    refused(r"no object of params\.yaml is built", app, ["report", "--no-open"], standalone_mode=False)


@pytest.mark.slow
@NEEDS_CHROMIUM
@pytest.mark.parametrize("single_file", [False, True])
def test_the_report_in_chromium(workspace, tmp_path, single_file):
    missing = {"spoon": {"material": "steel", "scale": 0.2}}
    page = write_site([workspace.object_file], tmp_path / "report.html", missing, single_file)
    run_node("report.mjs", page, tmp_path)


@pytest.mark.slow
@NEEDS_CHROMIUM
def test_the_overview_of_a_hundred_objects_is_smooth(hundred):
    found = json.loads(run_node("overview.mjs", hundred))
    print(found)
    # Of the page's own work, with room for a busy machine.
    assert found["cards"] == 100
    assert found["shown"] < 2000
    assert found["filtered"] < 200
