"""Input of a task, with the steps that all tasks share: reading, training, and caching finished parts."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
import torch
from torch import nn
from torch.nn.functional import adaptive_avg_pool2d

from objectfolder.base.io import read_json, write_json
from objectfolder.benchmarks.datasets.samples import Samples
from objectfolder.benchmarks.datasets.splits import Split, repeated_rows, without_rows
from objectfolder.benchmarks.models.encoders import Weights, make_encoder, registered
from objectfolder.benchmarks.models.inputs import Ground, encoder_inputs, flip_some, shift_each
from objectfolder.benchmarks.models.settings import EncodeConfig, InputSizes, TrainingConfig
from objectfolder.benchmarks.models.touch_frame import Mirrored, gel_inputs, mirror_each, own_shapes
from objectfolder.benchmarks.models.training import STATISTICS, EpochPoint, Objective, TrainSettings, train
from objectfolder.workspace.layout import SPLITS

if TYPE_CHECKING:
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.sim.body import RigidBody
    from objectfolder.touch.inverse import PhotometricInverse

CHUNK = 64  #: rows encoded at once
GROUND = 1000  #: training touches at most to find their `Ground` of
KEPT_BYTES = 2**31  #: of all that is kept of rows, such as spectrograms: they take longer than the encoder

Report = Callable[[str], None]
_Config = TypeVar("_Config")
_Params = TypeVar("_Params", bound=TrainingConfig)
_Batch = TypeVar("_Batch")
_Net = TypeVar("_Net")


class RowCache:
    """Tensors of rows that are the same in all epochs, each computed once; the shape is of all together."""

    def __init__(self, shape: tuple[int, ...], dtype: torch.dtype):
        self._values, self._known = torch.empty(shape, dtype=dtype), np.zeros(shape[0], bool)
        self.bytes = self._values.nbytes

    def of(self, rows: np.ndarray, make: Callable[[np.ndarray], torch.Tensor]) -> torch.Tensor:
        """Return the tensors of rows; ``make`` computes those that are missing."""
        missing = np.unique(rows[~self._known[rows]])
        if len(missing):
            self._values[missing] = make(missing).cpu()
            self._known[missing] = True
        return self._values[rows]


@dataclass(frozen=True)
class ObjectJob(Generic[_Config]):
    """Train and score with one object; ``report`` gets a line about each part."""

    task: str  #: name of the task
    file: "ObjectFile"
    body: "RigidBody | None"  #: of the same object, for a robot
    params: _Config  #: the task's section of ``params.yaml``
    seed: int
    progress: Path  #: see `Job`
    report: Report = lambda line: None
    threads: int = 1  #: of a simulation; results do not depend on it
    encode: EncodeConfig | None = None  #: of a task that trains nets
    weights: Weights | None = None
    device: str | torch.device = "cpu"


@dataclass(frozen=True)
class Job(Generic[_Params]):
    """Train and score a task's nets on one split of observations; ``report`` gets a line about each epoch."""

    observations: Samples
    split: Split
    params: _Params  #: the task's section of ``params.yaml``
    encode: EncodeConfig
    seed: int
    #: Folder of checkpoints, finished parts and files to keep. An interrupted call resumes from it, so it
    #: must be empty or of a call with the same arguments.
    progress: Path
    weights: Weights | None = None  #: initial weights of encoders; default: random
    device: str | torch.device = "cpu"
    report: Report = lambda line: None
    #: Given one, touches are in their own frame; see `objectfolder.benchmarks.tasks.touch_shapes`.
    inverse: "PhotometricInverse | None" = None
    #: By name, shared by jobs on parts of the split; see `once`.
    row_caches: dict[str, RowCache] = field(default_factory=dict, compare=False, repr=False)

    @property
    def sizes(self) -> InputSizes:
        """Sizes of encoder inputs."""
        return self.encode.sizes

    @cached_property
    def encoder(self) -> str:
        """Registered name of the encoder, whose own file is run for it."""
        return registered(self.encode.encoder)

    def repeats(self, modalities: Iterable[str], answers: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return which rows repeat an input with the same answer, by modality; see `repeated_rows`."""
        return {name: repeated_rows(self.split, self.observations, name, answers) for name in modalities}

    def without_repeats(self, repeats: Mapping[str, np.ndarray], *together: Sequence[str]) -> "Job[_Params]":
        """Drop the validation and test rows all of whose inputs repeat, given the answer of `repeats`.

        Each set in ``together`` is of modalities that a net receives together; one that repeats as a whole
        suffices.
        """
        dropped = np.any([np.all([repeats[name] for name in some], 0) for some in together], 0)
        return replace(self, split=without_rows(self.split, dropped))

    def counts(self, repeats: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Count ``objects``, ``rows`` in each part of the split, and by modality ``duplicates``.

        These are rows of each part that repeat an input with the same answer.
        """
        split = self.split
        return {
            "objects": len(self.observations.keys),
            "rows": {part: len(getattr(split, part)) for part in SPLITS},
            "duplicates": {
                name: {part: int(found[getattr(split, part)].sum()) for part in ("val", "test")}
                for name, found in repeats.items()
            },
        }

    def untested(self, used: "Job[_Params]") -> list[str]:
        """Return the test objects that have no test row in another job."""
        labels = self.observations.labels
        lost = np.setdiff1d(labels[self.split.test], labels[used.split.test])
        return [self.observations.keys[label] for label in lost]

    def without_duplicates(self, *together: Sequence[str]) -> tuple["Job[_Params]", dict[str, Any]]:
        """Drop validation and test rows that repeat inputs of their object; see `without_repeats`.

        Also returns `counts`, with the ``rows`` that are left, and ``untested``, the objects without a test
        row: under ``all``, if there are any.
        """
        repeats = self.repeats(dict.fromkeys(name for some in together for name in some))
        used = self.without_repeats(repeats, *together)
        lost = self.untested(used)
        counts = self.counts(repeats) | {"rows": used.counts({})["rows"]}
        return used, counts | {"untested": {"all": lost} if lost else {}}

    def check_sizes(self, modalities: Iterable[str]) -> None:
        """Raise ObjectFolderError if observations are smaller than what encoders expect of them."""
        for name in modalities:
            encoder_inputs(name, self.observations.read(name, self.split.train[:1]), self.sizes)

    def make_encoder(self, modality: str) -> nn.Module:
        """Make an untrained encoder; call within `objectfolder.base.seeding.seeded`."""
        encoder = make_encoder(self.encoder, modality, self.weights)
        return Mirrored(encoder) if modality == "touch" and self.inverse else encoder

    def inputs(self, modality: str, rows: np.ndarray, rng: np.random.Generator | None = None) -> torch.Tensor:
        """Return the encoder inputs of rows; see `objectfolder.benchmarks.models.inputs.encoder_inputs`.

        With a generator they are those of training: views cropped and flipped, touches moved and, in their
        own frame, mirrored, at random.
        """
        if modality == "audio":
            return self._spectra(rows).to(self.device)
        if modality == "touch" and self.inverse:
            shapes = gel_inputs(self._gel_shapes(rows, self.inverse).float()).to(self.device)
            inputs = shapes if rng is None else mirror_each(shapes, rng)
        else:
            raw = self.observations.read(modality, rows)
            inputs = encoder_inputs(modality, raw, self.sizes, rng, self.device)
        if modality == "vision" and self.encode.flip and rng is not None:
            inputs = flip_some(inputs, rng)
        if modality == "touch" and self.encode.subtract and not self.inverse:
            inputs = self.ground.subtracted(inputs)
        if modality == "touch" and self.encode.shift and rng is not None:
            inputs = shift_each(inputs, self.encode.shift, rng)
        return inputs

    def pooled(self, modality: str, rows: np.ndarray, size: tuple[int, int]) -> torch.Tensor:
        """Return the encoder inputs of rows averaged to a size, to compare them; (n, D)."""
        return in_chunks(lambda some: adaptive_avg_pool2d(self.inputs(modality, some), size).flatten(1), rows)

    def _spectra(self, rows: np.ndarray) -> torch.Tensor:
        def make(some: np.ndarray) -> torch.Tensor:
            return encoder_inputs("audio", self.observations.read("audio", some), self.sizes)

        return self.once("audio", rows, (1, *self.sizes.spectrogram), make)

    def _gel_shapes(self, rows: np.ndarray, inverse: "PhotometricInverse") -> torch.Tensor:
        """Return the gel of touches in their own frame, (n, h, w) float16, mm."""

        def make(some: np.ndarray) -> torch.Tensor:
            return own_shapes(self.observations.read("touch", some), inverse).half()

        def in_parts(some: np.ndarray) -> torch.Tensor:
            return in_chunks(make, some)

        return self.once("gel", rows, self.sizes.touch, in_parts, torch.float16)

    def once(
        self,
        name: str,
        rows: np.ndarray,
        shape: tuple[int, ...],
        make: Callable[[np.ndarray], torch.Tensor],
        dtype: torch.dtype = torch.float32,
    ) -> torch.Tensor:
        """Return what is the same in all epochs, each row computed once, unless all are too large to keep.

        The ``name`` is of what is kept, the ``shape`` of one row; ``make`` computes it for one row or more.
        The (n, ...) tensor is on the CPU if it is kept.
        """
        if name not in self.row_caches:
            whole = (len(self.observations.labels), *shape)
            size, held = dtype.itemsize * np.prod(whole), sum(kept.bytes for kept in self.row_caches.values())
            if size > KEPT_BYTES // 2 or size + held > KEPT_BYTES:  # none leaves no room for the others
                return make(rows)
            self.row_caches[name] = RowCache(whole, dtype)
        return self.row_caches[name].of(rows, make)

    @cached_property
    def ground(self) -> Ground:
        """What touches have in common, from training rows alone."""
        train = self.split.train
        rows = train[:: -(-len(train) // GROUND)]
        raw = self.observations.read("touch", rows)
        return Ground.of(encoder_inputs("touch", raw, self.sizes, device=self.device))

    def train(
        self,
        title: str,
        objective: Objective[_Batch],
        checkpoint: Path,
        epochs: int | None = None,
        rate: float = 1.0,
        cycle: int | None = None,
        statistics: int = STATISTICS,
    ) -> list[EpochPoint]:
        """Train a net with the task's settings, and report each epoch under a title.

        Default ``epochs`` are those of the settings; ``rate`` is a factor of the learning rate. For the rest
        see `objectfolder.benchmarks.models.training.train`.
        """
        params = self.params
        settings = TrainSettings(
            epochs=epochs or params.epochs,
            learning_rate=params.learning_rate * rate,
            weight_decay=params.weight_decay,
            patience=params.patience,
            cycle=cycle,
            precision=self.encode.precision,
            statistics=statistics,
        )

        def report(point: EpochPoint) -> None:
            self.report(
                f"{title}, epoch {point.epoch} of {settings.epochs}: training loss {point.train_loss:.3f}, "
                f"validation {objective.score} {point.val_score:.3f}, {point.seconds:.0f} s"
            )

        return train(objective, settings, checkpoint, self.device, report)

    def compute_once(self, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return the result of a part of the job; computed once and kept in the progress folder."""
        path = self.progress / f"{name}.json"
        if not path.is_file():
            write_json(path, make())
        result: dict[str, Any] = read_json(path)
        return result

    def train_once(
        self,
        name: str,
        make: Callable[[], tuple[_Net, list[EpochPoint]]],
        score: Callable[[_Net], dict[str, Any]],
        spent: Iterable[Path] = (),
    ) -> dict[str, Any]:
        """Return what ``score`` says of a trained net, its ``curve`` and ``seconds``; see `compute_once`.

        Files that are ``spent``, such as its checkpoint, are removed when that is kept.
        """

        def trained() -> dict[str, Any]:
            net, curve = make()
            start = time.perf_counter()
            scores = score(net)
            seconds = sum(point.seconds for point in curve) + time.perf_counter() - start
            return {**scores, "curve": [astuple(point)[:3] for point in curve], "seconds": seconds}

        result = self.compute_once(name, trained)
        for path in spent:
            path.unlink(missing_ok=True)
        return result


def in_chunks(make: Callable[[np.ndarray], torch.Tensor], rows: np.ndarray) -> torch.Tensor:
    """Join the tensors that ``make`` returns for at most `CHUNK` of the rows at a time."""
    return torch.cat([make(some) for some in np.array_split(rows, -(-len(rows) // CHUNK))])
