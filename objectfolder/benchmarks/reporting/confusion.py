"""Figures of confusion between classes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from objectfolder.base.figures import page, save_page

NAMED = 40  #: classes at most whose names are legible


def draw_confusion(title: str, counts: Mapping[str, np.ndarray], names: Sequence[str], path: Path) -> Path:
    """Draw one panel for each kind of answers: rows are classes, columns answers, dark is often.

    ``counts`` are, by the panel's title, (K, K) numbers of answers by class and answer. Writes a PNG.
    """
    columns = min(2, len(counts))
    rows = -(-len(counts) // columns)
    side = 3 + 0.11 * min(len(names), NAMED)
    figure = page(columns * side, rows * side, title)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for axes, (kind, answers) in zip(panels, counts.items()):
        total = answers.sum(1, keepdims=True)
        axes.imshow(answers / np.where(total > 0, total, 1), vmin=0, vmax=1, cmap="Blues")
        axes.set_title(f"{kind}: {100 * answers.trace() / answers.sum():.1f} %", fontsize=11)
        if len(names) <= NAMED:
            axes.set_xticks(range(len(names)), names, rotation=90, fontsize=6)
            axes.set_yticks(range(len(names)), names, fontsize=6)
        axes.set_xlabel("answer", fontsize=11)
        axes.set_ylabel("truth", fontsize=11)
    for axes in list(panels):
        axes.set_axis_off()
    return save_page(figure, path)
