"""Scores, sizes and times of all objects of a built workspace: `python perf/catalogue.py DIR`.

Reads what `objectfolder build` left in the workspace DIR: held-out scores, modes, processor time of each
stage. With `--pictures DOCS`, draws three sheets of all Object Files into that folder: a view, the touch with
the most relief, and a strike's spectrogram. With `--published catalogs/real.yaml`, the objects are those of
this catalogue, whether the workspace has them or not, with what it took to close their scans. With `--keep`,
objects without scores here keep their rows and pictures of earlier runs: a catalogue may be built in parts.
Exits with 1 if a target is missed.
"""

import argparse
import re
import sys
import textwrap
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from harness import exit_with_verdict, parsed, write_record
from PIL import Image, ImageDraw, ImageFont
from results import preset_of
from rich.console import Console
from rich.progress import track
from rich.table import Table

from objectfolder import ObjectFile
from objectfolder.base.arrays import read_npz
from objectfolder.base.figures import tile
from objectfolder.base.io import atomic, read_json
from objectfolder.engine.records import recall_costs, recall_errors
from objectfolder.hub.fetch.catalogue import Catalogue, read_catalogue
from objectfolder.sound.spectrogram import spectrogram
from objectfolder.workspace import params
from objectfolder.workspace.layout import Build

#: Targets of the medians over all objects: at least, or at most.
LEAST = {"vision": 42.0, "touch": 45.0}
MOST_GAIN_ERROR = 0.01
MOST_BYTES = 60e6  #: of all Object Files
#: An object beyond these is named on the page.
POOR = {"vision": 40.0, "touch": 43.0, "gain_error": 0.02}
#: Of the sheets: pictures in a row; their size, a line of a name and the gap between them, pixels.
COLUMNS, SIDE, LINE, GAP = 10, 112, 14, 4
LETTERS = 20  #: of a name in a line
DIRECTION = np.array([1.3, -2.2, 1.35])  #: to the camera
DISTANCE = 3.2  #: of the camera, in radii of the object
WORST = 5  #: touches of a poor object whose share of the error is measured
TOUCHES = 60  #: of which the one with the most contrast is shown
SECONDS, RATE, RANGE = 0.25, 40000, 80  #: of a spectrogram; Hz; decibels


def measured(
    key: str, root: Path, entry: Mapping[str, Any] | None, about: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the row of one object.

    ``entry``: that of params.yaml, if there is one; ``about``: what else is known, such as its generator.
    """
    build = Build(key, root)
    if entry is None or not build.metrics.is_file():
        return {"object": key, **about, "failed": lack(build, entry)}
    scores, modal = read_json(build.metrics), read_json(build.modal)
    costs = recall_costs(root, key)
    vision, audio, touch = scores["vision"], scores["audio"], scores["touch"]
    return {
        "object": key,
        **about,
        "material": entry["material"],
        "scale": entry["scale"],
        "vision": vision["psnr"],
        "vision_lit": vision.get("psnr_lit_foreground"),
        "white": vision["baseline_white"],
        "touch": touch["psnr"],
        "touch_median": touch["psnr_median"],
        "worst_touches": worst_share(build) if touch["psnr"] < POOR["touch"] else None,
        "mean_touch": touch["baseline_mean_image"],
        "gain_error": audio.get("gain_error"),
        "nearest_gain_error": audio.get("baseline_nearest"),
        "audio": audio.get("psnr"),
        "silence": audio.get("baseline_silence"),
        "modes": modal["modes"],
        "lowest_hz": min(modal["lowest_hz"], default=None),
        "frequency_uncertainty": modal["frequency_uncertainty"],
        **({"uncertain": True} if modal.get("uncertain") else {}),
        "bytes": scores["file_bytes"],
        "cpu_seconds": sum(cost.cpu_seconds for cost in costs.values()),
        "slowest": max(costs, key=lambda stage: costs[stage].cpu_seconds, default=None),
    }


def lack(build: Build, entry: Mapping[str, Any] | None) -> str:
    """Return why an object has no scores."""
    if entry is None:
        return "not in the workspace"
    prefix = rf"(the command exited with code \d+; )?(\w+ {build.key}: )?({build.key}: )?"
    errors = recall_errors(build.root, build.key)
    said = [f"{stage}: {re.sub(f'^{prefix}', '', error)}" for stage, error in errors.items()]
    return "; ".join(said) or ("not scored" if build.object_file.is_file() else "not built")


def published_facts(build: Build, catalogue: Catalogue, entry: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the source of an object, what closed its scan, and what differs from a plain `fetch`."""
    listed, source = catalogue.objects[build.key], catalogue.source(build.key)
    facts: dict[str, Any] = {"source": listed.source, "paper": listed.id is not None}
    if build.normalize.is_file():
        report = read_json(build.normalize)
        facts["rung"] = report["rung"]
        steps = [f"{step['name']}: {step['detail']}" for step in report["rungs"] if step["name"] != "clean"]
        facts["closed"] = "; ".join(steps)
        facts["deviation"] = report["deviation_max_percent"] / 100
    if entry is not None:
        usual = {"material": listed.material, "scale": listed.scale, "up": source.up}
        usual |= {"wall": None, "bridge": "all"}
        own = params.ObjectEntry.model_validate(entry)
        changed = [name for name, value in usual.items() if getattr(own, name) != value]
        facts["set"] = ", ".join(f"{name} {getattr(own, name)}" for name in changed)
    return facts


def mass_rows(real: Mapping[str, float], root: Path) -> list[dict[str, Any]]:
    """Return a row for each object of known mass whose modes are solved, in the given order.

    ``real``: kg by key, such as those of `objectfolder.hub.fetch.catalogue.Entry`. A row has ``object``,
    ``solid`` and ``real``, kg, of the solid filled with the material and of the real object, and ``ratio`` of
    these two: how many times too heavy the solid is, such as 10 for a hollow object that was scanned as full.
    """
    solids = {key: Build(key, root).modal for key in real}
    found = {key: read_json(path)["mass_kg"] for key, path in solids.items() if path.is_file()}
    return [
        {"object": key, "solid": kg, "real": real[key], "ratio": kg / real[key]} for key, kg in found.items()
    ]


def worst_share(build: Build) -> float:
    """Return the share of the squared error of held-out touches that the worst of them hold."""
    truth = read_npz(build.touch("test"), "images", "points", "depths", "angles")
    answers = ObjectFile.load(build.object_file).touch(truth["points"], truth["depths"], truth["angles"])
    errors = np.square(answers.astype(np.float64) - truth["images"]).sum((1, 2, 3))
    return float(np.sort(errors)[-WORST:].sum() / errors.sum())


def missed(rows: list[dict[str, Any]]) -> list[str]:
    """Return which targets are missed, and by how much."""
    lacking = defaultdict(list)
    for row in rows:
        if "failed" in row:
            lacking[row["failed"]].append(row["object"])
    found = [f"{', '.join(keys)}: {reason}" for reason, keys in lacking.items()]
    rows = [row for row in rows if "failed" not in row]
    known = {name: [row[name] for row in rows if row[name] is not None] for name in (*LEAST, "gain_error")}
    middles = {name: median(found) for name, found in known.items() if found}
    found += [
        f"median {name} {middles[name]:.1f} dB, target {least:g} dB"
        for name, least in LEAST.items()
        if middles[name] < least
    ]
    if middles.get("gain_error", 0) > MOST_GAIN_ERROR:
        found.append(f"median gain error {middles['gain_error']:.2%}, target {MOST_GAIN_ERROR:.0%}")
    if (size := sum(row["bytes"] for row in rows)) > MOST_BYTES:
        found.append(f"{size / 1e6:.0f} MB of Object Files, target {MOST_BYTES / 1e6:.0f} MB")
    return found


def joined(earlier: dict[str, Any], record: dict[str, Any]) -> dict[str, Any]:
    """Return a record with the rows of an earlier one in place of rows without scores.

    Ends the script if the two were not built and tested alike.
    """
    for name in ("preset", "renderer", "test_views", "test_impacts", "test_touches"):
        old, new = earlier.get(name), record.get(name)
        if old != new:
            sys.exit(f"--keep: {name} of the record is {old}, here {new}: name another file by --json")
    before = {row["object"]: row for row in earlier["rows"] if "failed" not in row}
    rows = [before.get(row["object"], row) if "failed" in row else row for row in record["rows"]]
    masses = {row["object"]: row for part in (earlier, record) for row in part.get("masses", ())}
    kept = before.keys() - {row["object"] for row in record["rows"] if "failed" not in row}
    runs = [*earlier.get("earlier", ()), earlier["run"]] if kept else []
    return record | {
        "pictures": record.get("pictures") or earlier.get("pictures"),
        "rows": rows,
        **({"masses": list(masses.values())} if masses else {}),
        **({"earlier": runs} if runs else {}),
    }


def sheets(files: Mapping[str, Path | None], folder: Path, start: str, keep: bool = False) -> None:
    """Draw Object Files by object into START_views, START_touches and START_sounds.

    The place of an object without a file is white, or with ``keep`` as in an earlier sheet.
    """
    captions = ["\n".join(textwrap.wrap(key.replace("_", " "), LETTERS)).replace(" ", "_") for key in files]
    height = SIDE + max(caption.count("\n") + 1 for caption in captions) * LINE + 2
    for name, draw in (("views", seen), ("touches", felt), ("sounds", heard)):
        path = folder / f"{start}_{name}.webp"
        pictures, drawn = cut(path if keep else None, len(files), height)
        for i, (file, caption) in enumerate(zip(track(files.values(), f"drawing {name}"), captions)):
            if file is not None:
                pictures[i] = captioned(draw(ObjectFile.load(file)), caption, height)
                drawn = max(drawn, i + 1)
        page = Image.fromarray(tile(pictures[:drawn], COLUMNS, GAP))
        with atomic(path) as temporary:
            page.save(temporary, "webp", quality=80, method=6)


def cut(sheet: Path | None, count: int, height: int) -> tuple[np.ndarray, int]:
    """Return the pictures of an earlier sheet, (count, height, SIDE, 3) uint8, and how many places it has.

    The rest is white.
    """
    pictures = np.full((count, height, SIDE, 3), 255, np.uint8)
    page = tile(pictures, COLUMNS, GAP)
    if sheet is None or not sheet.is_file():
        return pictures, 0
    found = np.asarray(Image.open(sheet).convert("RGB"))
    rows, rest = divmod(len(found) - GAP, height + GAP)
    if rest or found.shape[1:] != page.shape[1:] or len(found) > len(page):
        return pictures, 0  # of other names
    page[: len(found)] = found
    cells = page[GAP:, GAP:].reshape(-1, height + GAP, COLUMNS, SIDE + GAP, 3)[:, :height, :, :SIDE]
    return cells.swapaxes(1, 2).reshape(-1, height, SIDE, 3)[:count].copy(), min(rows * COLUMNS, count)


def seen(file: ObjectFile) -> np.ndarray:
    """Return a view under a studio's light, (H, W, 3) uint8."""
    radius = np.linalg.norm(file.sample_surface(1000, seed=0), axis=1).max() / file.scale
    camera = DIRECTION / np.linalg.norm(DIRECTION) * DISTANCE * radius
    return (file.view(camera[None], resolution=SIDE, lights="studio")[0] * 255).round().astype(np.uint8)


def felt(file: ObjectFile) -> np.ndarray:
    """Return the tactile image of some at random that differs most from the usual one, (H, W, 3) uint8."""
    images = file.touch(file.sample_surface(TOUCHES, seed=0), depth=0.001)
    apart = images.astype(np.float32) - np.median(images, axis=0)
    return images[np.square(apart).mean((1, 2, 3)).argmax()]


def heard(file: ObjectFile) -> np.ndarray:
    """Return the spectrogram of one strike to 20 kHz, low frequencies below; (H, W, 3) uint8."""
    from matplotlib import colormaps

    point = file.sample_surface(1, seed=1)
    force = -0.01 * point / np.linalg.norm(point)
    sound = file.impact(point, force, RATE, SECONDS, contact_time=0.0)
    level = 20 * np.log10(spectrogram(torch.from_numpy(sound))[0].abs().numpy() + 1e-20)
    share = np.clip((level - max(level.max(), -300) + RANGE) / RANGE, 0, 1)  # silence is dark
    shown = Image.fromarray((colormaps["magma"](share[::-1])[..., :3] * 255).round().astype(np.uint8))
    return np.asarray(shown.resize((SIDE, SIDE)))


def captioned(picture: np.ndarray, caption: str, height: int) -> np.ndarray:
    """Fit a picture into a square above a caption; (height, SIDE, 3) uint8."""
    image = Image.new("RGB", (SIDE, height), "white")
    shown = Image.fromarray(picture)
    tall, wide = picture.shape[:2]
    if tall > SIDE:
        shown = shown.resize((round(SIDE * min(wide / tall, 1)), SIDE))
    image.paste(shown, ((SIDE - shown.width) // 2, 0))
    font = ImageFont.load_default(10)
    drawing = ImageDraw.Draw(image)
    drawing.text((SIDE / 2, SIDE + 2), caption, fill="#404040", font=font, anchor="ma", align="center")
    return np.asarray(image)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pictures", type=Path, metavar="DOCS", help="folder for the three sheets")
    parser.add_argument("--published", type=Path, metavar="FILE", help="catalogue of published objects")
    parser.add_argument(
        "--wall",
        type=float,
        nargs=2,
        metavar=("MINUTES", "OBJECTS"),
        help="wall time of one run of the build, as it printed it, and how many objects it built",
    )
    parser.add_argument("--keep", action="store_true", help="keep scores of --json that the workspace lacks")
    arguments = parsed(parser)
    if arguments.keep and not arguments.json:
        parser.error("--keep needs --json FILE, the record to keep scores of")
    root = arguments.workspace
    values = params.read(root / params.PARAMS_FILE)
    entries: dict[str, Any] = values["objects"]
    if arguments.published:
        catalogue = read_catalogue(arguments.published)
        entries = {key: entries.get(key) for key in catalogue.objects}
        about = {key: published_facts(Build(key, root), catalogue, entry) for key, entry in entries.items()}
        weighed = {key: listed.mass for key, listed in catalogue.objects.items()}
    else:
        generators = {key: entry["generator"] for key, entry in values["procedural"].items()}
        about = {key: {"generator": generators.get(key, "mesh")} for key in entries}
        weighed = {key: entry.get("mass") for key, entry in entries.items()}
    rows = [measured(key, root, entry, about[key]) for key, entry in entries.items()]
    if all("failed" in row for row in rows):
        sys.exit(f"{root}: no object has scores; run `objectfolder build` there")
    table = Table(title=f"{len(rows)} objects")
    for name in ("object", "vision", "touch", "gain error", "modes", "kB", "CPU s", "slowest"):
        table.add_column(name, justify="left" if name == "object" else "right", no_wrap=True)
    for row in rows:
        if "failed" in row:
            table.add_row(row["object"], row["failed"])
            continue
        gain = "-" if row["gain_error"] is None else f"{row['gain_error']:.2%}"
        shown = (f"{row['vision']:.1f}", f"{row['touch']:.1f}", gain, str(row["modes"]))
        cost = (f"{row['bytes'] / 1000:.0f}", f"{row['cpu_seconds']:.0f}", row["slowest"] or "-")
        table.add_row(row["object"], *shown, *cost)
    console = Console()
    console.print(table)
    masses = mass_rows({key: mass for key, mass in weighed.items() if mass}, root)
    for row in masses:
        console.print(f"{row['object']}: {row['solid']:.3g} kg as a solid, {row['real']:.3g} kg weighed")
    settings = values["render_views"]
    record: dict[str, Any] = {
        "renderer": settings["renderer"],
        "test_views": settings["test"],
        "wall": arguments.wall,
        "poor": POOR,
    }
    if arguments.published:
        named = ("title", "licence", "attribution")
        record |= {
            "preset": preset_of(values),
            "test_impacts": values["evaluate"]["impacts"],
            "test_touches": values["render_touch"]["test"],
            "pictures": arguments.pictures is not None,
            "sources": {
                name: {part: getattr(source, part) for part in named}
                for name, source in catalogue.sources.items()
            },
        }
    if arguments.pictures:
        files = {
            row["object"]: None if "failed" in row else Build(row["object"], root).object_file for row in rows
        }
        start = arguments.published.stem if arguments.published else "catalogue"
        sheets(files, arguments.pictures, start, arguments.keep)
    record |= {"rows": rows, **({"masses": masses} if masses else {})}
    if arguments.keep and arguments.json.is_file():
        record = joined(read_json(arguments.json), record)
    targets = (
        f"medians: vision at least {LEAST['vision']:g} dB, touch at least {LEAST['touch']:g} dB, gain error "
        f"at most {MOST_GAIN_ERROR:.0%}; {MOST_BYTES / 1e6:.0f} MB in all"
    )
    found = missed(record["rows"])
    write_record(arguments.json, record, targets, found)
    exit_with_verdict(found, console)


if __name__ == "__main__":
    main()
