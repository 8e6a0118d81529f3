"""How touch recognition grows with data and training: `python perf/touch_curve.py BUILD --out DIR`.

Trains the net of row T of `objectfolder bench recognize --preset laptop`, one seed, on fewer and on more
touches of each object and for fewer and more steps, on the same validation and test touches. DIR is the
benchmark's: observations are taken from it; touches beyond them are sampled with two processes, and only
learnt from. With `--depth`, all presses are so deep; observations of another depth in DIR are touched again,
so give a copy of it. An interrupted call goes on when repeated; other objects, settings or code begin anew.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from harness import parsed, write_record
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torch.nn import functional as F

from objectfolder.base.arrays import write_npz
from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.datasets.observations import Observations, certain_observations
from objectfolder.benchmarks.datasets.sampling import ask, draw_queries
from objectfolder.benchmarks.datasets.settings import ObserveConfig
from objectfolder.benchmarks.models.classifier import Classifier
from objectfolder.benchmarks.models.inputs import encoder_inputs, shift_each
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.models.touch_frame import gel_inputs, mirror_each, own_shapes
from objectfolder.benchmarks.models.training import Objective
from objectfolder.benchmarks.run import BenchmarkOptions, LoadedFile, collect_samples, load_object_files
from objectfolder.benchmarks.scoring.together import accuracy_together
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.recognize import TASK, RecognizeConfig
from objectfolder.benchmarks.tasks.recognize_training import FLAT, recognize
from objectfolder.benchmarks.tasks.running import Run
from objectfolder.benchmarks.tasks.touch_shapes import in_touch_frame
from objectfolder.engine.process import in_processes
from objectfolder.objectfile.file import ObjectFile
from objectfolder.touch.inverse import PhotometricInverse
from objectfolder.workspace import params as workspace

#: Touches of an object to learn from, and steps in thousands.
RUNS = ((320, 8), (1520, 8), (80, 8), (160, 8), (320, 2), (320, 4), (1520, 24))
TOUCHES = (1, 2, 4, 8, 16)  #: that answer together
ROUND = 500  #: steps between two looks at the validation touches
CHUNK = 100  #: touches at once
Batch = tuple[torch.Tensor, torch.Tensor]  #: inputs, classes


@dataclass(frozen=True)
class Form:
    """What is kept of a touch: its pooled image, or the shape of the gel in its own frame."""

    size: tuple[int, int]
    inverse: PhotometricInverse | None

    def of(self, images: np.ndarray) -> np.ndarray:
        """(B, H, W, 3) uint8 -> (B, 3 or 1, h, w) float16."""
        if self.inverse is None:
            return encoder_inputs("touch", images, InputSizes((0, 0), (0, 0), self.size)).half().numpy()
        return own_shapes(images, self.inverse).half().numpy()[:, None]


def sample_more(
    path: Path, first: int, count: int, depth: float | None, form: "Form", seed: int, to: Path
) -> None:
    """Write the forms of an object's touches from the ``first`` on: those that hit something."""
    torch.set_num_threads(1)
    file = ObjectFile.load(path)
    drawn = draw_queries(file, first + count, seed, depth)
    queries, found = {name: rows[first:] for name, rows in drawn.items()}, []
    for start in range(0, count, CHUNK):
        rows = {name: values[start : start + CHUNK] for name, values in queries.items()}
        images, missed = ask(file, rows, "touch", 0)
        found.append(form.of(images[~missed]))
    write_npz(to, touches=np.concatenate(found))


def more_touches(
    sources: dict[str, LoadedFile], job: Job[RecognizeConfig], each: int, depth: float | None, folder: Path
) -> dict[str, Path]:
    """Sample further touches of each object unless that was done; return the files by key."""
    first = job.observations.count
    files = {key: folder / f"{key}_{first}_{each}.npz" for key in job.observations.keys}
    asked = (first, each, depth, form_of(job), job.seed)
    new = [(sources[key].path, *asked, path) for key, path in files.items() if not path.is_file()]
    for _ in track(in_processes(sample_more, new, 2) if new else (), "touching", total=len(new)):
        pass
    return files


class Learnt:
    """The touches to learn from: of each object those of the training rows, then further ones."""

    def __init__(self, job: Job[RecognizeConfig], more: dict[str, Path], most: int):
        self.job, train, form = job, job.split.train, form_of(job)
        channels = 3 if form.inverse is None else 1
        self._inputs = np.empty((most * len(job.observations.keys), channels, *form.size), np.float16)
        self._rows = []
        end = 0
        for label, key in enumerate(job.observations.keys):
            own, start = train[job.observations.labels[train] == label][:most], end
            for some in np.array_split(own, -(-len(own) // CHUNK)):
                self._inputs[end : end + len(some)] = form.of(job.observations.read("touch", some))
                end += len(some)
            if key in more:
                with np.load(more[key], allow_pickle=False) as stored:
                    further = stored["touches"][: most - len(own)]
                self._inputs[end : end + len(further)] = further
                end += len(further)
            self._rows.append(np.arange(start, end))

    def batches(self, each: int, steps: int, batch: int, purpose: tuple[str, ...]) -> Iterator[Batch]:
        """Yield batches of random touches of all objects, of each its first ``each``."""
        rng = numpy_generator(self.job.seed, *purpose)
        rows = np.concatenate([own[:each] for own in self._rows])
        labels = np.repeat(np.arange(len(self._rows)), [len(own[:each]) for own in self._rows])
        rounds = -(-steps * batch // len(rows))
        order = np.concatenate([rng.permutation(len(rows)) for _ in range(rounds)])
        for some in np.split(order[: steps * batch], steps):
            kept = torch.from_numpy(self._inputs[rows[some]]).float()
            if self.job.inverse is None:
                given = self.job.ground.subtracted(kept)
            else:
                given = mirror_each(gel_inputs(kept[:, 0]), rng)
            yield shift_each(given, self.job.encode.shift, rng), torch.from_numpy(labels[some])


def form_of(job: Job[RecognizeConfig]) -> Form:
    """Return what a job keeps of touches."""
    return Form(job.sizes.touch, job.inverse)


def trained(
    job: Job[RecognizeConfig], learnt: Learnt, each: int, thousands: int, say: Callable[[str], None]
) -> dict[str, Any]:
    """Train one net and score it."""
    labels, rounds = job.observations.labels, 1000 * thousands // ROUND
    purpose = ("touch curve", str(each), str(thousands))
    with seeded(job.seed, *purpose):
        net = Classifier({"T": job.make_encoder("touch")}, len(job.observations.keys))

    @torch.no_grad()
    def answers(rows: np.ndarray) -> np.ndarray:
        parts = np.array_split(rows, -(-len(rows) // CHUNK))
        logits = torch.cat([net({"T": job.inputs("touch", some)}) for some in parts])
        return logits.double().log_softmax(1).numpy()

    def right(rows: np.ndarray) -> np.ndarray:
        return answers(rows).argmax(1) == labels[rows]

    def batch_loss(batch: Batch) -> torch.Tensor:
        given, expected = batch
        return F.cross_entropy(net({"T": given}), expected, label_smoothing=job.params.label_smoothing)

    curve = replace(job, params=replace(job.params, patience=rounds), report=say).train(
        f"{each} touches, {thousands},000 steps",
        Objective(
            net,
            lambda number: learnt.batches(each, ROUND, job.params.batch, (*purpose, str(number))),
            batch_loss,
            lambda: float(right(job.split.val).mean()),
            "accuracy",
        ),
        job.progress / f"{each}_{thousands}.pt",
        rounds,
        cycle=rounds * ROUND,
    )
    test, observations = job.split.test, cast(Observations, job.observations)
    answered, of = answers(test), labels[test]
    known = answered.argmax(1) == of
    flat = (observations.relief(test) < FLAT) | observations.untouched(test)
    rng = numpy_generator(job.seed, *purpose, "together")
    return {
        "touches": each,
        "steps": 1000 * thousands,
        "accuracy": float(known.mean()),
        "not_flat": float(known[~flat].mean()),
        "together": {str(n): accuracy_together(answered, of, of, n, rng) for n in TOUCHES},
        "validation": max(point.val_score for point in curve),
        "train_loss": curve[-1].train_loss,
        "seconds": sum(point.seconds for point in curve),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build", type=Path, help="folder KEY/ObjectFile.safetensors")
    parser.add_argument("--out", type=Path, required=True, help="folder of the benchmark, with observations")
    parser.add_argument("--runs", type=int, default=len(RUNS), help="of the list, so many from the start")
    parser.add_argument("--frame", choices=("sensor", "own"), default="sensor", help="recognize.touch_frame")
    parser.add_argument("--depth", type=float, help="of all presses, m; default: at random")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    torch.set_num_threads(1)
    console = Console()
    options = BenchmarkOptions(files=[given.build], preset="laptop", out=given.out)
    values, path = options.values()
    params = options.params(TASK, values, path)
    params = replace(params, settings=replace(params.settings, touch_frame=given.frame))
    sources = load_object_files(options.files)
    observe = replace(workspace.settings(ObserveConfig, values, path), depth=given.depth)
    folders = collect_samples("observations", sources, (observe, params.seed), options.folder, 2, track)
    whole = Run(
        **{"task": TASK, "training": recognize, "part": "seen", "inputs": certain_observations(folders)},
        **{"params": params, "folder": options.folder, "device": "cpu"},
    )
    progress = options.folder.progress("touch_curve", "seen", whole.identity())
    progress.mkdir(parents=True, exist_ok=True)
    job = whole.job(progress, console.print)
    job = in_touch_frame(job.without_repeats(job.repeats(["touch"]), ["touch"]))
    first = len(job.split.train) // len(job.observations.keys)
    runs = RUNS[: given.runs]
    most = max(each for each, _ in runs)
    more = more_touches(sources, job, most - first, given.depth, progress) if most > first else {}
    learnt = Learnt(job, more, most)
    rows: list[dict[str, Any]] = []
    for run in runs:
        name = "_".join(map(str, run))
        found = job.compute_once(name, partial(trained, job, learnt, *run, console.print))
        rows.append(
            found | {"frame": given.frame, "depth": given.depth, "objects": len(job.observations.keys)}
        )
        write_record(given.json, rows)
    together = [f"{n} together, %" for n in TOUCHES[1:]]
    columns = ("touches of an object", "steps", "accuracy, %", "not flat, %", *together, "min")
    table = Table(*columns, title=f"Touch, frame {given.frame}, {len(job.observations.keys)} objects")
    for row in sorted(rows, key=lambda row: (row["touches"], row["steps"])):
        groups = [row["together"][str(n)] for n in TOUCHES[1:]]
        shares = (f"{100 * share:.1f}" for share in (row["accuracy"], row["not_flat"], *groups))
        table.add_row(str(row["touches"]), str(row["steps"]), *shares, f"{row['seconds'] / 60:.0f}")
    console.print(table)


if __name__ == "__main__":
    main()
