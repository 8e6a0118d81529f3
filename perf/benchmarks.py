"""Tables of the benchmarks of a hundred objects, and what misses its target: `python perf/benchmarks.py OUT`.

OUT is the folder that `objectfolder bench` wrote its results to. Exits with 1 if a target is missed.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from harness import exit_with_verdict, parsed, write_record
from PIL import Image
from results import object_tables, shared_tables
from rich.console import Console
from rich.table import Table

from objectfolder.benchmarks.reporting import published
from objectfolder.io import atomic, read_json
from objectfolder.workspace.layout import Benchmarks

#: Least accuracy; those of several modalities are the paper's.
RECOGNIZED = {"V": 0.95, "A": 0.99, "T": 0.45, "VA": 0.995, "VT": 0.972, "AT": 0.99, "VAT": 0.998}
FOUR_TOUCHES = 0.75
#: Least mean average precision of sight and sound; with touch, the paper's.
RETRIEVED = {"V->A": 0.95, "A->V": 0.95}
UNSEEN_CHANCES = 3  #: of V->A: how many times chance
FIGURES = {"recognize": "catalogue_confusion", "reconstruct": "catalogue_shapes"}  #: pictures by task
SIDE = 1400  #: of a picture at most, pixels
RECONSTRUCTED = {"V": 0.75, "A": 0.85, "VA": 0.88}  #: least IoU
WORDS = {
    "recognize_seen": "V 95, A 99, T 45, four touches 75 % recognized, senses together as the paper's",
    "retrieve_seen": "sight and sound retrieved 0.95 by cosine, with touch as the paper's",
    "retrieve_unseen": "V->A of unseen objects three times chance, all directions above CCA",
    "reconstruct_seen": "0.75, 0.85, 0.88 IoU from V, A, VA",
    "reconstruct_unseen": "unseen objects from a view better than the average shape",
}


def missed(folder: Benchmarks) -> Iterator[str]:
    """Yield what is below its target, and by how much; of tasks that ran."""

    def scores(task: str, split: str) -> dict[str, Any]:
        path = folder.result(task, split)
        return read_json(path) if path.is_file() else {}

    if found := scores("recognize", "seen"):
        measured = {name: found[name]["accuracy"] for name in RECOGNIZED}
        measured["four touches"] = found["touches"]["4"]["accuracy"]
        for name, least in (RECOGNIZED | {"four touches": FOUR_TOUCHES}).items():
            if measured[name] < least:
                yield f"{name} recognized {100 * measured[name]:.1f} %, target {100 * least:g} %"
    if found := scores("retrieve", "seen").get("directions"):
        for direction, (paper, _) in published.RETRIEVAL.items():
            least = RETRIEVED.get(direction, paper)
            score = found[direction]
            if score["map"] < least:
                yield f"{direction} retrieved {score['map']:.3f}, target {least:g}"
    if found := scores("retrieve", "unseen").get("directions"):
        for direction in published.RETRIEVAL:
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
    parser.add_argument("out", type=Path)
    parser.add_argument("--preset", default="laptop", help="of the benchmarks")
    parser.add_argument("--options", default="", help="other options that they were called with")
    parser.add_argument("--json", type=Path)
    parser.add_argument(
        "--pictures",
        type=Path,
        metavar="DOCS",
        help="folder for the figures of recognition and reconstruction",
    )
    arguments = parsed(parser)
    folder, keys, console = Benchmarks(arguments.out), {}, Console()
    options = f" {arguments.options}" if arguments.options else ""
    found = list(shared_tables(folder, arguments.preset, keys, options))
    found += object_tables(folder, arguments.preset, options)
    for record in found:
        table = Table(title=record["title"])
        for name in record["columns"]:
            table.add_column(name)
        for row in record["rows"]:
            table.add_row(*row)
        console.print(table)
    for task, name in FIGURES.items():
        figure = folder.sheet(task, "seen")
        if arguments.pictures and figure.is_file():
            with Image.open(figure) as page, atomic(arguments.pictures / f"{name}.webp") as temporary:
                page.thumbnail((SIDE, SIDE))
                page.convert("RGB").save(temporary, "webp", quality=80, method=6)
    below = list(missed(folder))
    words = "; ".join(text for name, text in WORDS.items() if (arguments.out / f"{name}.json").is_file())
    write_record(arguments.json, {"objects": len(keys), "tables": found}, words, below)
    exit_with_verdict(below, console)


if __name__ == "__main__":
    main()
