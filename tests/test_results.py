"""Pages and tables of results are what their templates and the committed records give."""

import csv
import json
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import harness
import pytest
import results
from catalogue import mass_rows
from folders import contents
from harness import encoded, rewrite, write_record

from objectfolder.base.io import read_json, write_json
from objectfolder.benchmarks.reporting import published
from objectfolder.benchmarks.tasks import grasp_policy, localize

#: Records of rows that never fail, as their scripts stop at the first failure.
WITHOUT_FAILURES = ("compare", "faithful", "faithful_cpu", "real_photographs", "query", "grasp_speed")
ROWS = {"train": 80, "val": 10, "test": 10}
RECOGNITION = {
    **{"keys": ["blue_vase", "scan"], "objects": 2, "rows": ROWS, "duplicates": {"train": {"test": 0}}},
    **{"V": {"accuracy": 0.5, "seeds": [0.4, 0.6], "interval_95": 0.1}, "chance": {"majority": 0.5}},
}
MATERIALS = RECOGNITION | {"materials": ["steel", "wood"], "left_out": []}
MATERIALS |= {"chance": {"majority": 0.6, "uniform": 0.5}}
BELIEF = {"mean": 0.1, "median": 0.08, "together": 0.02, "interval_95": None, "seeds": [0.1]}
LOCALIZATION = {key: {"net": BELIEF, "nearest": BELIEF} for key in localize.SENSES}
LOCALIZATION |= {"constant": 0.4, "random": 0.5, "diameter": 1.25, "contacts": ROWS}
RATE = {"rate": 0.5, "interval_95": [0.4, 0.6], "seeds": [0.5]}
GRASPING = dict.fromkeys(grasp_policy.GRASP_POLICIES, RATE) | {"rollouts": 20, "episodes": 300, "presses": 40}
DOCS = results.ROOT / "docs"
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


def pages() -> str:
    """Return all pages, one after the other, from the records of the copy."""
    return "".join(results.render(page, results.RECORDS) for page in results.PAGES)


@pytest.mark.parametrize("page", results.PAGES)
def test_the_pages_are_up_to_date(page):
    assert (results.ROOT / "docs" / page).read_text() == results.render(page), "run `python perf/results.py`"


#: Heads of columns of published figures, and sentences that quote them.
THEIRS = re.compile(r"paper($|[:,]| reports$|'s CCA$)|ObjectFolder Benchmark")
QUOTED = re.compile(r"[Pp]aper (?:has|reports|scores) ([\d.]+\d) (?:dB|%)|Benchmark has ([^:]*), not comp")
PUBLISHED = [entry for entry in vars(published).values() if isinstance(entry, published.Published)]


def quoted(text: str) -> list[str]:
    """Return the published figures of a page: in columns that are named so, and in sentences."""
    found, columns = [], []
    for line in text.splitlines():
        found += ["".join(groups) for groups in QUOTED.findall(line)]
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        found += [cell for cell, theirs in zip(cells, columns) if theirs]
        heads = columns or [bool(THEIRS.match(name)) for name in cells]
        columns = heads if cells else []
    return [figure for words in found for figure in re.findall(r"(?<![\w.])\d+\.?\d*(?![\w.]*\d)", words)]


def figures_of(entries: list[published.Published]) -> set[str]:
    """Return the figures of entries as pages show them."""
    return {figure for entry in entries for row in entry.figures for figure in entry.cells(row)}


def unsourced(text: str) -> list[str]:
    """Return the published figures of a page whose source it does not name, or that nobody has published."""
    named = figures_of([entry for entry in PUBLISHED if entry.source in text])
    return [figure for figure in quoted(text) if figure not in named]


@pytest.mark.parametrize("page", sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")))
def test_no_published_figure_stands_without_its_source(page):
    found = unsourced((DOCS / page).read_text())
    if page == "paper.md":  # its claims are also counts and settings
        found = [figure for figure in found if figure in figures_of(PUBLISHED)]
    assert not found


def test_a_figure_without_its_source_is_found():
    table = "| a | paper, of 100 |\n|---|---|\n| V | 94.8 |\n"
    assert unsourced(table) == ["94.8"]
    assert unsourced(f"{table}\n{published.RECOGNITION.cited()}") == []
    assert unsourced("The paper reports 39.8 dB.") == ["39.8"]
    stale = "The ObjectFolder Benchmark has V->A 0.307, T->A 0.078, not comparable with 20 objects: "
    assert unsourced(stale + published.UNSEEN_RETRIEVAL.cited()) == ["0.307"]


def test_recorded_tables_show_what_is_published_now():
    table = {
        "command": "objectfolder bench retrieve --preset laptop --split unseen",
        "title": "Cross-sensory retrieval, unseen objects: mean average precision",
        "columns": ["direction", "mAP", "ObjectFolder Benchmark, 200 objects"],
        "rows": [["V->A", "0.5", "0.307"], ["V->X", "0.5", "-"]],
        "note": "700 rows to train with, 100 for validation, 200 for the test; none.",
    }
    (shown,) = results.with_published({"objects": 500, "tables": [table]})["tables"]
    assert shown["columns"] == ["direction", "mAP", "ObjectFolder Benchmark"]
    assert [*map(list, shown["rows"])] == [["V->A", "0.5", "0.206"], ["V->X", "0.5", "-"]]
    assert "cross-sensory-retrieval, README.md at 9e40fde" in shown["note"]
    (fewer,) = results.with_published({"objects": 100, "tables": [table]})["tables"]
    assert fewer["columns"] == ["direction", "mAP"]
    assert "has V->A 0.206" in fewer["note"]
    assert "not comparable with 20 test objects here" in fewer["note"]


def test_every_page_of_measurements_has_its_template():
    found = {path.relative_to(results.ROOT / "docs").as_posix() for path in DOCS.glob("measurements/*")}
    assert found == {page for page in results.PAGES if page.startswith("measurements/")}


def test_every_record_is_on_a_page_as_it_is_written_and_says_what_missed_its_targets():
    templates = "".join(path.read_text() for path in results.TEMPLATES.rglob("*.j2"))
    for path in results.RECORDS.glob("*.json"):
        record = json.loads(path.read_text())
        assert re.search(rf"\b{path.stem}\b[.)]", templates), path.name
        assert path.read_text() == encoded(record) + "\n", path.name
        assert ("targets" in record) == ("missed" in record), path.name


def test_the_first_page_is_short_and_lists_all_that_is_missed():
    page = results.render("results.md")
    assert len(page.splitlines()) <= 250
    records = [read_json(path) for path in results.RECORDS.glob("*.json")]
    assert sum(bool(record.get("missed")) for record in records) > 10
    listed = page.partition("## What is missed")[2]
    for missed in filter(None, (record.get("missed") for record in records)):
        assert results.few(missed) in listed
    elsewhere = "".join((DOCS / name).read_text() for name in results.PAGES if name != "results.md")
    assert not [text for record in records for text in record.get("missed", []) if text not in elsewhere]


def test_many_figures_that_missed_are_counted():
    assert results.few(["a", "b"]) == "a; b"
    assert results.few(["a " * 40, "b", "c"]) == "3 figures, such as b"


@pytest.mark.parametrize("table", [page for page in results.PAGES if page.endswith(".csv")])
def test_rows_of_a_table_have_all_its_columns_and_pages_show_it(table):
    heads, *rows = csv.reader(results.render(table).splitlines())
    assert {len(row) for row in rows} == {len(heads)}
    name = Path(table).name
    (page,) = (text for text in map(Path.read_text, DOCS.rglob("*.md")) if f":file: {name}\n" in text)
    assert f"[{name}]({name})" in page


def test_failures_stand_in_one_cell_of_a_table(repository):
    path = results.RECORDS / "catalogue.json"
    record = read_json(path)
    record["rows"][0] = {"object": "cup", "failed": 'no "solid", no sound'}
    rewrite(path, record)
    heads, first, *_ = csv.reader(results.render("catalogue_objects.csv", results.RECORDS).splitlines())
    assert first[:2] == ["cup", 'failed: no "solid", no sound']
    assert len(first) == len(heads)


def test_a_failed_object_is_printed_with_its_reason_in_every_table(repository):
    tables = 0
    for path in results.RECORDS.glob("*.json"):
        record = read_json(path)
        for name, rows in record.items():
            if isinstance(rows, list) and rows and isinstance(rows[0], dict) and "object" in rows[0]:
                if path.stem in WITHOUT_FAILURES:
                    continue
                rows.append({"object": f"crashed_{path.stem}_{name}", "failed": "a reason"})
                tables += 1
        rewrite(path, record)
    assert tables > 10
    assert len(set(re.findall(r"crashed_\w+", pages()))) == tables


def test_what_missed_its_target_is_printed(repository):
    record = read_json(results.RECORDS / "audio.json")
    rewrite(results.RECORDS / "audio.json", record | {"targets": "1 %", "missed": ["mug: 2 %", "die: 3 %"]})
    page = results.render("measurements/sound.md", results.RECORDS)
    assert "Targets: 1 %. **Missed**: mug: 2 %; die: 3 %." in page
    first = results.render("results.md", results.RECORDS)
    assert "sound.md#audionet-gains): mug: 2 %; die: 3 %." in first


def test_a_run_is_recorded_and_printed(repository, monkeypatch):
    words = [str(harness.ROOT / "perf/audio.py"), "mug", "--workspace", "/a/b/place"]
    monkeypatch.setattr(sys, "argv", words)
    path = results.RECORDS / "audio.json"
    write_record(path, {name: value for name, value in read_json(path).items() if name != "run"})
    run = read_json(path)["run"]
    assert run["command"] == "python perf/audio.py mug --workspace place"
    assert re.fullmatch(r"([0-9a-f]{7,}|unknown)\+?", run["commit"])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", run["date"])
    said = f"Run: `{run['command']}`; commit {run['commit']}; {run['machine']}; {run['date']}."
    assert said in results.render("measurements/sound.md", results.RECORDS)


def test_means_are_over_the_objects_that_have_a_score(repository):
    scores = {"a": {"touch": {"psnr": 40.0}}, "b": {"touch": {"psnr": 50.0}}, "c": {"touch": {"psnr": None}}}
    assert results.over_objects(scores, "touch", "psnr") == {"mean": 45.0, "median": 45.0, "worst": 40.0}
    errors = {key: {"audio": {"gain_error": value}} for key, value in (("a", 0.1), ("b", 0.3))}
    assert results.over_objects(errors, "audio", "gain_error")["worst"] == 0.3
    assert results.over_objects(errors, "audio", "modes") is None
    accuracy = [{"x": 3.0}, {"x": 1.0}, {"x": 8.0}]
    assert results.spread(accuracy, "x") == {"mean": 4.0, "median": 3.0, "worst": 1.0}
    assert results.spread([*accuracy, {"x": None}], "x", "less") == {"mean": 4.0, "median": 3.0, "worst": 8.0}


SCRIPTS = {path.stem for path in harness.ROOT.glob("perf/*.py")}
SCRIPTS -= {"harness", "results", "radiation", "recordings", "workspaces"}


@pytest.mark.parametrize("script", sorted(SCRIPTS))
@pytest.mark.slow
def test_a_script_without_arguments_prints_its_usage(script):
    command = [sys.executable, harness.ROOT / "perf" / f"{script}.py"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert done.stderr.startswith(f"usage: {script}.py")


def test_benchmarks_that_did_not_run_are_neither_met_nor_missed(tmp_path, monkeypatch, capsys):
    script = str(harness.ROOT / "perf/benchmarks.py")

    def verdict(*folders):
        words = [script, *map(str, folders), "--json", str(tmp_path / "x.json")]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as end:
            runpy.run_path(script, run_name="__main__")
        return int(end.value.code), re.sub(r"\s+", " ", capsys.readouterr().out)

    one, other = tmp_path / "one", tmp_path / "other"
    for folder in (one, other):
        folder.mkdir()
    assert verdict(one)[0] == 2
    write_json(one / "retrieve_seen.json", {"keys": ["mug"], "directions": {"V->A": {"seeds": [0.1]}}})
    for task in ("retrieve", "materials"):
        write_json(one / f"{task}_seen_machine.json", RUN)
    write_json(one / "materials_seen.json", MATERIALS)
    code, text = verdict(one)
    assert (code, "targets: met" in text) == (0, True)
    assert "so it is of an earlier version" in text
    assert "not measured: V 95, A 99" in text
    good = RECOGNITION["V"] | {"accuracy": 1.0}
    senses = dict.fromkeys(("A", "T", "VA", "VT", "AT", "VAT"), good)
    recognized = RECOGNITION | senses | {"touches": {"4": good}, "V": good | {"accuracy": 0.9}}
    write_json(other / "recognize_seen.json", recognized)
    write_json(other / "recognize_seen_machine.json", RUN)
    code, text = verdict(one, other)
    assert (code, "V recognized 90.0 %, target 95 %" in text) == (1, True)
    record = read_json(tmp_path / "x.json")
    assert [table["title"].split()[0] for table in record["tables"]] == ["Classification", "Instance"]
    assert [table["command"].partition(" bench ")[2] for table in record["tables"]] == [
        "recognize --label material --preset laptop --split seen --seeds 2",
        "recognize --preset laptop --seeds 2",
    ]
    assert record["tables"][1]["rows"][0] == ["V", "90.0 ± 10.0", "", "40.0 60.0"]
    assert len(record["unmeasured"]) == 4
    assert verdict(one, "--keep")[0] == 1
    assert read_json(tmp_path / "x.json")["tables"] == record["tables"]
    write_json(other / "recognize_seen.json", recognized | {"V": good})
    assert verdict(other, "--keep")[0] == 0
    kept = read_json(tmp_path / "x.json")
    assert kept["tables"][0] == record["tables"][0]
    assert kept["tables"][1] != record["tables"][1]
    assert kept["verdicts"] == {"recognize_seen": []}


def test_unknown_optional_figures_are_dashes(repository):
    path = results.RECORDS / "modal.json"
    record = read_json(path)
    del record["peers"][0]["deepmodal_s"], record["objects"][0]["synthesis_ms_per_sound"]
    rewrite(path, record)
    page = results.render("measurements/modal.md", results.RECORDS)
    for row in (
        r"\| 32,697 \| 71 \| [\d.]+ \| fails \| - \| [\d.]+ \| [\d.]+ \|",
        r"\| 32\^3 \| 32,697 \| 71 \| [\d.]+ \| \d+ \| - \| - \| - \|",
    ):
        assert re.search(rf"\| gso_salad_plate {row}", page)


def test_collecting_nothing_changes_nothing(repository):
    before = contents(results.RECORDS)
    results.collect(repository)
    assert contents(results.RECORDS) == before


def test_scores_and_benchmarks_are_collected(repository):
    scores = read_json(results.RECORDS / "scores.json")["objects"]
    write_json(repository / "metrics/cup.json", scores["mug"])
    folder = results.Benchmarks(repository / "benchmarks/quick")
    for task, found in (("localize", LOCALIZATION), ("grasp_policy", GRASPING)):
        write_json(folder.result(task, "cup"), found)
        write_json(folder.machine(task, "cup"), RUN)
        folder.curve(task, "cup").write_text("")
    results.collect(repository)
    table = csv.DictReader(results.render("measurements/scores.csv", results.RECORDS).splitlines())
    rows = {row["object"]: row for row in table if row["preset"] == "quick"}
    vision = scores["mug"]["vision"]
    assert float(rows["cup"]["vision psnr"]) == pytest.approx(vision["psnr"], abs=0.005)
    assert float(rows["cup"]["vision noise_floor"]) == pytest.approx(vision["noise_floor"], abs=0.005)
    # Other objects keep their scores, and the commit that built them.
    kept = scores["polyhaven_teapot"]["vision"]["psnr"]
    assert float(rows["polyhaven_teapot"]["vision psnr"]) == pytest.approx(kept, abs=0.005)
    collected = read_json(results.RECORDS / "scores.json")["objects"]
    commits = {key: row["commit"] for key, row in collected.items()}
    assert commits.pop("cup") == results.this_run()["commit"]
    assert commits == {key: row["commit"] for key, row in scores.items()}
    page = results.render("measurements/scores.md", results.RECORDS)
    assert "Preset `quick`, seed 0." in page
    page = results.render("measurements/robots.md", results.RECORDS)
    assert "`objectfolder bench localize --preset quick build/cup`: 2 min" in page
    assert "| touch + sound | cup | 10.0 | 8.0 | 2.0 |" in page
    assert "`objectfolder bench grasp-policy --preset quick --seeds 1 build/cup`: 2 min" in page
    assert "`objectfolder bench grasp-policy --preset quick build/tonic_bottle`: 86 min" in page  # kept


def test_computed_masses_stand_beside_real_ones(tmp_path):
    for key, kilograms in (("mug", 0.84), ("fork", 0.15), ("die", 0.3)):
        (tmp_path / "build" / key).mkdir(parents=True)
        write_json(tmp_path / "build" / key / "modal.json", {"mass_kg": kilograms})
    rows = mass_rows({"fork": 0.03, "plate": 0.2, "mug": 0.12}, tmp_path)  # the plate is not built
    assert rows == [
        {"object": "fork", "solid": 0.15, "real": 0.03, "ratio": pytest.approx(5)},
        {"object": "mug", "solid": 0.84, "real": 0.12, "ratio": pytest.approx(7)},
    ]
