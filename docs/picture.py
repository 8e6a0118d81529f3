"""Draw docs/starter.png: `python docs/picture.py [FILE...]`, of the samples if no files are given."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from objectfolder import ObjectFile
from objectfolder.base.io import atomic
from objectfolder.objectfile.samples import available_samples
from objectfolder.report.comparison import join_spectrograms, shown_rate

CAMERAS = np.array([[1.9, -1.2, 1.1], [-1.6, -1.6, 1.2], [0.6, 2.0, 1.5]])


def main(objects: list[ObjectFile]) -> None:
    figure = Figure(figsize=(13, 2.6 * len(objects)), dpi=110, layout="constrained")
    axes = figure.subplots(len(objects), 6, squeeze=False, width_ratios=[1, 1, 1, 0.75, 0.75, 1.5])
    for row, obj in zip(axes, objects):
        for ax, image in zip(row, obj.view(CAMERAS, lights="studio")):
            ax.imshow(image)
        points = obj.sample_surface(200, seed=4)
        images = obj.touch(points, depth=0.0012)
        contrast = images.astype(float).std((1, 2)).sum(1)
        for ax, image in zip(row[3:5], images[np.argsort(contrast)[[-1, -12]]]):
            ax.imshow(image)
        rate = shown_rate(obj)
        image, seconds = join_spectrograms(None, obj.impact(points[:1], [[0.6, 0.5, 0.7]], rate)[0], rate)
        row[5].imshow(image, aspect="auto", extent=(0, seconds, 0, rate / 2000))
        row[5].set(xlabel="s", ylabel="kHz")
        row[0].set_ylabel(f"{obj.key}: {obj.material}, {obj.scale * 100:.0f} cm")
        for ax in row[:5]:
            ax.set(xticks=[], yticks=[])
    for ax, title in zip(axes[0], ("look", "", "", "feel", "", "sound")):
        ax.set_title(title)
    with atomic(Path(__file__).parent / "starter.png") as path:
        figure.savefig(path)


if __name__ == "__main__":
    given = [ObjectFile.load(path) for path in sys.argv[1:]]
    main(given or [ObjectFile.sample(name) for name in reversed(available_samples())])
