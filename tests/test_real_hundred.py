"""The real hundred: its record from a workspace, its pages, and modes of drawn objects."""

import csv
import json
import re
import runpy
import shutil
import sys

import catalogue
import harness
import modal_reference
import numpy as np
import pytest
import results
from PIL import Image
from solids import box, tetrahedral_box

from objectfolder.base.io import read_json, write_json
from objectfolder.hub.fetch.catalogue import read_catalogue
from objectfolder.mesh.ply import write_surface
from objectfolder.workspace import params

REAL = read_catalogue(harness.ROOT / "catalogs/real.yaml")
SCORES = read_json(results.RECORDS / "scores.json")["objects"]["mug"]
SCORES = {name: SCORES[name] for name in ("audio", "file_bytes", "touch", "vision")}
SAMPLE = SCORES | {"file_bytes": 250_000}
SILENT = SAMPLE | {"audio": {"modes": 0, "modes_heard": 0, "impacts": 200}}
MODAL = {"modes": 35, "lowest_hz": [900.0, 700.0], "frequency_uncertainty": 0.31, "mass_kg": 0.84}
CLEAN = {"name": "clean", "detail": "welded at 1e-07"}
CLOSED = {"rung": "grid", "deviation_max_percent": 1.5}
CLOSED |= {
    "rungs": [CLEAN, {"name": "cap", "detail": "2 holes capped"}, {"name": "grid", "detail": "remeshed"}]
}
BUILT = ("ycb_mug", "gso_rhino")  # of the paper, and another
ERROR = "the command exited with code 1; modal ycb_fork: ycb_fork: frequencies | may be 222% wrong"


@pytest.fixture
def workspace(tmp_path):
    """A workspace with three of the hundred: two with scores, of which one is silent, and one that failed."""
    root = tmp_path / "real"
    values = params.read(harness.ROOT / "params.yaml")
    entries = {
        key: {"mesh": "m.obj", "material": REAL.objects[key].material, "scale": REAL.objects[key].scale}
        for key in (*BUILT, "ycb_fork")
    }
    entries["gso_rhino"] |= {"wall": 0.003, "up": "y"}
    write_json(root / "params.yaml", values | {"objects": entries, "procedural": {}})  # JSON is YAML
    for key, scores in zip(BUILT, (SAMPLE, SILENT)):
        write_json(root / "metrics" / f"{key}.json", scores)
        write_json(
            root / "build" / key / "modal.json", MODAL | ({"uncertain": True} if scores is SAMPLE else {})
        )
        write_json(root / "build" / key / "normalize.json", CLOSED)
    logs = root / "build/.logs"
    write_json(logs / "modal@ycb_fork.failed", {"error": ERROR, "log": "", "inputs": {}})
    for stage, seconds in (("modal", 20.0), ("render_views", 30.0)):
        cost = {"seconds": 1.0, "cpu_seconds": seconds, "peak_mb": 1.0}
        write_json(logs / f"{stage}@ycb_mug.cost", cost)
    return root


@pytest.fixture
def records(tmp_path, workspace, monkeypatch):
    """The committed records, and that of the workspace."""
    folder = tmp_path / "records"
    measured = ("real.json", "real_modes.json", "benchmarks_real.json")
    shutil.copytree(results.RECORDS, folder, ignore=shutil.ignore_patterns(*measured))
    words = [str(workspace), "--published", str(harness.ROOT / "catalogs/real.yaml")]
    measure("catalogue", *words, "--json", str(folder / "real.json"), monkeypatch=monkeypatch)
    return folder


def measure(script, *words, monkeypatch):
    """Run a script, which ends with a verdict."""
    path = str(harness.ROOT / f"perf/{script}.py")
    monkeypatch.setattr(sys, "argv", [path, *words])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(path, run_name="__main__")
    return end.value.code


def test_the_record_has_every_object_of_the_catalogue_with_its_scores_or_why_it_has_none(records):
    record = read_json(records / "real.json")
    assert [row["object"] for row in record["rows"]] == list(REAL.objects)
    rows = {row["object"]: row for row in record["rows"]}
    assert sum(row["paper"] for row in rows.values()) == 61
    mug, rhino = (rows[key] for key in BUILT)
    assert (mug["source"], mug["paper"], mug["set"], mug["uncertain"]) == ("ycb", True, "", True)
    assert (mug["rung"], mug["closed"], mug["deviation"]) == (
        "grid",
        "cap: 2 holes capped; grid: remeshed",
        0.015,
    )
    assert (mug["cpu_seconds"], mug["slowest"], mug["bytes"]) == (50.0, "render_views", 250_000)
    assert (mug["audio"], mug["silence"]) == (SAMPLE["audio"]["psnr"], SAMPLE["audio"]["baseline_silence"])
    assert (rhino["paper"], rhino["set"], "uncertain" in rhino) == (False, "up y, wall 0.003", False)
    assert rhino["gain_error"] is rhino["audio"] is None
    failed = {key: row["failed"] for key, row in rows.items() if "failed" in row}
    assert failed.pop("ycb_fork") == "modal: frequencies | may be 222% wrong"
    assert set(failed.values()) == {"not in the workspace"}
    assert set(failed) == set(REAL.objects) - {*BUILT, "ycb_fork"}
    assert record["masses"] == [
        {"object": "ycb_mug", "solid": 0.84, "real": 0.118, "ratio": pytest.approx(0.84 / 0.118)}
    ]
    assert record["sources"]["gso"]["attribution"] == REAL.sources["gso"].attribution
    assert (record["preset"], record["pictures"]) == ("quick", False)
    (line,) = (text for text in record["missed"] if text.endswith(": not in the workspace"))
    assert line.count(",") == 96


def test_a_catalogue_may_be_built_in_parts(records, workspace, monkeypatch):
    path = records / "real.json"
    first = read_json(path)
    write_json(workspace / "build/gso_rhino/modal.json", MODAL | {"modes": 7})
    shutil.rmtree(workspace / "build/ycb_mug")
    (workspace / "metrics/ycb_mug.json").unlink()
    words = [str(workspace), "--published", str(harness.ROOT / "catalogs/real.yaml"), "--json", str(path)]
    measure("catalogue", *words, "--keep", monkeypatch=monkeypatch)
    record = read_json(path)
    assert len(record["rows"]) == len(first["rows"])
    changed = [new for old, new in zip(first["rows"], record["rows"]) if old != new]
    assert [(row["object"], row["modes"]) for row in changed] == [("gso_rhino", 7)]
    assert record["masses"] == first["masses"]
    assert record["earlier"] == [first["run"]]
    page = results.render("real.md", records)
    assert page.count(f"Run: `{first['run']['command']}`") == 1
    assert page.count(f"Run: `{record['run']['command']}`") == 1

    write_json(path, record | {"test_views": 8})
    assert "test_views of the record is 8" in measure("catalogue", *words, "--keep", monkeypatch=monkeypatch)
    assert read_json(path)["test_views"] == 8
    measure("catalogue", *words, monkeypatch=monkeypatch)
    assert "earlier" not in read_json(path)
    assert sum("failed" in row for row in read_json(path)["rows"]) == 99


def test_the_pages_name_every_object_and_are_left_out_without_the_record(records):
    for page, record in results.OPTIONAL.items():
        exists = (results.RECORDS / record).is_file()
        assert (page in results.PAGES) == exists == (results.ROOT / "docs" / page).is_file()
    page, table = (results.render(name, records) for name in results.OPTIONAL)
    assert not [key for key in REAL.objects if not re.search(rf"\b{key}\b", page)]
    rows = {row["object"]: row for row in csv.DictReader(table.splitlines())}
    assert list(rows) == list(REAL.objects)
    mug, rhino = (rows[key] for key in BUILT)
    assert (mug["of the paper"], mug["solid kg"], mug["weighed kg"], mug["closed by"]) == (
        "yes",
        "0.84",
        "0.118",
        "grid",
    )
    assert (rhino["of the paper"], rhino["gain error %"], rhino["audio dB"], rhino["weighed kg"]) == ("",) * 4
    assert rows["ycb_fork"]["material"] == "failed: modal: frequencies | may be 222% wrong"
    audio, silence = (SAMPLE["audio"][name] for name in ("psnr", "baseline_silence"))
    figures = " | ".join([f"{audio:.1f}"] * 3)
    assert page.count(f"| audio | {figures} | silence {silence:.1f} | 53.6 | 26.2 |") == 1
    assert "1 of the paper's own 61 objects (the others have no scores yet):" in page
    assert r"| modal: frequencies \| may be 222% wrong | ycb_fork |" in page
    assert "| ycb_mug | 31 | 35 | 700 | not examined |" in page
    assert "| gso_rhino | up y, wall 0.003 | not recorded |" in page
    assert "| grid | 2 | 1.50 |" in page
    assert "| ycb_mug | 0.84 | 0.118 | 7.1 |" in page
    assert "real_views" not in page  # not drawn
    assert "## Modes against" not in page
    assert "## Benchmarks" not in page


def test_pictures_stand_above_the_licences_of_what_they_show(records):
    record = read_json(records / "real.json")
    write_json(records / "real.json", record | {"pictures": True})
    page = results.render("real.md", records)
    pictures = "\n\n".join(rf"!\[[^\]]+\]\(real_{sense}.webp\)" for sense in ("views", "touches", "sounds"))
    caption = re.search(pictures + "\n\n(.*)", page)[1]
    for name in ("ycb", "gso"):
        source = REAL.sources[name]
        assert f"1 meshes of {source.title} ({source.attribution}; [CC BY 4.0](https://creative" in caption
    assert "Poly Haven" not in caption


def test_modes_and_benchmarks_are_on_the_page_once_measured(records):
    row = read_json(records / "modal_reference.json")["rows"][1]
    lacking = {"object": "ycb_plate", "failed": "not compared yet"}
    drawn = {"drawn": ["gso_frypan", "ycb_plate"], "seed": 3, "candidates": 61}
    write_json(records / "real_modes.json", drawn | {"rows": [row, lacking]})
    benchmarks = read_json(records / "benchmarks_hundred.json")
    write_json(records / "benchmarks_real.json", benchmarks | {"pictures": ["real_confusion"]})
    page = results.render("real.md", records)
    assert "2 of the 61 objects of the paper were drawn with seed 3" in page
    assert f"| {row['object']} | {row['resolution']}^3 |" in page
    assert "| ycb_plate | failed: not compared yet |" in page
    assert all(f"### {table['title']}\n" in page for table in benchmarks["tables"])
    assert "![real_confusion](real_confusion.webp)" in page


def test_sheets_have_room_for_names_of_two_lines(tmp_path, monkeypatch):
    class File:
        key = "gso_bia_porcelain_ramekin_glazed_rim"

    picture = np.zeros((112, 112, 3), np.uint8)
    for name in ("seen", "felt", "heard"):
        monkeypatch.setattr(catalogue, name, lambda file: picture)
    monkeypatch.setattr(catalogue.ObjectFile, "load", lambda path: File)
    catalogue.sheets({f"{File.key[:-2]}{i}": tmp_path for i in range(11)}, tmp_path, "real")
    pages = {path.name: np.asarray(Image.open(path)) for path in tmp_path.glob("*.webp")}
    assert set(pages) == {"real_views.webp", "real_touches.webp", "real_sounds.webp"}
    height = 112 + 2 * catalogue.LINE + 2
    assert pages["real_views.webp"].shape == (2 * (height + 4) + 4, 10 * 116 + 4, 3)
    lines = pages["real_views.webp"][4 + 112 : 4 + height, 4 : 4 + 112].min((1, 2)) < 128
    assert lines[: catalogue.LINE].any()
    assert lines[catalogue.LINE + 2 :].any()


def test_a_place_without_a_file_keeps_its_earlier_picture(tmp_path, monkeypatch):
    for name in ("seen", "felt", "heard"):
        monkeypatch.setattr(catalogue, name, lambda shade: np.full((112, 112, 3), shade, np.uint8))
    monkeypatch.setattr(catalogue.ObjectFile, "load", int)
    keys = [f"o{i}" for i in range(12)]

    def shades(keep=True, **files):
        catalogue.sheets({key: files.get(key) for key in keys}, tmp_path, "real", keep)
        pictures, places = catalogue.cut(tmp_path / "real_views.webp", 12, 112 + catalogue.LINE + 2)
        return places, pictures[:, 56, 56, 0].tolist()

    white = [255] * 12
    first = [255, 255, 40, *white[:9]]
    assert shades(o2=40) == (10, pytest.approx(first, abs=3))  # no rows without pictures at the end
    second = [255, 100, 40, *white[:7], 50, 255]
    assert shades(o1=100, o10=50) == (12, pytest.approx(second, abs=3))
    third = [10, 100, 40, *white[:7], 80, 255]
    assert shades(o0=10, o10=80) == (12, pytest.approx(third, abs=3))
    assert shades(keep=False, o1=30) == (10, pytest.approx([255, 30, *white[:10]], abs=3))


def test_objects_are_drawn_by_the_seed_alone():
    keys = sorted(key for key, entry in REAL.objects.items() if entry.id is not None)
    drawn = modal_reference.draw(keys, 10, 0)
    assert drawn == modal_reference.draw(keys, 10, 0) == sorted(set(drawn))
    assert len(drawn) == 10
    assert set(drawn) < set(keys)
    assert drawn != modal_reference.draw(keys, 10, 1)
    assert modal_reference.draw(keys[:3], 10, 0) == keys[:3]
    often = np.mean([keys[0] in modal_reference.draw(keys, 10, seed) for seed in range(2000)])
    assert often == pytest.approx(10 / 61, abs=0.03)


def test_candidates_are_of_the_paper_whatever_became_of_them(workspace):
    assert modal_reference.candidates(workspace) == ["ycb_fork", "ycb_mug"]


def test_a_solid_of_a_workspace_is_compared_with_its_material_and_size(workspace, tmp_path, monkeypatch):
    sides = (1.0, 0.5, 0.3)
    write_surface(workspace / "build/ycb_mug/solid.ply", box(sides))
    monkeypatch.setattr(
        modal_reference, "fill", lambda surface, most: (tetrahedral_box(sides, (8, 4, 3)), surface)
    )
    job = ("ycb_mug", "fine", str(workspace), str(tmp_path))
    modal_reference.reference(*job)
    row = modal_reference.compare("ycb_mug", str(workspace), str(tmp_path))
    assert row["difference_max"] < 0.01
    assert row["lacking"] == 0
    assert row["reference_hz"][0] > 5000
    values = json.loads((workspace / "params.yaml").read_text())
    for changed, factor in (
        ({"scale": 0.0585}, 2.0),
        ({"material": {"base": "steel", "density": 31_400.0}}, 0.5),
    ):
        entry = values["objects"]["ycb_mug"] | changed
        write_json(workspace / "params.yaml", values | {"objects": {"ycb_mug": entry}})
        modal_reference.reference(*job)
        hz = modal_reference.meshes("ycb_mug", str(tmp_path))[0]["hz"][0]
        assert hz == pytest.approx(factor * row["reference_hz"][0], rel=1e-3)


def test_only_drawn_objects_are_compared_and_none_is_left_out(workspace, tmp_path, monkeypatch, capsys):
    path = tmp_path / "modes.json"
    words = ["--workspace", str(workspace), "--cache", str(tmp_path), "--json", str(path)]
    assert measure("modal_reference", "gso_rhino", *words, monkeypatch=monkeypatch) == 2
    assert "not drawn: gso_rhino; drawn are ycb_fork, ycb_mug" in capsys.readouterr().err
    assert not path.exists()
    write_json(path, {"rows": [{"object": "ycb_bowl", "failed": "of another draw"}]})
    assert measure("modal_reference", "ycb_fork", *words, monkeypatch=monkeypatch) == 1
    record = read_json(path)
    assert (record["drawn"], record["seed"], record["candidates"]) == (["ycb_fork", "ycb_mug"], 0, 2)
    fork, mug = record["rows"]
    assert "solid.ply does not exist" in fork["failed"]
    assert mug == {"object": "ycb_mug", "failed": "not compared yet"}
    assert record["missed"][1] == "ycb_mug: not compared yet"


@pytest.mark.parametrize(
    ("difference", "estimate", "known", "drawn"),
    [
        (0.01, 0.006, True, True),
        (0.01, 0.004, True, False),
        (0.01, 0.003, False, False),
        (0.01, 0.021, True, False),
        (0.001, 0.0001, True, True),  # as small as the reference's own error
        (0.001, 0.0039, True, True),
        (0.001, 0.0041, True, False),
    ],
)
def test_estimates_of_drawn_objects_are_within_a_factor_of_two(difference, estimate, known, drawn):
    rows = [{"object": "a", "difference_max": difference, "estimate_max": estimate}]
    assert (modal_reference.misses(rows) == []) == known
    assert (modal_reference.misses(rows, modal_reference.DRAWN) == []) == drawn


def test_eight_of_ten_drawn_objects_are_close():
    rows = [{"object": str(i), "difference_max": 0.01, "estimate_max": 0.01} for i in range(10)]
    for row in rows[:2]:
        row |= {"difference_max": 0.03, "estimate_max": 0.03}
    assert modal_reference.misses(rows, modal_reference.DRAWN) == []
    rows[2] |= {"difference_max": 0.03, "estimate_max": 0.03}
    assert modal_reference.misses(rows, modal_reference.DRAWN) == ["7 of 10 objects within 2%"]
    rows[0] |= {"difference_max": 0.05, "estimate_max": 0.05}
    assert modal_reference.misses(rows, modal_reference.DRAWN)[1:] == ["0: 5.0% apart, target 4%"]
