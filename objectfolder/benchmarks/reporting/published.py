"""Figures that others published, each with its metric, its data and its source.

Tables and pages take published figures from here alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from objectfolder.benchmarks.reporting.tables import Table

PAPER = "Gao et al., CoRL 2021"


@dataclass(frozen=True, kw_only=True)
class Published:
    """Figures of one table of others."""

    by: str = "paper"  #: who published them
    metric: str
    data: str  #: objects, split, gallery
    source: str  #: paper and table; or repository, file, commit and date
    figures: Mapping[str, tuple[float, ...]]  #: by row
    heads: tuple[str, ...] = ("paper",)  #: of columns of these figures
    digits: str = ".1f"
    key: int = 0  #: cell that names the row in a table of ours
    split: str | None = "seen"  #: None: the task has no splits
    tested: int | None = 100  #: objects of the test; None: any

    def cells(self, row: str) -> tuple[str, ...]:
        """Return a row's figures as text, dashes if there are none."""
        found = self.figures.get(row)
        return ("-",) * len(self.heads) if found is None else tuple(f"{x:{self.digits}}" for x in found)

    def listed(self) -> str:
        """List all rows and their figures."""
        return ", ".join(f"{row} {' / '.join(self.cells(row))}" for row in self.figures)

    def cited(self) -> str:
        """Say what the figures are, and where they are printed."""
        return f"{self.metric}, {self.data} ({self.source})"


def beside(table: Table, published: Published, tested: int | None) -> Table:
    """Add published figures to a table; only to its note unless as many objects were tested here."""
    if tested != published.tested:
        told = f"The {published.by} has {published.listed()}, not comparable with {tested} test objects here"
        return replace(table, note=f"{table.note} {told}: {published.cited()}.")
    rows = [(*row, *published.cells(row[published.key])) for row in table.rows]
    note = f"{table.note} From the {published.by}: {published.cited()}."
    return Table(table.title, (*table.columns, *published.heads), rows, note)


def tested_objects(split: str, scores: Mapping[str, Any]) -> int:
    """Return how many objects a split tests: all that are seen, or a share of them, as of the ``rows``."""
    objects, rows = scores["objects"], scores["rows"]
    return objects if split == "seen" else round(objects * rows["test"] / sum(rows.values()))


PSNR = Published(
    metric="PSNR in dB, of Object Files and of the ground truth with white noise (variance 0.05 by its text)",
    data="500 test views, sounds or touches of each of 100 objects",
    source=f"{PAPER}, supplementary, Table 2",
    figures={"vision": (39.8, 32.0), "audio": (53.6, 26.2), "touch": (29.4, 24.2)},
    heads=("paper", "paper, noise"),
)
LISTENING = Published(
    metric="% of 160 answers that prefer the simulation to a recording",
    data="10 listeners, 16 pairs",
    source=f"{PAPER}, supplementary, D",
    figures={"simulation": (42,)},
    digits=".0f",
)
RECOGNITION = Published(
    metric="accuracy in %",
    data="100 objects, of 500 observations of each sense a tenth for the test",
    source=f"{PAPER}, Table 2",
    figures={
        **{"V": (94.8,), "A": (98.3,), "T": (72.4,), "VA": (99.5,), "VT": (97.2,), "AT": (99.0,)},
        **{"VAT": (99.8,), "chance": (1.0,)},
    },
)
MATERIALS = Published(
    by="ObjectFolder Benchmark",
    metric="accuracy in % of FENet, its better method",
    data="7 materials, 100 unseen objects, trained on 800 others; 622 of the 1,000 are of wood, by "
    "rhgao/ObjectFolder, objects.csv at 3c6cd89 of 2022-08-31",
    source="objectfolder/material-classification, README.md at e19af7d of 2024-07-26",
    figures={"V": (92.25,), "A": (95.80,), "T": (75.89,), "VAT": (96.60,)},
    heads=("ObjectFolder Benchmark",),
    digits=".2f",
    split="unseen",
)
RETRIEVAL = Published(
    metric="mAP of its nets and of its CCA",
    data="100 objects, not comparable as they stand, since its chance of 0.05 is of another gallery",
    source=f"{PAPER}, Table 3",
    figures={
        "V->A": (0.90, 0.57),
        "V->T": (0.50, 0.24),
        "A->V": (0.92, 0.59),
        "A->T": (0.55, 0.31),
        "T->V": (0.48, 0.29),
        "T->A": (0.64, 0.33),
    },
    heads=("paper", "paper's CCA"),
    digits=".2f",
)
#: mAP in %, of CCA, PLSCA, DSCMR and DAR.
_METHODS = {
    "V->A": (19.56, 11.53, 9.13, 20.64),
    "V->T": (6.97, 6.33, 3.57, 7.03),
    "A->V": (20.58, 13.37, 10.84, 20.17),
    "A->T": (5.27, 6.96, 5.30, 6.91),
    "T->V": (8.50, 6.25, 4.92, 8.80),
    "T->A": (6.18, 7.11, 6.15, 7.77),
    "V->V": (55.52, 82.43, 82.74, 89.28),
    "A->A": (70.53, 80.77, 75.45, 77.80),
    "T->T": (28.06, 52.30, 51.08, 54.80),
}
UNSEEN_RETRIEVAL = Published(
    by="ObjectFolder Benchmark",
    metric="mAP of the best of CCA, PLSCA, DSCMR and DAR",
    data="100 observations of each sense of 100 unseen objects, trained on 800 others; its chance is 0.010",
    source="objectfolder/cross-sensory-retrieval, README.md at 9e40fde of 2024-07-26",
    figures={direction: (max(found) / 100,) for direction, found in _METHODS.items()},
    heads=("ObjectFolder Benchmark",),
    digits=".3f",
    split="unseen",
)
LOCALIZATION = Published(
    by="ObjectFolder Benchmark",
    metric="distance in % of a size of each object that its repository does not state, of MCR, its better "
    "method on all senses",
    data="50 objects with rich surface features, contacts mostly where the curvature is unusual; random "
    "places have 47.32",
    source="objectfolder/contact-localization, README.md at 4bb002f of 2024-07-26",
    figures={
        "touch": (23.59,),
        "sound": (4.85,),
        "close view": (5.03,),
        "touch + sound": (3.89,),
        "touch + close view": (4.84,),
        "close view + sound": (1.76,),
        "touch + close view + sound": (1.84,),
    },
    heads=("ObjectFolder Benchmark",),
    digits=".2f",
    split=None,
    tested=None,
)
RECONSTRUCTION = Published(
    metric="IoU, Chamfer-L1 and normal consistency",
    data="100 objects, new observations",
    source=f"{PAPER}, Table 4",
    figures={
        "average shape": (0.0675, 0.1067, 0.6312),
        "image": (0.8809, 0.0046, 0.9522),
        "audio": (0.8729, 0.0048, 0.9504),
        "image + audio": (0.8906, 0.0043, 0.9535),
    },
    heads=("paper: IoU", "paper: Chamfer-L1", "paper: normal consistency"),
    digits=".4f",
)
GRASPING = Published(
    metric="success in % of 200 rollouts",
    data="its tonic bottle, in Bullet",
    source=f"{PAPER}, Sec. 4.4",
    figures={"tactile images alone": (75.5,), "random actions": (53.0,)},
    key=1,
    split=None,
    tested=None,
)
REACH = Published(
    metric="success in %",
    data="its cup, bowl and dice, at a step that is not said",
    source=f"{PAPER}, supplementary, J",
    figures={"PPO": (100,)},
    digits=".0f",
    key=1,
    split=None,
    tested=None,
)
