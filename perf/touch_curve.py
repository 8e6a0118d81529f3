"""How touch recognition grows with data and training: `python perf/touch_curve.py BUILD --out DIR`.

Trains the net of row T of `objectfolder bench recognize --preset laptop`, one seed, on fewer and on more
touches of each object and for fewer and more steps, on the same validation and test touches. DIR is the
benchmark's: observations are taken from it; touches beyond them are sampled with two processes, and only
learnt from. An interrupted call goes on when repeated; other objects, settings or code begin anew.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from harness import parsed, write_record
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torch.nn import functional as F

from objectfolder.base.arrays import write_npz
from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.datasets.sampling import ask, draw_queries
from objectfolder.benchmarks.datasets.settings import ObserveConfig
from objectfolder.benchmarks.models.classifier import Classifier
from objectfolder.benchmarks.models.inputs import encoder_inputs, shift_each
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.models.training import Objective
from objectfolder.benchmarks.run import BenchmarkOptions, LoadedFile, collect_samples, load_object_files
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.recognize import TASK, RecognizeConfig
from objectfolder.benchmarks.tasks.recognize_training import FLAT, recognize
from objectfolder.benchmarks.tasks.running import Run
from objectfolder.engine.process import in_processes
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace import params as workspace

#: Touches of an object to learn from, and steps in thousands.
RUNS = ((320, 8), (1520, 8), (80, 8), (160, 8), (320, 2), (320, 4), (1520, 24))
MOST = max(touches for touches, _ in RUNS)
ROUND = 500  #: steps between two looks at the validation touches
CHUNK = 100  #: touches at once
Batch = tuple[torch.Tensor, torch.Tensor]  #: inputs, classes


def sample_more(path: Path, first: int, count: int, size: tuple[int, int], seed: int, to: Path) -> None:
    """Write the encoder inputs of an object's touches from the ``first`` on: those that hit something."""
    torch.set_num_threads(1)
    file = ObjectFile.load(path)
    queries = {name: rows[first:] for name, rows in draw_queries(file, first + count, seed).items()}
    sizes, found = InputSizes((0, 0), (0, 0), size), []
    for start in range(0, count, CHUNK):
        rows = {name: values[start : start + CHUNK] for name, values in queries.items()}
        images, missed = ask(file, rows, "touch", 0)
        found.append(encoder_inputs("touch", images[~missed], sizes).half().numpy())
    write_npz(to, touches=np.concatenate(found))


def more_touches(
    sources: dict[str, LoadedFile], job: Job[RecognizeConfig], each: int, folder: Path
) -> dict[str, Path]:
    """Sample further touches of each object unless that was done; return the files by key."""
    first = len(job.observations) // len(sources)
    files = {key: folder / f"{key}_{first}_{each}.npz" for key in sources}
    asked = (first, each, job.sizes.touch, job.seed)
    new = [(sources[key].path, *asked, path) for key, path in files.items() if not path.is_file()]
    for _ in track(in_processes(sample_more, new, 2) if new else (), "touching", total=len(new)):
        pass
    return files


class Learnt:
    """The touches to learn from: of each object those of the training rows, then further ones."""

    def __init__(self, job: Job[RecognizeConfig], more: dict[str, Path], most: int):
        self.job, train = job, job.split.train
        height, width = job.sizes.touch
        self._inputs = np.empty((most * len(more), 3, height, width), np.float16)
        self._rows = []
        end = 0
        for label, key in enumerate(job.observations.keys):
            own, start = train[job.observations.labels[train] == label][:most], end
            for some in np.array_split(own, -(-len(own) // CHUNK)):
                self._inputs[end : end + len(some)] = plain_inputs(job, some)
                end += len(some)
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
            plain = torch.from_numpy(self._inputs[rows[some]]).float()
            yield (
                shift_each(self.job.ground.subtracted(plain), self.job.encode.shift, rng),
                torch.from_numpy(labels[some]),
            )


def plain_inputs(job: Job[RecognizeConfig], rows: np.ndarray) -> np.ndarray:
    """Return encoder inputs of observed touches, nothing subtracted."""
    return encoder_inputs("touch", job.observations.read("touch", rows), job.sizes).half().numpy()


def trained(
    job: Job[RecognizeConfig], learnt: Learnt, each: int, thousands: int, say: Callable[[str], None]
) -> dict[str, float]:
    """Train one net and score it."""
    labels, rounds = job.observations.labels, 1000 * thousands // ROUND
    purpose = ("touch curve", str(each), str(thousands))
    with seeded(job.seed, *purpose):
        net = Classifier({"T": job.make_encoder("touch")}, len(job.observations.keys))

    @torch.no_grad()
    def right(rows: np.ndarray) -> np.ndarray:
        parts = np.array_split(rows, -(-len(rows) // CHUNK))
        answers = [net({"T": job.inputs("touch", some)}).argmax(1).numpy() for some in parts]
        return np.concatenate(answers) == labels[rows]

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
    test = job.split.test
    known, flat = right(test), job.observations.relief(test) < FLAT
    flat |= job.observations.untouched(test)
    return {
        "touches": each,
        "steps": 1000 * thousands,
        "accuracy": float(known.mean()),
        "not_flat": float(known[~flat].mean()),
        "validation": max(point.val_score for point in curve),
        "train_loss": curve[-1].train_loss,
        "seconds": sum(point.seconds for point in curve),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build", type=Path, help="folder KEY/ObjectFile.safetensors")
    parser.add_argument("--out", type=Path, required=True, help="folder of the benchmark, with observations")
    parser.add_argument("--runs", type=int, default=len(RUNS), help="of the list, so many from the start")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    torch.set_num_threads(1)
    console = Console()
    options = BenchmarkOptions(files=[given.build], preset="laptop", out=given.out)
    values, path = options.values()
    params = options.params(TASK, values, path)
    sources = load_object_files(options.files)
    observe = workspace.settings(ObserveConfig, values, path)
    asked = (observe.observations, observe.resolution, params.seed)
    folders = collect_samples("observations", sources, asked, options.folder, 2, track)
    whole = Run(
        **{"task": TASK, "training": recognize, "part": "seen", "inputs": Observations(folders)},
        **{"params": params, "folder": options.folder, "device": "cpu"},
    )
    progress = options.folder.progress("touch_curve", "seen", whole.identity())
    progress.mkdir(parents=True, exist_ok=True)
    job = whole.job(progress, console.print)
    job = job.without_repeats(job.repeats(["touch"]), ["touch"])
    first = len(job.split.train) // len(sources)
    runs = RUNS[: given.runs]
    more = more_touches(sources, job, MOST - first, progress)
    learnt = Learnt(job, more, max(each for each, _ in runs))
    rows: list[dict[str, float]] = []
    for run in runs:
        name = "_".join(map(str, run))
        rows.append(job.compute_once(name, partial(trained, job, learnt, *run, console.print)))
        write_record(given.json, rows)
    table = Table("touches of an object", "steps", "accuracy, %", "not flat, %", "min", title="Touch")
    for row in sorted(rows, key=lambda row: (row["touches"], row["steps"])):
        shares = (f"{100 * row[name]:.1f}" for name in ("accuracy", "not_flat"))
        table.add_row(str(row["touches"]), str(row["steps"]), *shares, f"{row['seconds'] / 60:.0f}")
    console.print(table)


if __name__ == "__main__":
    main()
