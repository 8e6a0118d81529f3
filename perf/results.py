"""Render the pages of results, docs/results.md and others: `python perf/results.py [--collect [DIR]]`.

The pages, and the tables of objects (.csv), are perf/pages/**/*.j2, filled with the records in
docs/results/. Most records are the `--json` output of another script in perf/. With `--collect`, the scores
that `objectfolder build` and `objectfolder bench` left in metrics/ and benchmarks/ of a workspace, by default
the repository, update the records scores and robots first. `perf/benchmarks.py` records the benchmarks of a
hundred objects.
"""

import argparse
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from statistics import mean, median
from typing import Any

from harness import rewrite, this_run, write_record
from jinja2 import Environment, FileSystemLoader, StrictUndefined, Undefined
from query import FIGURES, significant
from ruamel.yaml import YAML

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import read_json, write_text
from objectfolder.benchmarks.reporting import published
from objectfolder.benchmarks.reporting.tables import Table
from objectfolder.benchmarks.tasks.running import machine
from objectfolder.benchmarks.tasks.task import Task, find_task
from objectfolder.workspace.layout import SPLITS, Benchmarks
from objectfolder.workspace.presets import read_preset
from objectfolder.workspace.stages import BENCHMARKS

ROOT = Path(__file__).parents[1]
RECORDS = ROOT / "docs" / "results"
TEMPLATES = ROOT / "perf" / "pages"
#: What is left out as long as there is no such record.
OPTIONAL = {"real.md": "real.json", "real_objects.csv": "real.json"}
PAGES = [
    page
    for page in sorted(path.relative_to(TEMPLATES).as_posix()[:-3] for path in TEMPLATES.rglob("*.*.j2"))
    if page not in OPTIONAL or (RECORDS / OPTIONAL[page]).is_file()
]
PRESETS = ("quick", "laptop", "standard", "faithful", "faithful-small")
EXEMPT = {
    "render_views": "renderer",
    "modal": "allow_uncertain",
}  #: what traces the same paths, what is refused
#: Which end of a score over objects is the worst; other figures of an object are no scores.
BETTER = {
    **dict.fromkeys(("psnr", "psnr_pooled", "psnr_worst", "psnr_lit_foreground", "ssim"), min),
    **dict.fromkeys(("psnr_mean", "psnr_own_max", "psnr_median", "psnr_unobstructed", "psnr_contact"), min),
    **dict.fromkeys(("psnr_median_unobstructed", "baseline_white", "baseline_silence"), min),
    **dict.fromkeys(("baseline_mean_image", "baseline_noise", "noise_floor", "noise_floor_lit"), min),
    **dict.fromkeys(("gain_error", "gain_error_frobenius", "gain_error_worst", "force_error"), max),
    "baseline_nearest": max,
}
#: Objects by which `slope_smoothing` of tacto_digit was chosen (docs/sensors.md), left out of its means.
FITTED = ("ycb_mug", "ycb_power_drill", "polyhaven_teapot", "ycb_wood_block")
#: What is trained with every seed, of the scores of a task on single objects.
TRAINED: dict[str, Callable[[dict], dict]] = {
    "localize": lambda scores: scores["TA"]["net"],
    "slide": lambda scores: scores["refine"]["net"]["T"],
    "grasp_policy": itemgetter("touch"),
    "reach": itemgetter("ppo"),
    "metaworld_reach": itemgetter("ppo"),
}


#: Published figures in tables that earlier versions recorded.
RECORDED_ONCE = ("paper", "ObjectFolder Benchmark")
RECORDED_NOTE = r" Chance among the 200 objects of the ObjectFolder Benchmark is lower\."


def bench_commands() -> dict[str, tuple[Task, str, str]]:
    """Return each benchmark task, the command that runs it, and the section of its parameters, by name."""
    found = {}
    for name in BENCHMARKS:
        task = find_task(name)
        command = name.replace("_", "-")
        found[name] = task, command, name
        if task.variant is not None:
            other, value = task.variant.task, task.variant.values[1]
            option = f" --{task.variant.option}" + (f" {value}" if isinstance(value, str) else "")
            found[other.name] = other, command + option, name
    return found


def render(page: str, records: Path = RECORDS) -> str:
    """Return a page or a table, one of `PAGES`: paths in docs/."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "by_commit": by_commit,
        "cell": cell,
        "few": few,
        "median": lambda values: median(values),
        "measured": lambda rows: [row for row in rows if "failed" not in row],
        "number": number,
        "over_objects": over_objects,
        "percent": percent,
        "quoted": quoted,
        "spread": spread,
        "rule": lambda columns: "|---" * len(columns) + "|",
        "score": score,
        "significant": significant,
    }
    values = {path.stem: with_published(read_json(path)) for path in sorted(records.glob("*.json"))}
    template = environment.get_template(f"{page}.j2")
    text = template.render(
        **values, records=values, published=published, query_figures=FIGURES, fitted=FITTED
    )
    return re.sub(r"\n{3,}", "\n\n", text).rstrip("\n") + "\n"


def with_published(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a record with the figures of `published` in its tables, instead of those recorded earlier."""
    if "tables" not in record:
        return record
    return {**record, "tables": [_beside(table, record.get("objects")) for table in record["tables"]]}


def _beside(table: dict[str, Any], objects: int | None) -> dict[str, Any]:
    kept = [n for n, name in enumerate(table["columns"]) if not name.startswith(RECORDED_ONCE)]
    columns, *rows = (tuple(row[n] for n in kept) for row in (table["columns"], *table["rows"]))
    ours = Table(table["title"], columns, rows, re.sub(RECORDED_NOTE, "", table["note"]))
    words = table["command"].removeprefix("objectfolder bench ")
    commands = {command: task for task, command, _ in bench_commands().values()}
    task = commands[max((name for name in commands if words.startswith(f"{name} ")), key=len)]
    named = [split for split in task.splits if re.search(rf"\b{split}\b", table["title"])]
    split = next(iter([*named, *task.splits]), None)  # titles of a task with one split do not name it
    counts = re.match(r"(\d+) rows to train with, (\d+) for validation, (\d+) for the test", ours.note)
    rows_of = dict(zip(SPLITS, map(int, counts.groups()))) if counts else {}
    shown = task.with_published(ours, split, {"objects": objects, "rows": rows_of})
    return {**table, "columns": list(shown.columns), "rows": shown.rows, "note": shown.note}


def by_commit(objects: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Return the objects that each commit built; those of unknown ones as "earlier"."""
    built: dict[str, list[str]] = defaultdict(list)
    for key, row in objects.items():
        built[row.get("commit", "earlier")].append(key)
    return list(built.items())


def cell(tables: Sequence[Mapping[str, Any]], title: str, column: str, *row: str) -> str:
    """Return what a page's text quotes: a cell of the one table whose title starts with `title`.

    `row` is the start of the cell's row.
    """
    (table,) = (table for table in tables if table["title"].startswith(title))
    (cells,) = (cells for cells in table["rows"] if tuple(cells[: len(row)]) == row)
    return cells[table["columns"].index(column)]


def over_objects(
    objects: Mapping[str, Mapping[str, Any]], sense: str, column: str
) -> dict[str, float] | None:
    """Return mean, median and worst of a score over the objects that have it; None for what is no score."""
    found = [scores[sense][column] for scores in objects.values() if scores[sense].get(column) is not None]
    if column not in BETTER or not found:
        return None
    return {"mean": mean(found), "median": median(found), "worst": BETTER[column](found, key=float)}


def spread(rows: list[dict[str, Any]], name: str, better: str = "more") -> dict[str, Any]:
    """Return mean, median and worst of a figure over the rows that have it; ``better`` is more or less.

    Nothing where no row has it.
    """
    found = [row[name] for row in rows if row[name] is not None]
    worst = min if better == "more" else max
    if not found:
        return dict.fromkeys(("mean", "median", "worst"))
    return {"mean": mean(found), "median": median(found), "worst": worst(found)}


def number(value: Any, spec: str, missing: str = "-") -> str:
    """Format a figure; counts stay integers."""
    if value is None or isinstance(value, Undefined):
        return missing
    return format(value, spec)


def percent(value: float | None, spec: str, missing: str = "-") -> str:
    """Format a share in percent."""
    return number(None if value is None else 100 * value, spec, missing)


def quoted(text: str) -> str:
    """Return a cell of a CSV file that may hold commas and quotes."""
    return '"' + text.replace('"', '""') + '"'


def few(missed: Sequence[str]) -> str:
    """Return what missed its target: all of at most two figures, else their number and a short one."""
    if len(missed) <= 2:
        return "; ".join(missed)
    return f"{len(missed)} figures, such as {next((text for text in missed if len(text) < 60), missed[0])}"


def score(value: Any) -> str:
    """Format a score; counts have no decimals."""
    digits = (".3f" if abs(value) < 2 else ".2f") if isinstance(value, float) else ""
    return number(value, digits)


def collect(workspace: Path) -> None:
    """Update the records of scores and benchmarks from what builds and benchmarks left in a workspace."""
    metrics = {path.stem: read_json(path) for path in sorted((workspace / "metrics").glob("*.json"))}
    if metrics:
        values = read_yaml(workspace / "params.yaml")
        preset = preset_of(values)
        path = RECORDS / ("scores.json" if preset == "quick" else f"scores_{preset}.json")
        metrics = {key: row | {"commit": this_run()["commit"]} for key, row in metrics.items()}
        if path.is_file():  # hours in all: a few objects at a time
            metrics = read_json(path)["objects"] | metrics
        record = {"machine": machine("cpu"), "preset": preset, "seed": values["seed"]}
        write_record(path, record | {"objects": dict(sorted(metrics.items()))})
    folders = {preset: Benchmarks(workspace / "benchmarks" / preset) for preset in PRESETS}
    record = read_json(RECORDS / "robots.json")
    tables = record["tables"] + [
        table for preset, folder in folders.items() for table in object_tables(folder, preset)
    ]
    record["tables"] = list({table["command"]: table for table in tables}.values())
    rewrite(RECORDS / "robots.json", record)


def shared_tables(folder: Benchmarks, preset: str, keys: dict[str, None], options: str) -> Iterator[dict]:
    """Yield the tables of tasks over many objects, and add these objects to `keys`."""
    sections = read_preset(preset)[0]
    for task, (declared, command, section) in bench_commands().items():
        for split in declared.splits if task != "grasp_stability" else ():
            if folder.result(task, split).is_file():
                scores = read_json(folder.result(task, split))
                keys |= dict.fromkeys(scores["keys"])
                option = f" --split {split}" if len(declared.splits) > 1 else ""
                several = (scores.get("directions") or scores).values()
                trained = next(score for score in several if isinstance(score, dict) and "seeds" in score)
                option += seeds_option(trained, sections[section])
                runs = [read_json(folder.machine(task, split))]
                try:
                    (shown,) = declared.tables({split: scores}, published=False)
                except ObjectFolderError as error:
                    print(f"left out: {folder.result(task, split)}: {error}")
                    continue
                yield table_record(shown, f"{command} --preset {preset}{option}{options}", runs)


def object_tables(folder: Benchmarks, preset: str, options: str = "") -> Iterator[dict]:
    """Yield the tables of grasp stability and of tasks on single objects."""
    sections = read_preset(preset)[0]
    stability = find_task("grasp_stability")
    for split in stability.splits:
        if folder.result("grasp_stability", split).is_file():
            scores = read_json(folder.result("grasp_stability", split))
            found = next(iter(scores["sizes"].values()))
            command = f"grasp-stability --preset {preset} --split {split}"
            command += seeds_option(found["V"], sections["grasp_stability"]) + options
            runs = [read_json(folder.machine("grasp_stability", split))]
            record = table_record(*stability.tables({split: scores}, published=False), command, runs)
            record["note"] += f"\n\nObjects: {', '.join(scores['keys'])}."
            yield record
    for task, trained in TRAINED.items():
        declared, command, section = bench_commands()[task]
        ran = [path.stem.removeprefix(f"{task}_") for path in sorted(folder.dir.glob(f"{task}_*.csv"))]
        scores = {
            key: read_json(folder.result(task, key)) for key in ran if folder.machine(task, key).is_file()
        }
        alike = defaultdict(list)  # one table of what was asked alike
        for key, found in scores.items():
            seeds = seeds_option(trained(found), sections[section])
            alike[seeds, str(found.get("contacts"))].append(key)
        for (seeds, _), keys in alike.items():
            runs = [read_json(folder.machine(task, key)) for key in keys]
            words = [f"{command} --preset {preset}{seeds}{options}", *(f"build/{key}" for key in keys)]
            shown = declared.tables({key: scores[key] for key in keys}, published=False)
            yield table_record(*shown, " ".join(words), runs)


def table_record(shown: Table, command: str, runs: list[dict]) -> dict:
    """Return a table with the command that prints it and the duration of its runs."""
    return {
        "title": shown.title,
        "command": f"objectfolder bench {command}",
        "minutes": [round(run["seconds"] / 60) for run in runs],
        "threads": runs[0]["threads"],
        "cpu_minutes": round(sum(run["cpu_seconds"] for run in runs) / 60),
        "machine": runs[0]["machine"],
        "date": runs[0].get("date", ""),
        "columns": list(shown.columns),
        "rows": [list(row) for row in shown.rows],
        "note": shown.note,
    }


def seeds_option(score: dict, section: dict) -> str:
    """Return the option ``--seeds`` of a run whose number of seeds is not the preset's."""
    count = len(score["seeds"])
    return "" if count == section["seeds"] else f" --seeds {count}"


def preset_of(values: dict) -> str:
    """Return the preset whose sections all agree with the parameters, but for `EXEMPT`."""
    for name in PRESETS:
        sections = read_preset(name)[0]
        if all(scored(key, values.get(key)) == scored(key, sections[key]) for key in sections):
            return name
    return "custom"


def scored(key: str, section: Any) -> Any:
    """Return what changes scores of a section of the parameters."""
    return {k: v for k, v in section.items() if k != EXEMPT[key]} if key in EXEMPT and section else section


def read_yaml(path: str | Path) -> dict:
    """Return a YAML file; paths are relative to the repository."""
    return YAML(typ="safe").load(ROOT / path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--collect",
        type=Path,
        nargs="?",
        const=ROOT,
        metavar="DIR",
        help="read metrics/ and benchmarks/ of a workspace first; default: of the repository",
    )
    if workspace := parser.parse_args().collect:
        collect(workspace.resolve())
    for page in PAGES:
        write_text(ROOT / "docs" / page, render(page))


if __name__ == "__main__":
    main()
