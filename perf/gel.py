"""Imprints in a real gel beside the elastic layer: `python perf/gel.py DIR [--json FILE]`.

DIR is `depth_reconstruction/quantitative_real_gan` of github.com/RVSATHU/GelSight-Sim2Real (Chen et al. 2022;
it has no licence, so nothing of it is stored here): photographs of spheres and a prism that a stage pressed
0.25, 0.5, 0.75 and 1 mm deep into one gel.

Colours change once around a sphere. The first harmonic over the azimuth grows with the gel's slope, ring by
ring, and saturates. The visible radius is where it has fallen to half of its maximum, in photograph and
simulation alike. Three numbers of the gel are fitted to the rings of the other sphere or the other depths:
thickness, width over which the painted skin smooths slopes, and depth of the stage when it reads 0; gain and
saturation of the colours are fitted with them. Exits with 1 if a target is missed.
"""

import argparse
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from harness import exit_with_verdict, parsed, write_record
from PIL import Image
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.optimize import curve_fit, minimize

from objectfolder.touch.gel import Layer, indent
from objectfolder.touch.profiles import load_profile

MAX_ERROR = 1.5  # pixels, mean over the eight presses of spheres
PITCH = 0.016 / 270  # m per pixel, as the authors state
SPHERES = {"sphere": (2.92e-3, (208, 166)), "large_sphere": (4.925e-3, (203, 167))}  # radius, column and row
DEPTHS = ("0.25", "0.5", "0.75", "1.0")  # mm, as in the names of the files
PRISM = 5e-3, 7e-3  # m, its face in the authors' model
EDGE_ROWS, EDGE_COLUMNS = slice(150, 185), slice(240, 312)  # across the prism's right edge
WIDTHS = 0.5, 0.25
RINGS = np.arange(1.0, 85.0)
FITTED = slice(1, 70)  # rings
SIDE = 200  # pixels of the simulated gel
THICKNESSES = 2e-3, 4e-3, 6e-3, 8e-3, 12e-3, 18e-3
ZEROS = -1e-4, -7.5e-5, -5e-5, -2.5e-5, 0.0, 2.5e-5  # m, depth of the stage when it reads 0
POISSON = 0.48
SKINS = tuple(PITCH * n for n in (0.0, 0.75, 1.5, 2.25, 3.0, 3.75))
MODULUS = 1.5e5  # Pa; the shape of an imprint does not depend on it

Press = tuple[str, str]  # indenter and depth
Gel = tuple[float, float, float]  # thickness, depth of the stage at 0, deviation of the skin's smoothing
Slopes = dict[Gel, dict[Press, np.ndarray]]

PRESSES: list[Press] = list(itertools.product(SPHERES, DEPTHS))


def read(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"), float)


def change(folder: Path, press: Press) -> np.ndarray:
    """Change of a picture relative to the untouched gel, which is lit unevenly; (H, W, 3)."""
    rest = read(folder / "background_real.png")
    return (read(folder / f"{press[0]}_{press[1]}_real.png") - rest) / np.maximum(rest, 20)


def harmonics(changed: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Amplitude of the first harmonic on each ring about a centre (column, row)."""
    azimuth = np.arange(90) * 2 * np.pi / 90
    at = [centre[1] + RINGS[:, None] * np.sin(azimuth), centre[0] + RINGS[:, None] * np.cos(azimuth)]
    rings = np.stack(
        [map_coordinates(plane, at, order=1, mode="nearest") for plane in np.moveaxis(changed, -1, 0)]
    )
    parts = np.stack([(rings * wave).mean(-1) * 2 for wave in (np.cos(azimuth), np.sin(azimuth))])
    return np.sqrt((parts**2).sum((0, 1)))


def amplitude(folder: Path, press: Press) -> np.ndarray:
    """First harmonic about the centre that explains most of the picture."""
    changed = change(folder, press)

    def unexplained(centre: np.ndarray) -> float:
        return -float((harmonics(changed, centre)[:60] ** 2 * RINGS[:60]).sum())

    centre = minimize(unexplained, SPHERES[press[0]][1], method="Nelder-Mead", options={"xatol": 0.05}).x
    return harmonics(changed, centre)


def response(slope: np.ndarray, gain: float, saturation: float) -> np.ndarray:
    """Amplitude of a slope: linear, then saturating."""
    return gain * slope / (1 + (slope / saturation) ** 2)


def visible_radius(seen: np.ndarray) -> float:
    """Ring past the maximum where an amplitude has fallen to half of it, pixels."""
    top = 5 + int(seen[5:].argmax())
    after = top + int(np.argmax(seen[top:] < seen[top] / 2))
    low, high = seen[after], seen[after - 1]
    return float(RINGS[after - 1] + (high - seen[top] / 2) / (high - low))


def offsets() -> np.ndarray:
    return PITCH * (np.arange(SIDE) - (SIDE - 1) / 2)


def pressed_sphere(press: Press, thickness: float, zero: float) -> np.ndarray:
    """Displacement of a simulated gel."""
    radius, depth = SPHERES[press[0]][0], float(press[1]) * 1e-3 + zero
    square = offsets() ** 2 + offsets()[:, None] ** 2
    cap = depth - radius + np.sqrt(np.maximum(radius**2 - square, 0))
    height = np.where(square < radius**2, cap, -radius).astype(np.float32)
    return indent(height, PITCH, Layer(thickness, MODULUS, POISSON))[0]


def ring_slopes(displacement: np.ndarray, skin: float) -> np.ndarray:
    """Mean slope on each ring of a simulated imprint."""
    smooth = gaussian_filter(displacement.astype(float), skin / PITCH)
    slope = np.hypot(*np.gradient(smooth, PITCH))
    ring = np.hypot(offsets(), offsets()[:, None]) / PITCH
    index = ring.round().astype(int).ravel()
    means = np.bincount(index, slope.ravel()) / np.maximum(np.bincount(index), 1)
    return means[RINGS.astype(int)]


def edge_widths(seen: np.ndarray) -> np.ndarray:
    """Distances from the maximum to where it has fallen to a half and a quarter, pixels."""
    top = int(seen.argmax())
    falling = -np.minimum.accumulate(seen[top:]) / seen[top]
    return np.interp([-part for part in WIDTHS], falling, np.arange(len(falling)))


def seen_edge(folder: Path, depth: str) -> np.ndarray:
    """Widths of the change of colour beside the right edge of the prism."""
    colours = change(folder, ("prism", depth))[EDGE_ROWS].mean(axis=0)
    return edge_widths(np.linalg.norm(colours, axis=1)[EDGE_COLUMNS])


def pressed_edge(depth: str, fit: "Fit") -> np.ndarray:
    """Widths beside the same edge of the simulated prism."""
    thickness, zero, skin = fit.gel
    columns, rows = (np.abs(offsets()) < side / 2 for side in PRISM)
    height = np.where(rows[:, None] & columns, float(depth) * 1e-3 + zero, -1e-3).astype(np.float32)
    displacement, _ = indent(height, PITCH, Layer(thickness, MODULUS, POISSON))
    smooth = gaussian_filter(displacement.astype(float), skin / PITCH)
    slope = -np.gradient(smooth[SIDE // 2 - 15 : SIDE // 2 + 15].mean(axis=0), PITCH)
    return edge_widths(response(slope[SIDE // 2 + 20 :], *fit.colours))


@dataclass(frozen=True)
class Fit:
    """A gel, and gain and saturation of its colours."""

    gel: Gel
    colours: tuple[float, float]
    error: float  # of the fitted amplitudes, relative


def simulate() -> Slopes:
    """Slopes of every gel of the grid under every press."""
    found: Slopes = {}
    for layer in track(list(itertools.product(THICKNESSES, ZEROS)), "gels"):
        shapes = {press: pressed_sphere(press, *layer) for press in PRESSES}
        for skin in SKINS:
            found[(*layer, skin)] = {press: ring_slopes(shape, skin) for press, shape in shapes.items()}
    return found


def mismatch(found: np.ndarray, seen: np.ndarray) -> float:
    """Relative difference of amplitudes, over the imprint's area."""
    weight = RINGS[FITTED]
    error, scale = ((part[FITTED] ** 2 * weight).sum() for part in (found - seen, seen))
    return float(np.sqrt(error / scale))


def fit(slopes: Slopes, seen: dict[Press, np.ndarray], presses: list[Press]) -> Fit:
    """Gel and colours that explain some presses best."""
    target = np.concatenate([seen[press][FITTED] for press in presses])
    deviation = np.tile(1 / np.sqrt(RINGS[FITTED]), len(presses))
    fits = []
    for gel, of in slopes.items():
        given = np.concatenate([of[press][FITTED] for press in presses])
        gain, saturation = curve_fit(response, given, target, p0=(3.5, 1.0), sigma=deviation)[0]
        found = {press: response(of[press], gain, saturation) for press in presses}
        error = np.mean([mismatch(found[press], seen[press]) for press in presses])
        fits.append(Fit(gel, (float(gain), float(saturation)), float(error)))
    return min(fits, key=lambda each: each.error)


def others(press: Press) -> dict[str, list[Press]]:
    """What each split fits to predict a press."""
    return {
        "from the other sphere": [other for other in PRESSES if other[0] != press[0]],
        "from two other depths": [p for p in PRESSES if (p[1] in DEPTHS[::2]) != (press[1] in DEPTHS[::2])],
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="with sphere_0.5_real.png and so on")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    seen = {press: amplitude(given.folder, press) for press in PRESSES}
    slopes = simulate()
    digit = load_profile("digit")
    default = digit.elastomer_thickness, 0.0, digit.slope_smoothing
    shapes = {press: pressed_sphere(press, *default[:2]) for press in PRESSES}
    shipped: Slopes = {default: {press: ring_slopes(shape, default[2]) for press, shape in shapes.items()}}
    fitted: dict[tuple[Press, ...], Fit] = {}
    rows: list[dict[str, Any]] = []
    for press in PRESSES:
        radius, depth = SPHERES[press[0]][0], float(press[1]) * 1e-3
        row: dict[str, Any] = {"press": " ".join(press), "photograph": visible_radius(seen[press])}
        row["Hertz"] = float(np.sqrt(radius * depth) / PITCH)
        row["overlap"] = float(np.sqrt(2 * radius * depth - depth**2) / PITCH)
        split = others(press)
        colours = fit(shipped, seen, split["from the other sphere"]).colours
        row["gel of digit"] = visible_radius(response(shipped[default][press], *colours))
        for name, presses in split.items():
            if tuple(presses) not in fitted:
                fitted[tuple(presses)] = fit(slopes, seen, presses)
            chosen = fitted[tuple(presses)]
            predicted = response(slopes[chosen.gel][press], *chosen.colours)
            row |= {name: visible_radius(predicted), f"rings {name}": mismatch(predicted, seen[press])}
        rows.append(row)
    console = Console(width=max(Console().width, 150))
    names = [name for name in rows[0] if name not in ("press", "photograph") and not name.startswith("rings")]
    errors = {name: float(np.mean([abs(row[name] - row["photograph"]) for row in rows])) for name in names}
    table = Table(
        "press", *list(rows[0])[1:], title="Visible radius of a sphere's imprint, pixels of 0.0593 mm"
    )
    for row in rows:
        shown = (
            f"{value:.0%}" if name.startswith("rings") else f"{value:.1f}"
            for name, value in row.items()
            if name != "press"
        )
        table.add_row(row["press"], *shown)
    console.print(table)
    text = ", ".join(f"{name} {error:.2f}" for name, error in errors.items())
    console.print(f"mean error, pixels (target {MAX_ERROR:g}): {text}", highlight=False)
    whole = fit(slopes, seen, PRESSES)
    edges = Table(
        "depth", "photograph", "fitted to the spheres", title="Prism: pixels from its edge to 1/2, 1/4"
    )
    prism = []
    for depth in DEPTHS:
        both = seen_edge(given.folder, depth), pressed_edge(depth, whole)
        edges.add_row(depth, *(" ".join(f"{width:.1f}" for width in widths) for widths in both))
        prism.append({"depth": depth, "photograph": both[0].tolist(), "gel": both[1].tolist()})
    console.print(edges)
    for chosen in [*fitted.values(), whole]:
        thickness, zero, skin = chosen.gel
        console.print(
            f"fitted: {1000 * thickness:g} mm thick, stage {1000 * zero:g} mm deep at 0, "
            f"skin {1000 * skin:.2f} mm; "
            f"colours {chosen.colours[0]:.2f}, {chosen.colours[1]:.2f}; rings {chosen.error:.0%}",
            highlight=False,
        )
    gels = [[*chosen.gel, *chosen.colours, chosen.error] for chosen in [*fitted.values(), whole]]
    missed = [
        f"{n}: {e:.2f} pixels, target {MAX_ERROR:g}"
        for n, e in errors.items()
        if n.startswith("from") and e > MAX_ERROR
    ]
    record = {"radii": rows, "errors": errors, "prism": prism, "fits": gels}
    write_record(given.json, record, f"{MAX_ERROR:g} pixels in the mean, for fitted gels", missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
