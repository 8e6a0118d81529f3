"""The page of an Object File against the library: `python perf/viewer.py FILE ... [--contacts N] [--json J]`.

A headless Chromium opens the page of each file from disk and answers strikes, touches and views. Sounds are
compared with `ObjectFile.impact`, tactile images with `ObjectFile.touch`, and views with `ObjectFile.view`
on the object's pixels. `--times` compares nothing and takes seconds: the times of the page's own clock, on an
idle machine. Needs node, Chromium and `npm ci` in viewer/. Exits with 1 if a target is missed.
"""

import argparse
import json
import subprocess
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from harness import exit_with_verdict, parsed, write_record
from rich.console import Console
from rich.table import Table

from objectfolder import ObjectFile
from objectfolder.base.materials import material
from objectfolder.viewer.page import page_sensor, static_text, viewer_page
from objectfolder.vision.cameras import sphere_points

VIEWER = Path(__file__).parents[1] / "viewer"
RATE, DURATION = 44100, 2.0
STRIKES, VIEWS, SIZE = 12, 8, 256
#: Sensors whose background is a picture, which the page holds in fewer levels, and touches of each.
PICTURED, PICTURED_TOUCHES = ("gelsight_real", "digit_real"), 8
#: Largest or least value; by object where the issue gives one, else by default.
MOST = {"sound": 1e-5, "sound_cut": 1e-4, "strike_ms": 20, "touch_ms": 60, "usable_s": 1.0, "coloured_s": 2.5}
LEAST = {"touch_db": 55.0, "pictured_db": 44.0}
LEAST_VIEW = {"mug": 36.0, "bell": 44.0, "die": 42.0}
SCRIPT_KB, PAGE_KB = 90, 140
TITLES = {
    "sound": "sound, relative",
    "sound_cut": "cut at 1e-5",
    "touch_db": "worst touch, dB",
    "pictured_db": "worst on a picture, dB",
    "view_db": "view, dB",
    "strike_ms": "strike, ms",
    "touch_ms": "touch, ms",
    "usable_s": "usable, s",
    "coloured_s": "coloured, s",
}


def questions(file: ObjectFile, contacts: int) -> dict[str, Any]:
    """Return random strikes, touches and views, as the page and the library take them."""
    rng = np.random.default_rng(0)
    points = file.sample_surface(max(contacts, STRIKES), seed=1)
    impulses = rng.standard_normal((STRIKES, 3))
    own = file.header.get("material_properties", {})
    steel = material("steel", "loss_factor" if "loss_factor" in own else "rayleigh")
    tuned = {"name": "steel", **steel.properties()}
    strikes = []
    places = sphere_points(STRIKES, 2.5, rng)
    for i in range(STRIKES):
        for silence, metal, heard in (
            (0, None, False),
            (1e-5, None, False),
            (0, tuned, False),
            (0, None, True),
        ):
            settings = {
                "impulse": impulses[i].tolist(),
                "contact": 3e-4 if i % 2 else 0,
                "material": metal,
                "size": 2 if metal else 1,
                "rate": RATE,
                "duration": DURATION,
                "response": "acceleration" if i % 2 else "displacement",
                "silence": silence,
                "listener": places[i].tolist() if heard else None,
            }
            strikes.append({"point": (points[i] / file.scale).tolist(), "settings": settings})
    most = file.sensor_profile.max_indentation
    touches = [
        {
            "point": (point / file.scale).tolist(),
            "settings": {"profile": None, "gel": gel, "depth": depth, "angle": angle},
        }
        for point, depth, angle in zip(
            points, rng.uniform(0.25 * most, most, contacts), rng.uniform(-np.pi, np.pi, contacts)
        )
        for gel in ("stored", "rigid")
    ]
    pictured = [
        {"point": touch["point"], "settings": touch["settings"] | {"profile": page_sensor(name)}}
        for touch in touches[: 2 * PICTURED_TOUCHES : 2]
        for name in PICTURED
    ]
    rng = np.random.default_rng(0)  # the same views for any number of contacts
    cameras, lights = sphere_points(VIEWS, 2.5, rng), sphere_points(VIEWS, 1.0, rng)
    views = [
        {"camera": c.tolist(), "light": light.tolist(), "size": SIZE} for c, light in zip(cameras, lights)
    ]
    return {"strikes": strikes, "touches": touches, "pictured": pictured, "views": views}


def ask(page: Path, asked: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the page's answers and times."""
    (folder / "questions.json").write_text(json.dumps(asked))
    command = ["node", str(VIEWER / "tests" / "measure.mjs"), str(page), str(folder / "questions.json")]
    subprocess.run([*command, str(folder)], check=True)
    found = json.loads((folder / "times.json").read_text())
    return found | {name: np.fromfile(folder / f"{name}.f32", np.float32) for name in asked}


def relative(answer: np.ndarray, truth: np.ndarray) -> float:
    """Return the norm of the error over that of the truth."""
    return float(np.linalg.norm(answer - truth) / max(np.linalg.norm(truth), 1e-30))


def psnr(difference: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio, dB, of differences of values from 0 to 1."""
    return float(-10 * np.log10(max(np.mean(np.square(difference)), 1e-12)))


def measure(path: Path, contacts: int, compared: bool) -> dict[str, Any]:
    """Compare the page of one file with the library, or time it."""
    file = ObjectFile.load(path)
    asked = questions(file, contacts)
    if not compared:
        asked["views"] = asked["pictured"] = []
    with TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        page.write_text(viewer_page({file.key: path.read_bytes()}))
        found = ask(page, asked, Path(folder))
    took, times = found["took"], found["times"]
    row: dict[str, Any] = {"object": file.key, "complaints": len(found["complaints"])}
    if compared:
        row |= sounds(file, asked["strikes"], found["strikes"])
        row |= touches(file, asked["touches"], found["touches"])
        row["pictured_db"] = pictured(file, asked["pictured"], found["pictured"])
        return row | {"view_db": views(file, asked["views"], found["views"])}
    return row | {
        "strike_ms": median(took["strikes"][3:]),
        "touch_ms": median(took["touches"][2::2]),
        "usable_s": times["shape"] / 1000,
        "coloured_s": times["coloured"] / 1000,
    }


def sounds(file: ObjectFile, asked: list[dict[str, Any]], answers: np.ndarray) -> dict[str, float]:
    """Return the largest relative errors of sounds, and of those whose modes are cut."""
    errors: dict[bool, float] = {False: 0.0, True: 0.0}
    for question, answer in zip(asked, answers.reshape(len(asked), -1)):
        settings = question["settings"]
        tuned = settings["material"] is not None
        scale, listener = file.scale * settings["size"], settings["listener"]
        truth = file.impact(
            [np.array(question["point"]) * scale],
            [settings["impulse"]],
            RATE,
            DURATION,
            "displacement" if listener else settings["response"],
            contact_time=settings["contact"],
            material="steel" if tuned else None,
            scale=scale if tuned else None,
            listener=[np.array(listener) * scale] if listener else None,
        )
        cut = settings["silence"] > 0
        errors[cut] = max(errors[cut], relative(answer, truth[0]))
    return {"sound": errors[False], "sound_cut": errors[True]}


def touches(file: ObjectFile, asked: list[dict[str, Any]], answers: np.ndarray) -> dict[str, float]:
    """Return the PSNR of the worst tactile image, and how many miss the target."""
    profile = file.sensor_profile
    rigid = replace(profile, gel="rigid")
    shape = profile.height, profile.width, 4
    found = []
    for question, answer in zip(asked, answers.reshape(len(asked), *shape)):
        settings = question["settings"]
        sensor = rigid if settings["gel"] == "rigid" else None
        point = np.array([question["point"]]) * file.scale
        truth = file.touch(point, settings["depth"], settings["angle"], sensor=sensor)
        found.append(psnr((answer[..., :3] - truth[0]) / 255))
    return {"touch_db": min(found), "touches_below": sum(db < LEAST["touch_db"] for db in found)}


def pictured(file: ObjectFile, asked: list[dict[str, Any]], answers: np.ndarray) -> float:
    """Return the PSNR of the worst tactile image of sensors whose background is a picture."""
    found = []
    start = 0
    for question in asked:
        settings = question["settings"]
        sensor = settings["profile"]
        point = np.array([question["point"]]) * file.scale
        truth = file.touch(point, settings["depth"], settings["angle"], sensor=sensor["name"])[0]
        end = start + sensor["height"] * sensor["width"] * 4
        answer = answers[start:end].reshape(*truth.shape[:2], 4)
        found.append(psnr((answer[..., :3] - truth) / 255))
        start = end
    return min(found)


def views(file: ObjectFile, asked: list[dict[str, Any]], answers: np.ndarray) -> float:
    """Return the PSNR over the object's pixels of all views."""
    errors = []
    for question, answer in zip(asked, answers.reshape(len(asked), SIZE, SIZE, 4)):
        truth = file.render([question["camera"]], [question["light"]], SIZE)
        shown = srgb(answer[..., :3] + 1 - answer[..., 3:])
        errors.append((shown - truth.rgb[0])[truth.rgba[0, ..., 3] > 0])
    return psnr(np.concatenate(errors))


def srgb(linear: np.ndarray) -> np.ndarray:
    """Encode linear values, clipped to 0 to 1."""
    clipped = linear.clip(0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def missed(row: dict[str, Any]) -> list[str]:
    """Return what misses its target, and by how much."""
    least = LEAST | {"view_db": LEAST_VIEW.get(row["object"], LEAST_VIEW["mug"])}
    found = [
        f"{TITLES[name]} {row[name]:.3g} > {most:g}"
        for name, most in MOST.items()
        if row.get(name, most) > most
    ]
    found += [
        f"{TITLES[name]} {row[name]:.1f} < {low:g}" for name, low in least.items() if row.get(name, low) < low
    ]
    if row["complaints"]:
        found.append(f"{row['complaints']} errors or network requests")
    return [f"{row['object']}: {text}" for text in found]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--contacts", type=int, default=200)
    parser.add_argument("--times", action="store_true", help="measure times and compare nothing")
    parser.add_argument("--json", type=Path)
    options = parsed(parser)
    rows = [measure(path, options.contacts, not options.times) for path in options.files]
    script, page = (len(text.encode()) / 1000 for text in (static_text("viewer.js"), viewer_page({})))
    table = Table("object", *TITLES.values())
    for row in rows:
        table.add_row(row["object"], *(f"{row[name]:.3g}" if name in row else "-" for name in TITLES))
    console = Console()
    console.print(table)
    console.print(f"viewer.js {script:.1f} kB; page without objects {page:.1f} kB")
    failed = [text for row in rows for text in missed(row)]
    failed += [f"viewer.js {script:.1f} > {SCRIPT_KB} kB"] * (script > SCRIPT_KB)
    failed += [f"page {page:.1f} > {PAGE_KB} kB"] * (page > PAGE_KB)
    sizes = {"script_kb": script, "page_kb": page, "contacts": options.contacts}
    limits = {name: limit for name, limit in (MOST | LEAST).items() if name in rows[0]}
    targets = "; ".join(f"{TITLES[name]}: {limit:g}" for name, limit in limits.items())
    if not options.times:
        views_db = ", ".join(f"{key} {low:g}" for key, low in LEAST_VIEW.items())
        targets += f"; {TITLES['view_db']}: {views_db}, others {LEAST_VIEW['mug']:g}"
    write_record(options.json, sizes | {"rows": rows}, targets, failed)
    exit_with_verdict(failed, console)


if __name__ == "__main__":
    main()
