"""How IMAGE2MESH does on another renderer's pictures: `python perf/photographs.py MODEL --observations DIR`.

The path-traced views of the mesh, on white and on a cluttered background, as they are and cut out by their
alpha, beside views of the Object Files that the model was tested on. IoU, means over objects and pictures.
"""

import argparse
from pathlib import Path

import numpy as np
from harness import parsed, write_record
from rich.console import Console
from rich.table import Table

from objectfolder.base.arrays import read_npz
from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.datasets.occupancy import is_inside, uniform_points
from objectfolder.benchmarks.datasets.splits import per_sample
from objectfolder.benchmarks.models.shape_model import load_model
from objectfolder.benchmarks.tasks.photograph import photograph_scores, view_scores
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Build

SCORE_POINTS = 30000


def pictures(build: Build) -> np.ndarray:
    """Path-traced test views that show something; (N, H, W, 4) linear, premultiplied."""
    rgba = read_npz(build.views("test"), "rgba")["rgba"]
    return rgba[(rgba[..., 3] > 0.5).any((1, 2))].astype(np.float32)


def scores(model_path: Path, root: Path, observations: Path, seed: int = 0) -> dict[str, dict[str, float]]:
    """IoU by object and condition."""
    model = load_model(model_path)
    keys = model.setup.keys
    observed = Observations({key: observations / key for key in keys})
    split = per_sample(observed.keys, observed.count)
    points = uniform_points(SCORE_POINTS, numpy_generator(seed, "photographs", "points"))
    rows: dict[str, dict[str, float]] = {}
    for label, key in enumerate(observed.keys):
        build = Build(key, root)
        inside = is_inside(ObjectFile.load(build.object_file).surface, points)
        own = observed.read("vision", split.test[observed.labels[split.test] == label])
        rng = numpy_generator(seed, "photographs", "clutter", key)
        by_condition = {"Object File": view_scores(model, own, points, inside)}
        by_condition |= photograph_scores(model, pictures(build), points, inside, rng)
        rows[key] = {name: float(values.mean()) for name, values in by_condition.items()}
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path, help="reconstruct_seen.safetensors of the benchmark")
    parser.add_argument("--root", type=Path, default=Path(), help="workspace whose build/ has the views")
    parser.add_argument("--observations", type=Path, required=True, help="folder with a folder per object")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    rows = scores(given.model, given.root, given.observations)
    conditions = list(next(iter(rows.values())))
    table = Table("object", *conditions, title="IoU of IMAGE2MESH")
    for key, row in rows.items():
        table.add_row(key, *(f"{row[name]:.3f}" for name in conditions))
    means = {name: float(np.mean([row[name] for row in rows.values()])) for name in conditions}
    table.add_section()
    table.add_row("mean", *(f"{means[name]:.3f}" for name in conditions))
    Console().print(table)
    write_record(given.json, {"objects": rows, "mean": means})


if __name__ == "__main__":
    main()
