"""Flow of markers beside that of a real gel: `python perf/markers.py DIR [--json FILE] [--picture FILE]`.

DIR is `marker_calib/data` of github.com/Rancho-zhao/FOTS (Zhao et al. 2024; its README says MIT): `0.csv` and
`1.csv` hold 99 markers of a GelSight of 320 x 240 pixels, 19.58 to a millimetre, and their motion in whole
pixels, under a ball that is pressed and, in `1.csv`, pushed sideways as well. Where the ball is, how deep,
and how far it was pushed is not stated: the ball's place and depth, the push and a common motion of all
markers are fitted, seven numbers for 198.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from harness import parsed, write_record
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from objectfolder.base.figures import page, save_page
from objectfolder.touch.gel import deform
from objectfolder.touch.markers import marker_flow
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.tangential import shear_contacts

PRESSES = {"0": "pressed", "1": "pressed and pushed"}
COARSER = 4  # the simulated image has 80 x 60 pixels
PITCH = 1e-3 / 19.58 * COARSER  # m
RADIUS = 2.35e-3  # m, of the ball, as in the authors' params.py
FRICTION = 1.0  # high: nothing is known of the ball's
START = 35.0, 32.0, 1e-3, 0.0, 0.0, 0.0, 0.0  # column, row; depth, m; push, m; common motion, pixels
STEPS = 1.0, 1.0, 2e-4, 2e-4, 2e-4, 1.0, 1.0
REACH = 15.0, 15.0, 0.95e-3, 2e-3, 2e-3, 3.0, 3.0
ENLARGED = 3  # arrows, in the picture


def sensor() -> SensorProfile:
    profile = load_profile("gelsight_mini")
    angle = 2 * np.degrees(np.arctan(30 * PITCH / profile.camera_to_gel))
    return replace(
        profile, height=60, width=80, vertical_fov_deg=float(angle), slope_smoothing=0.0, image_smoothing=0.0
    )


def flow(x: np.ndarray, places: np.ndarray, profile: SensorProfile) -> np.ndarray:
    """Return the markers' motion; (M, 2) pixels of the photographs."""
    column, row, depth, right, down = x[:5]
    rows, columns = np.indices((profile.height, profile.width))
    square = ((columns - column) ** 2 + (rows - row) ** 2) * PITCH**2
    cap = depth - RADIUS + np.sqrt(np.maximum(RADIUS**2 - square, 0))
    height = np.where(square < RADIUS**2, cap, -RADIUS).clip(-6e-4, profile.max_indentation)
    displacement, pressure = deform(height[None], profile)
    sheared = shear_contacts(pressure, np.array([[right, -down]]), np.zeros(1), np.array([FRICTION]), profile)
    return marker_flow(places, sheared.displacement, displacement, profile)[0] * COARSER + x[5:]


def draw(found: list[tuple[str, np.ndarray, np.ndarray, np.ndarray]], path: Path) -> None:
    """Draw markers and their enlarged motion: a row for each press, the real gel beside ours.

    Parameters
    ----------
    found : list of tuple
        Title, places (N, 2), motion of the real gel (N, 2) and ours (N, 2); pixels.
    """
    sheet = page(9.6, 7.4, f"Motion of markers; arrows are {ENLARGED} times as long")
    panels = sheet.subplots(len(found), 2, squeeze=False)
    for row, (title, places, seen, ours) in zip(panels, found, strict=True):
        for axes, motion, gel in zip(row, (seen, ours), ("real gel (FOTS, MIT)", "ours"), strict=True):
            axes.scatter(*places.T, s=14, color="0.7")
            axes.quiver(
                *places.T, *(ENLARGED * motion).T, color="firebrick",
                angles="xy", scale_units="xy", scale=1, width=0.0035,
            )  # fmt: skip
            axes.set(xlim=(-12, 332), ylim=(252, -12), aspect="equal", xticks=[], yticks=[])
            axes.set_title(f"{title}: {gel}", fontsize=10)
    save_page(sheet, path)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="with 0.csv and 1.csv")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--picture", type=Path, help="file for a drawing")
    given = parsed(parser)
    profile = sensor()
    rows, drawn = [], []
    for name, title in PRESSES.items():
        marks = np.loadtxt(given.folder / f"{name}.csv", delimiter=",", skiprows=1)
        places, seen = (marks[:, :2] + 0.5) / COARSER - 0.5, marks[:, 2:]

        def errors(x: np.ndarray, places: np.ndarray = places, seen: np.ndarray = seen) -> np.ndarray:
            return (flow(x, places, profile) - seen).ravel()

        start, reach = np.array(START), np.array(REACH)
        found = least_squares(
            errors, start, bounds=(start - reach, start + reach), x_scale=STEPS, diff_step=0.02, max_nfev=20
        )
        ours = found.fun.reshape(-1, 2) + seen
        rows.append(
            {
                "press": title,
                "motion": float(np.sqrt(np.mean((seen - seen.mean(axis=0)) ** 2))),
                "error": float(np.sqrt(np.mean(found.fun**2))),
                "correlation": float(np.corrcoef(ours.ravel(), seen.ravel())[0, 1]),
                "greatest": float(np.hypot(*seen.T).max()),
                "greatest, ours": float(np.hypot(*ours.T).max()),
                "depth_mm": float(found.x[2] * 1e3),
                "push_mm": float(np.hypot(*found.x[3:5]) * 1e3),
            }
        )
        drawn.append((title, marks[:, :2], seen, ours))
    table = Table(*rows[0], title="Markers' motion, pixels (root mean square about its mean)")
    for row in rows:
        table.add_row(*(value if isinstance(value, str) else f"{value:.2f}" for value in row.values()))
    Console(width=max(Console().width, 120)).print(table)
    write_record(given.json, {"markers": rows})
    if given.picture:
        draw(drawn, given.picture)


if __name__ == "__main__":
    main()
