"""Tables of the benchmarks of a hundred objects, and what misses its target: `python perf/benchmarks.py OUT`.

OUT are the folders that `objectfolder bench` wrote its results to. With `--keep`, the record of `--json`
keeps what it says of other benchmarks. Exits with 1 if a target is missed, and with 2 if there is no result.
"""

import argparse
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from harness import exit_with_verdict, parsed, write_record
from PIL import Image
from results import object_tables, shared_tables
from rich.console import Console
from rich.table import Table

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import atomic, read_json
from objectfolder.benchmarks.reporting.published import RETRIEVAL
from objectfolder.benchmarks.run import list_tasks
from objectfolder.workspace.layout import Benchmarks

#: Least accuracy; those of several modalities are the paper's.
RECOGNIZED = {"V": 0.95, "A": 0.99, "T": 0.45, "VA": 0.995, "VT": 0.972, "AT": 0.99, "VAT": 0.998}
FOUR_TOUCHES = 0.75
#: Least mean average precision of sight and sound; with touch, the paper's.
RETRIEVED = {"V->A": 0.95, "A->V": 0.95}
UNSEEN_CHANCES = 3  #: of V->A: how many times chance
#: Pictures by task and split.
FIGURES = {
    "recognize_seen": "confusion",
    "reconstruct_seen": "shapes",
    "reconstruct_unseen": "unseen_shapes",
}
SIDE = 1400  #: of a picture at most, pixels
RECONSTRUCTED = {"V": 0.75, "A": 0.85, "VA": 0.88}  #: least IoU
WORDS = {
    "recognize_seen": "V 95, A 99, T 45, four touches 75 % recognized, senses together as the paper's",
    "retrieve_seen": "sight and sound retrieved 0.95 by cosine, with touch as the paper's",
    "retrieve_unseen": "V->A of unseen objects three times chance, all directions above CCA",
    "reconstruct_seen": "0.75, 0.85, 0.88 IoU from V, A, VA",
    "reconstruct_unseen": "unseen objects from a view better than the average shape",
}


def found_in(
    folders: Sequence[Benchmarks], task: str, split: str
) -> tuple[Benchmarks, dict[str, Any]] | None:
    """Return the first folder with a result of the present version, and that result."""
    for folder in folders:
        if (path := folder.result(task, split)).is_file():
            scores = read_json(path)
            try:
                list_tasks()[task].tables({split: scores})
            except ObjectFolderError as error:
                print(f"left out: {path}: {error}")
            else:
                return folder, scores
    return None


def command_of(table: Mapping[str, Any]) -> str:
    """Return the command of a table, for any number of seeds."""
    return re.sub(r" --seeds \d+", "", table["command"])


def merged(earlier: Sequence[dict], new: Mapping[str, dict]) -> list[dict]:
    """Replace tables of the same commands, and put others before the first of the same kind, or last."""
    tables = [new.get(command_of(table), table) for table in earlier]
    known = {command_of(table) for table in earlier}
    for command, table in new.items():
        if command not in known:
            kind = table["title"].partition(" ")[0]
            alike = (n for n, other in enumerate(tables) if other["title"].startswith(kind))
            tables.insert(next(alike, len(tables)), table)
    return tables


def missed(results: Mapping[str, dict[str, Any]]) -> Iterator[str]:
    """Yield what is below its target, and by how much; of the tasks that ran, named as in `WORDS`."""

    def scores(task: str, split: str) -> dict[str, Any]:
        return results.get(f"{task}_{split}", {})

    if found := scores("recognize", "seen"):
        measured = {name: found[name]["accuracy"] for name in RECOGNIZED}
        measured["four touches"] = found["touches"]["4"]["accuracy"]
        for name, least in (RECOGNIZED | {"four touches": FOUR_TOUCHES}).items():
            if measured[name] < least:
                yield f"{name} recognized {100 * measured[name]:.1f} %, target {100 * least:g} %"
    if found := scores("retrieve", "seen").get("directions"):
        for direction, (paper, _) in RETRIEVAL.figures.items():
            least = RETRIEVED.get(direction, paper)
            score = found[direction]
            if score["map"] < least:
                yield f"{direction} retrieved {score['map']:.3f}, target {least:g}"
    if found := scores("retrieve", "unseen").get("directions"):
        for direction in RETRIEVAL.figures:
            score = found[direction]
            if score["map"] <= score["cca"]:
                yield f"{direction} of unseen objects {score['map']:.3f}, CCA {score['cca']:.3f}"
        score = found["V->A"]
        if score["map"] < UNSEEN_CHANCES * score["chance"]:
            yield f"V->A of unseen objects {score['map'] / score['chance']:.1f} times chance"
    if found := scores("reconstruct", "seen"):
        for variant, least in RECONSTRUCTED.items():
            if found[variant]["iou"] < least:
                yield f"{variant} reconstructed {found[variant]['iou']:.3f} IoU, target {least:g}"
    if found := scores("reconstruct", "unseen"):
        net, average = found["V"], found["average_shape"]
        for name, worse in (
            ("iou", net["iou"] <= average["iou"]),
            ("chamfer_l1", net["chamfer_l1"] >= average["chamfer_l1"]),
        ):
            if worse:
                yield f"unseen from a view: {name} {net[name]:.4f}, average shape {average[name]:.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, nargs="+")
    parser.add_argument("--preset", default="laptop", help="of the benchmarks")
    parser.add_argument("--options", default="", help="other options that they were called with")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--keep", action="store_true", help="keep what the record says of other benchmarks")
    parser.add_argument(
        "--pictures",
        type=Path,
        metavar="DOCS",
        help="folder for the figures of recognition and reconstruction",
    )
    parser.add_argument("--name", default="catalogue", help="start of the names of these figures")
    arguments = parsed(parser)
    folders, keys, console = [Benchmarks(out) for out in arguments.out], {}, Console()
    options = f" {arguments.options}" if arguments.options else ""
    by_command: dict[str, dict] = {}
    for folder in folders:
        shown = [*shared_tables(folder, arguments.preset, keys, options)]
        shown += object_tables(folder, arguments.preset, options)
        for table in shown:
            by_command.setdefault(command_of(table), table)
    if not by_command:
        console.print(f"no results of `objectfolder bench` in {', '.join(map(str, arguments.out))}")
        sys.exit(2)
    for record in by_command.values():
        table = Table(title=record["title"])
        for name in record["columns"]:
            table.add_column(name)
        for row in record["rows"]:
            table.add_row(*row)
        console.print(table)
    measured = {name: found for name in WORDS if (found := found_in(folders, *name.rsplit("_", 1)))}
    drawn = []
    for run, name in FIGURES.items():
        found = measured.get(run)
        if arguments.pictures and found and (figure := found[0].sheet(*run.rsplit("_", 1))).is_file():
            drawn.append(f"{arguments.name}_{name}")
            with Image.open(figure) as page, atomic(arguments.pictures / f"{drawn[-1]}.webp") as temporary:
                page.thumbnail((SIDE, SIDE))
                page.convert("RGB").save(temporary, "webp", quality=80, method=6)
    keep = arguments.keep and arguments.json is not None and arguments.json.is_file()
    earlier = read_json(arguments.json) if keep else {"tables": [], "verdicts": {}, "objects": 0}
    verdicts = {name: list(missed({name: scores})) for name, (_, scores) in measured.items()}
    verdicts = earlier["verdicts"] | verdicts
    below = [text for name in WORDS for text in verdicts.get(name, [])]
    words = "; ".join(text for name, text in WORDS.items() if name in verdicts)
    unmeasured = [text for name, text in WORDS.items() if name not in verdicts]
    record = {
        "objects": max(len(keys), earlier["objects"]),
        "unmeasured": unmeasured,
        "verdicts": verdicts,
        "pictures": sorted({*earlier.get("pictures", []), *drawn}),
        "tables": merged(earlier["tables"], by_command),
    }
    write_record(arguments.json, record, words, below)
    if unmeasured:
        console.print(f"not measured: {'; '.join(unmeasured)}", markup=False, soft_wrap=True)
    exit_with_verdict(below, console)


if __name__ == "__main__":
    main()
