"""Lights fitted to photographs of a pressed ball: `python perf/light.py --taxim DIR --digit DIR`.

`--taxim` is `calibs` of github.com/rhgao/ObjectFolder (CC BY 4.0): `dataPack.npz`, 49 photographs of a
GelSight with circles marked by hand, and `polycalib.npz`, Taxim's table of colours. `--digit` is a checkout
of github.com/Rancho-zhao/FOTS (its README says MIT): 42 photographs of a DIGIT in `mlp_calib/digit`, and
`assets/gel/digit_bg.png`.

Seven photographs, drawn by seed, are fitted; the others are held out. Scores are pooled over the pixels
inside the circles, without those that overflowed; "all pixels" counts these, too. Where the ball lies in a
held-out photograph is taken from its circle ("circles", shifted by the mean that the seven show), or found
there by the physical lights from all of those pixels ("poses found") or from every other square of 5 x 5,
and scored on the other squares ("halves": no pixel is scored by a pose that it helped to find). "Beside" is
the ring from one to two radii of the circle. A polynomial fitted to the held-out photographs themselves shows
what any model could reach there. Writes the profiles of seed 0 to `--out`. Exits with 1 if a
target is missed.
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from harness import exit_with_verdict, parsed, write_record
from PIL import Image
from rich.console import Console
from rich.table import Table

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.metrics import psnr
from objectfolder.touch.ball import BallModel
from objectfolder.touch.calibration import SensorFit, fit_sensor_lights, save_fit
from objectfolder.touch.imprint import find_imprint, find_overflow
from objectfolder.touch.lightfit import Photograph, circle_mask, fit_pose, squared_error
from objectfolder.touch.optics import Optics
from objectfolder.touch.photographs import Pack, read_pack, read_photograph
from objectfolder.touch.profiles import SensorProfile, load_profile

FITTED = 7  # photographs
SEEDS = 0, 1, 2
LIGHTS = 6
SQUARE = 5  # pixels
WANTED = "GelSight, seed 0: 25 dB of lights, 28 dB with the residual, by circles and by halves"
TARGETS = {  # dB, GelSight, seed 0
    "physical, circles": 25.0,
    "physical, halves": 25.0,
    "with residual, circles": 28.0,
    "with residual, halves": 28.0,
}


@dataclass(frozen=True)
class Sensor:
    """Photographs of a real sensor."""

    name: str
    profile: SensorProfile  # with what is known of its geometry
    radius: float  # m, of the ball
    pack: Pack
    source: str


def framed(name: str, pitch: float, height: int, width: int, **changes: Any) -> SensorProfile:
    """Return a profile of the package with other pixels, their pitch in metres."""
    profile = replace(load_profile(name), **changes)
    angle = 2 * np.degrees(np.arctan(height / 2 * pitch / profile.camera_to_gel))
    return replace(profile, height=height, width=width, vertical_fov_deg=float(angle), slope_smoothing=pitch)


def gelsight(folder: Path) -> Sensor:
    profile = framed("gelsight_r15", 0.1245e-3, 120, 160, camera_to_gel=0.04)
    source = (
        "Light and background: fitted by perf/light.py to 7 of the 49 photographs in calibs/dataPack.npz of "
        "github.com/rhgao/ObjectFolder (Gao et al. 2022; CC BY 4.0), a GelSight under a ball of 2 mm radius, "
        "160 x 120 pixels of 0.1245 mm, camera 40 mm behind the gel, as stated there. Assumed: flat gel 5 mm "
        "thick, moduli."
    )
    return Sensor("gelsight_real", profile, 2e-3, read_pack(folder / "dataPack.npz", profile), source)


def digit(folder: Path) -> Sensor:
    profile = framed("digit", 2e-3 / 19.58, 160, 120)
    source = (
        "Light and background: fitted by perf/light.py to 7 of the 42 photographs in mlp_calib/digit and "
        "assets/gel of github.com/Rancho-zhao/FOTS (Zhao et al. 2024; MIT by its README), a DIGIT under a "
        "ball of 2.35 mm radius, 19.58 pixels of 320 x 240 per mm, as stated there. Geometry of the gel: "
        "TACTO's DIGIT. Assumed: its thickness, moduli."
    )
    rest = read_photograph(folder / "assets/gel/digit_bg.png", profile)
    pictures, circles = [], []
    for path in sorted((folder / "mlp_calib/digit").glob("*.png")):
        picture = read_photograph(path, profile)
        try:
            circles.append(find_imprint(picture.astype(np.float32) - rest, path.name))
        except ObjectFolderError as error:
            print(f"left out: {error}")
            continue
        pictures.append(picture)
    return Sensor("digit_real", profile, 2.35e-3, Pack(np.stack(pictures), rest, circles), source)


def decibels(error: np.ndarray) -> float:
    return float(psnr(float(np.mean(error**2)), 255))


def features(photograph: Photograph, circle: tuple[float, float, float], degree: int) -> np.ndarray:
    """Terms of a polynomial of the place in the disc, each linear in the place in the picture."""
    rows, columns = np.nonzero(photograph.disc)
    v, u = (rows - circle[0]) / circle[2], (columns - circle[1]) / circle[2]
    y, x = (axis / len(photograph.disc) - 0.5 for axis in (rows, columns))
    powers = [u ** (n - k) * v**k for n in range(degree + 1) for k in range(n + 1)]
    return np.stack([power * place for power in powers for place in (np.ones_like(x), x, y)], axis=1)


def regressions(sensor: Sensor, shown: list[Photograph], chosen: np.ndarray, held: np.ndarray) -> dict:
    """Polynomials of the place in the disc, fitted to the chosen photographs: no physics."""
    rest, circles = sensor.pack.untouched.astype(float), sensor.pack.circles
    found = {}
    for name, degree in (("linear in the disc", 1), ("cubic in the disc", 3)):
        parts = [features(shown[i], circles[i], degree) for i in range(len(shown))]
        targets = [(photograph.picture - rest)[photograph.disc] for photograph in shown]
        given = [np.concatenate([of[i] for i in chosen]) for of in (parts, targets)]
        weights = np.linalg.lstsq(*given, rcond=None)[0]
        errors = []
        for i in held:
            still = rest[shown[i].disc]
            errors.append((still + parts[i] @ weights).clip(0, 255) - still - targets[i])
        found[name] = decibels(np.concatenate(errors))
    return found


def ceiling(
    sensor: Sensor, photographs: list[Photograph], circles: list[tuple[float, float, float]]
) -> float:
    """Polynomial of degree 7 of the place in the disc, fitted to the photographs that it is scored on: dB.

    What is lost because circles are off, whatever the model.
    """
    rest = sensor.pack.untouched.astype(float)
    still = np.concatenate([rest[photograph.disc] for photograph in photographs])
    seen = np.concatenate([photograph.picture[photograph.disc] for photograph in photographs])
    terms = np.concatenate([features(each, circle, 7) for each, circle in zip(photographs, circles)])
    shown = still + terms @ np.linalg.lstsq(terms, seen - still, rcond=None)[0]
    return decibels(shown.clip(0, 255) - seen)


def taxim_error(folder: Path, sensor: Sensor, shown: list[Photograph]) -> float:
    """Taxim's own table on all photographs, from which it was made: dB."""
    with np.load(folder / "polycalib.npz", allow_pickle=False) as archive:
        bins, tables = int(archive["bins"]), [archive[f"grad_{color}"] for color in "rgb"]
    errors = []
    for photograph, (row, column, _) in zip(shown, sensor.pack.circles):
        rows, columns = np.nonzero(photograph.disc)
        v, u = rows - int(row), columns - int(column)
        slope = np.arcsin(np.minimum(np.hypot(u, v) * sensor.profile.pixel_pitch / sensor.radius, 1))
        step = np.pi / 2 / (bins - 1)
        at = (slope / step).astype(int), ((np.arctan2(-v, -u) + np.pi) / (4 * step)).astype(int)
        x, y = columns.astype(float), rows.astype(float)
        terms = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=1)
        change = np.stack([(terms * table[at]).sum(axis=1) for table in tables], axis=1)
        rest = sensor.pack.untouched[photograph.disc].astype(float)
        errors.append((rest + change).clip(0, 255) - photograph.picture[photograph.disc])
    return decibels(np.concatenate(errors))


def compared(sensor: Sensor, fit: SensorFit, photographs: list[Photograph]) -> np.ndarray:
    """Photographs above images of the same balls, cropped and enlarged; (240, 120 K, 3) uint8."""
    model, optics = BallModel(fit.profile, sensor.radius), Optics(fit.profile)
    optics.background = torch.from_numpy(fit.background)
    columns = []
    for photograph in photographs:
        image = optics.render(model.displacement(photograph.pose))[0].numpy()
        places = zip(photograph.pose[:2], image.shape[:2])
        row, column = (int(np.clip(at - 30, 0, size - 60)) for at, size in places)
        pair = np.concatenate(
            [of[row : row + 60, column : column + 60] for of in (photograph.picture.astype(np.uint8), image)]
        )
        columns.append(np.asarray(Image.fromarray(pair).resize((120, 240), Image.Resampling.BICUBIC)))
    return np.concatenate(columns, axis=1)


def located(
    sensor: Sensor, lights: SensorProfile, marked: list[Photograph], held: np.ndarray
) -> tuple[dict[str, list[Photograph]], dict[str, float]]:
    """Held-out photographs with the ball in several places, and how far apart these are, pixels.

    Parameters
    ----------
    sensor : Sensor
    lights : SensorProfile
        By which balls are found.
    marked : list of Photograph
        All, with the ball in the middle of the circle.
    held : (K,) array
        Which ones are held out.
    """
    rest = sensor.pack.untouched.astype(np.float32)
    model = BallModel(lights, sensor.radius)
    rows, columns = np.indices(rest.shape[:2])
    even = (rows // SQUARE + columns // SQUARE) % 2 == 0
    shown: dict[str, list[Photograph]] = {"circles": [marked[i] for i in held]}
    shown |= {name: [] for name in ("poses found", "halves", "beside")}
    shown |= {f"{name}, all pixels": [] for name in ("circles", "poses found")}
    off, apart = [], []
    for i in held:
        photograph = marked[i]

        def sought(of: np.ndarray, photograph: Photograph = photograph) -> np.ndarray:
            return fit_pose(model, lights, rest, replace(photograph, disc=photograph.disc & of)).pose

        found = replace(photograph, pose=sought(np.ones_like(even)))
        halves = [sought(of) for of in (even, ~even)]
        for pose, of in zip(halves, (~even, even)):
            shown["halves"].append(Photograph(photograph.picture, photograph.disc & of, pose))
        y, x, size = sensor.pack.circles[i]
        disc, far = circle_mask((y, x, size), rest.shape), circle_mask((y, x, 2 * size), rest.shape)
        shown["poses found"].append(found)
        shown["beside"].append(replace(found, disc=far & ~disc))
        shown["circles, all pixels"].append(replace(photograph, disc=disc))
        shown["poses found, all pixels"].append(replace(found, disc=disc))
        off.append(photograph.pose[:2] - found.pose[:2])
        apart.append(halves[0][:2] - halves[1][:2])
    distances = {"circle and pose found, pixels": off, "two halves, pixels": apart}
    return shown, {
        name: float(np.sqrt(np.mean(np.sum(np.square(of), axis=1)))) for name, of in distances.items()
    }


def measure(sensor: Sensor, seed: int) -> tuple[dict, SensorFit, list[Photograph]]:
    """Scores of one split, dB; the fit with residual; the held-out photographs, poses found."""
    pack, radius = sensor.pack, sensor.radius
    order = np.random.default_rng(seed).permutation(len(pack.pictures))
    chosen, held = np.sort(order[:FITTED]), np.sort(order[FITTED:])
    begun = time.process_time()
    fit = fit_sensor_lights(
        pack.pictures[chosen],
        radius,
        sensor.profile,
        pack.untouched,
        [pack.circles[i] for i in chosen],
        count=LIGHTS,
        residual=True,
    )
    took = time.process_time() - begun
    lights = replace(fit.profile, residual=())
    poses = np.array([[each.row, each.column, each.depth] for each in fit.imprints])
    shift = (poses[:, :2] - [pack.circles[i][:2] for i in chosen]).mean(axis=0)
    rest = pack.untouched.astype(np.float32)
    marked = [
        Photograph(
            picture.astype(np.float32),
            circle_mask(circle, rest.shape) & ~find_overflow(picture),
            np.array([circle[0] + shift[0], circle[1] + shift[1], poses[:, 2].mean()]),
        )
        for picture, circle in zip(pack.pictures, pack.circles)
    ]
    shown, errors_of_places = located(sensor, lights, marked, held)
    row: dict[str, Any] = {"sensor": sensor.name, "seed": seed, "fitted": FITTED, "held out": len(held)}
    whole, used = (
        sum(int(each.disc.sum()) for each in shown[of]) for of in ("circles, all pixels", "circles")
    )
    row |= {"pixels": whole, "overflowed": whole - used}
    for name, of in (("untouched picture", "circles"), ("untouched picture, beside", "beside")):
        errors = [(photograph.picture - rest)[photograph.disc] for photograph in shown[of]]
        row[name] = decibels(np.concatenate(errors))
    row |= regressions(sensor, marked, chosen, held)
    fitted = [replace(marked[i], pose=pose) for i, pose in zip(chosen, poses)]
    for name, profile in (("physical", lights), ("with residual", fit.profile)):
        for where, photographs in ({"fitted ones": fitted} | shown).items():
            row[f"{name}, {where}"] = float(psnr(squared_error(profile, radius, rest, photographs), 255))
    circles = [pack.circles[i] for i in held]
    row["degree 7, fitted to these, circles"] = ceiling(sensor, shown["circles"], circles)
    moved = [(*found.pose[:2], circle[2]) for found, circle in zip(shown["poses found"], circles)]
    row["degree 7, fitted to these, poses found"] = ceiling(sensor, shown["poses found"], moved)
    row |= errors_of_places
    found = shown["poses found"]
    return row | {"cpu_s": took, "photographs": (chosen + 1).tolist()}, fit, found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--taxim", type=Path, metavar="DIR", help="with dataPack.npz and polycalib.npz")
    parser.add_argument("--digit", type=Path, metavar="DIR", help="a checkout of FOTS")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--picture", type=Path, help="file for a picture of the first seed")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the profiles of the first seed")
    given = parsed(parser)
    console = Console(width=max(Console().width, 150))
    rows: list[dict[str, Any]] = []
    missed = []
    for read, folder in ((gelsight, given.taxim), (digit, given.digit)):
        if folder is None:
            continue
        sensor = read(folder)
        for seed in SEEDS:
            row, fit, found = measure(sensor, seed)
            if sensor.name == "gelsight_real":
                rest = sensor.pack.untouched.shape
                shown = [
                    Photograph(
                        picture.astype(np.float32),
                        circle_mask(circle, rest) & ~find_overflow(picture),
                        np.zeros(3),
                    )
                    for picture, circle in zip(sensor.pack.pictures, sensor.pack.circles)
                ]
                row["Taxim's table, all 49"] = taxim_error(folder, sensor, shown)
                if seed == SEEDS[0]:
                    short = {name: goal for name, goal in TARGETS.items() if row[name] < goal}
                    missed += [f"{name}: {row[name]:.1f} dB, target {goal:g}" for name, goal in short.items()]
            if given.picture and sensor.name == "gelsight_real" and seed == SEEDS[0]:
                page = Image.fromarray(compared(sensor, fit, found[::10]))
                page.save(given.picture, optimize=True)
            if given.out and seed == SEEDS[0]:
                given.out.mkdir(parents=True, exist_ok=True)
                save_fit(fit, given.out / f"{sensor.name}.yaml", sensor.name, sensor.source)
            rows.append(row)
            table = Table("", "dB", title=f"{sensor.name}, seed {seed}: {len(row['photographs'])} fitted")
            for name, value in row.items():
                if isinstance(value, float):
                    table.add_row(name, f"{value:.1f}")
            console.print(table)
            write_record(given.json, {"light": rows}, WANTED, missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
