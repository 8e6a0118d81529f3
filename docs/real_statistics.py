"""Draw docs/real_statistics.png, what the real hundred is like: `python docs/real_statistics.py`."""

from collections import Counter
from pathlib import Path

import numpy as np
from matplotlib.ticker import MaxNLocator

from objectfolder.base.figures import page, save_page
from objectfolder.hub.fetch.catalogue import read_catalogue

DOCS = Path(__file__).parent
OF_PAPER, OTHER = "#4c72b0", "#dd8452"


def main() -> None:
    entries = read_catalogue(DOCS.parent / "catalogs/real.yaml").objects.values()
    groups = {
        "61 of the paper": (OF_PAPER, [entry for entry in entries if entry.id is not None]),
        "39 others": (OTHER, [entry for entry in entries if entry.id is None]),
    }
    figure = page(11, 3.2, "The real hundred")
    categories, materials, sizes = figure.subplots(1, 3)
    for axes, field in ((categories, "category"), (materials, "material")):
        ranked = Counter(getattr(entry, field) for entry in entries).most_common()
        names, totals = zip(*ranked)
        left = np.zeros(len(names))
        for color, members in groups.values():
            counts = Counter(getattr(entry, field) for entry in members)
            widths = np.array([counts[name] for name in names])
            bars = axes.barh(names, widths, left=left, color=color)
            left += widths
        axes.bar_label(bars, [str(total) for total in totals], padding=3, fontsize=9)
        axes.margins(x=0.12)
        axes.invert_yaxis()
        axes.set(xlabel="objects", title=field)
    edges = np.geomspace(0.01, 3, 21)
    lengths = [[entry.scale for entry in members] for _, members in groups.values()]
    colors = [color for color, _ in groups.values()]
    sizes.hist(lengths, edges, stacked=True, color=colors, label=list(groups))
    sizes.set(xscale="log", xlabel="metres", ylabel="objects", title="longest side")
    sizes.set_ylim(0, 20)  # leaves room for the legend
    sizes.yaxis.set_major_locator(MaxNLocator(integer=True))
    sizes.legend(frameon=False, fontsize=9)
    for axes in (categories, materials, sizes):
        axes.spines[["top", "right"]].set_visible(False)
    save_page(figure, DOCS / "real_statistics.png")


if __name__ == "__main__":
    main()
