"""Check a release of Object Files and draw a sheet of its objects: docs/tutorials/dataset.md.

python CLONE/examples/shared_dataset.py https://HOST/kitchen sheet
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from objectfolder import Dataset

CAMERA, PIXELS = [[1.6, -1.4, 1.1]], 224  # unit frame: the longest side is 1


def draw_views(figure, dataset):
    """Draw each object under a studio's lights, with its name."""
    columns = int(np.ceil(np.sqrt(len(dataset))))
    axes = figure.subplots(-(-len(dataset) // columns), columns, squeeze=False).ravel()
    for place in axes:
        place.set_axis_off()
    for place, file in zip(axes, dataset):  # each is read, or downloaded, when it is asked for
        place.imshow(file.view(CAMERA, lights="studio", resolution=PIXELS)[0])
        place.set_title(f"{file.key}\n{file.material}, {100 * file.scale:.1f} cm", fontsize=8)


def draw_sizes(figure, entries):
    """Draw the lowest frequency of each object against its size, by material; from the index alone."""
    axes = figure.subplots()
    heard = [entry for entry in entries if entry.lowest_hz is not None]
    middle = 50 * max((entry.size for entry in heard), default=0)
    for material in sorted({entry.material for entry in heard}):
        places = {e.key: (100 * e.size, e.lowest_hz) for e in heard if e.material == material}
        axes.scatter(*zip(*places.values()), label=material)
        for key, place in places.items():
            side = {"xytext": (-4, 4), "ha": "right"} if place[0] > middle else {"xytext": (4, 4)}
            axes.annotate(key, place, textcoords="offset points", fontsize=8, **side)
    axes.set(xlabel="longest side (cm)", ylabel="lowest mode (Hz)", xlim=(0, None), ylim=(0, None))
    axes.grid(alpha=0.2)
    axes.legend(title="material")


def main(release: str, out: Path) -> None:
    """Write sheet.webp, and print whom to credit."""
    dataset = Dataset(release)
    dataset.verify()  # every file has the digest that the index gives
    print(f"{dataset}, all as released")
    for entry in dataset.entries:
        print(f"{entry.key}: {entry.licence}, {entry.attribution or entry.source}")
    figure = Figure(figsize=(12, 6), dpi=100, layout="constrained")
    views, sizes = figure.subfigures(1, 2, width_ratios=[3, 2])
    draw_views(views, dataset)
    draw_sizes(sizes, dataset.entries)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "sheet.webp", pil_kwargs={"quality": 80})


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
