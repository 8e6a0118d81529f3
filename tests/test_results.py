"""docs/results.md is what its template and the committed records give."""

import json
import shutil

import pytest
import results
from harness import encoded, write_record

from objectfolder.io import read_json, write_json

RECOGNITION = {
    "keys": ["blue_vase", "scan"],
    "objects": 2,
    "V": {"accuracy": 0.5, "seeds": [0.4, 0.6], "interval_95": 0.1},
    "chance": {"majority": 0.5},
    "rows": {"train": 80, "val": 10, "test": 10},
    "duplicates": {"train": {"test": 0}},
}
RATE = {"rate": 0.5, "interval_95": [0.4, 0.6], "seeds": [0.5]}
GRASPING = dict.fromkeys(results.tables.GRASP_POLICIES, RATE) | {
    "rollouts": 20,
    "episodes": 300,
    "presses": 40,
}
RUN = {"seconds": 120.0, "cpu_seconds": 180.0, "threads": 2, "machine": "a processor"}


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Copy of what results.py reads."""
    for name in ("params", "catalogs", "docs/results"):
        shutil.copytree(results.ROOT / name, tmp_path / name)
    shutil.copy(results.ROOT / "params.yaml", tmp_path)
    monkeypatch.setattr(results, "ROOT", tmp_path)
    monkeypatch.setattr(results, "RECORDS", tmp_path / "docs/results")
    return tmp_path


def test_the_page_is_up_to_date():
    assert results.PAGE.read_text() == results.render(), "run `python perf/results.py`"


def test_records_are_encoded_as_they_are_written():
    for path in results.RECORDS.glob("*.json"):
        assert path.read_text() == encoded(json.loads(path.read_text())) + "\n", path.name


def test_a_failed_object_is_left_out_of_every_table(repository):
    page = results.render(results.RECORDS)
    for path in results.RECORDS.glob("*.json"):
        record = read_json(path)
        for rows in record.values() if isinstance(record, dict) else ():
            if isinstance(rows, list) and isinstance(rows[0], dict) and "object" in rows[0]:
                rows.append({"object": "crashed_object", "failed": "a reason"})
        if path.stem not in ("query", "grasp_speed"):  # these stop at the first failure
            write_record(path, record)
    assert results.render(results.RECORDS) == page


def test_unknown_optional_figures_are_dashes(repository):
    path = results.RECORDS / "modal.json"
    record = read_json(path)
    del record["peers"][0]["deepmodal_s"], record["objects"][0]["synthesis_ms_per_sound"]
    write_record(path, record)
    page = results.render(results.RECORDS)
    assert "| gso_salad_plate | 32,697 | 71 | 5.6 | fails | - | 31.4 | 5.6 |" in page
    assert "| gso_salad_plate | 32^3 | 32,697 | 71 | 8.6 | 770 | - | - | - |" in page


def test_collecting_nothing_changes_nothing(repository):
    before = {path: path.read_bytes() for path in results.RECORDS.glob("*.json")}
    results.collect()
    assert {path: path.read_bytes() for path in results.RECORDS.glob("*.json")} == before


def test_scores_and_benchmarks_are_collected(repository):
    scores = read_json(results.RECORDS / "scores.json")["objects"]
    write_json(repository / "metrics/cup.json", scores["mug"])
    folder = results.Benchmarks(repository / "benchmarks/quick")
    (split,) = results.splits_of("recognize")
    write_json(folder.result("recognize", split), RECOGNITION)
    write_json(folder.machine("recognize", split), RUN)
    write_json(folder.result("grasp_policy", "cup"), GRASPING)
    write_json(folder.machine("grasp_policy", "cup"), RUN)
    folder.curve("grasp_policy", "cup").write_text("")
    results.collect()
    page = results.render(results.RECORDS)
    vision = scores["mug"]["vision"]
    assert f"| cup | {vision['psnr']:.2f} | {vision['noise_floor']:.2f} |" in page
    assert (
        f"| polyhaven_teapot | {scores['polyhaven_teapot']['vision']['psnr']:.2f} |" not in page
    )  # the record holds the scores of one build
    assert "Preset `quick`, seed 0." in page
    assert "1 objects of catalogs/procedural.yaml: blue_vase.\n1 scanned objects: scan." in page
    assert "`objectfolder bench recognition --preset quick`: 2 min with 2 thread(s), 3 CPU min" in page
    assert "| V | 50.0 ± 10.0 | 40.0 60.0 | 94.8 |" in page
    assert "`objectfolder bench grasping --preset quick --seeds 1 build/cup`: 2 min" in page
    assert "`objectfolder bench grasping --preset quick build/tonic_bottle`: 85 min" in page  # kept
