"""Train the nets of `objectfolder.benchmarks.tasks.reconstruct_training`.

Either the encoders first learn to name objects, alone, and fusion and decoder are then trained on their
features; or all is trained together, as in the paper. The first takes a fraction of the time: encoders do
without points, and the points of a step do without encoders.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import islice
from pathlib import Path
from typing import cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.datasets.occupancy import OccupancySamples
from objectfolder.benchmarks.datasets.splits import Companions
from objectfolder.benchmarks.models.framing import frame_views
from objectfolder.benchmarks.models.inputs import encoder_inputs, flip_some
from objectfolder.benchmarks.models.occupancy_net import Reconstructor, SeveralTouches
from objectfolder.benchmarks.models.shape_model import Setup, ShapeModel, new_net, shape_inputs
from objectfolder.benchmarks.models.training import STATISTICS, EpochPoint, Objective, count_batches, shuffle
from objectfolder.benchmarks.scoring.shapes import intersection_over_union
from objectfolder.benchmarks.scoring.truth import THRESHOLDS, best_level
from objectfolder.benchmarks.tasks.job import Job, in_chunks
from objectfolder.benchmarks.tasks.naming import train_namer
from objectfolder.benchmarks.tasks.reconstruct import ReconstructConfig

#: Inputs of each variant. Those of several start from the nets of one each, which come first.
VARIANTS: dict[str, tuple[str, ...]] = {
    "V": ("vision",),
    "A": ("audio",),
    "T": ("touch",),
    "VA": ("vision", "audio"),
    "VT": ("vision", "touch"),
    "AT": ("audio", "touch"),
    "VAT": ("vision", "audio", "touch"),
}
#: Steps per encoded batch, each on other points; all but the first train fusion and decoder only. Encoders
#: take most of the time, while shapes need many more steps than features. A row of several touches is so
#: much to encode that an epoch takes fewer rows, with more steps each.
POINT_SETS, TOUCH_POINT_SETS = 4, 16
#: Features, points, whether they are inside.
FeatureBatch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
#: Inputs of the encoders, or None for those of the batch before; numbers of the objects; points;
#: whether they are inside.
InputBatch = tuple[dict[str, torch.Tensor] | None, torch.Tensor, torch.Tensor, torch.Tensor]
Points = tuple[torch.Tensor, torch.Tensor]  #: points, whether they are inside


class ShapeTraining:
    """The training of one of the `VARIANTS` with one seed, from 0."""

    def __init__(
        self,
        job: Job[ReconstructConfig],
        occupancy: OccupancySamples,
        variant: str,
        run: int,
        checkpoint: Path,
    ):
        self.job, self.occupancy, self.checkpoint = job, occupancy, checkpoint
        self.modalities = VARIANTS[variant]
        self.title = f"reconstruct {job.split.name}, {variant}, seed {run + 1} of {job.params.seeds}"
        self._purpose = ("reconstruct", job.split.name, variant, str(run))
        self._run, self._labels = run, job.observations.labels
        self._classes = np.unique(self._labels[job.split.train])

    def train(self, parts: Sequence[ShapeModel], best: int) -> tuple[ShapeModel, list[EpochPoint], float]:
        """Train the net, or resume from its checkpoint.

        A net of several modalities starts from models of one each, ``parts``, as the ``best`` of them, and
        trains half as many epochs. Returns the model with the threshold that is best on the validation rows,
        the training curve, and the seconds of training the encoder before.
        """
        job, params = self.job, self.job.params
        setup = Setup(
            *(self.modalities, job.encoder, job.sizes, job.observations.shape("vision")[0]),
            *(params.width, params.blocks, params.frequencies, params.resolution),
            tuple(job.observations.keys[label] for label in self._classes),
        )
        with seeded(job.seed, *self._purpose):
            net = new_net(setup, job.weights)
            naming = nn.Linear(net.fusion.get_parameter("0.weight").shape[1], len(self._classes))
        if job.encode.subtract and "touch" in self.modalities:
            cast(SeveralTouches, net.encoders["touch"]).set_ground(job.ground)
        model, before, epochs = ShapeModel(setup, net), 0.0, params.epochs
        if parts:
            start_from(net, [part.net for part in parts], parts[best].net)
            epochs = -(-epochs // 2)
        elif params.pretrain_epochs:
            before = self._learn_to_name(net)
        if params.pretrain_epochs:
            curve = self._train_on_features(model, epochs)
        else:
            curve = self._train_together(model, naming, epochs)
        threshold = round(float(torch.tensor(self._validate(model)[0]).sigmoid()), 4)
        return ShapeModel(replace(setup, threshold=threshold), net), curve, before

    def _learn_to_name(self, net: Reconstructor) -> float:
        """Train the only encoder of a net to name the training objects; return the seconds taken."""
        job, params, (modality,) = self.job, self.job.params, self.modalities

        def inputs(rows: np.ndarray, rng: np.random.Generator | None) -> torch.Tensor:
            if modality != "vision":
                return job.inputs(modality, rows, rng)
            views = self._views(rows, rng)
            return flip_some(views, rng) if job.encode.flip and rng is not None else views

        rate = params.pretrain_rate / params.learning_rate
        namer, curve = train_namer(
            job, "reconstruct", modality, self._run, inputs, params.pretrain_epochs, one_cycle=True, rate=rate
        )
        encoder = net.encoders[modality]
        plain = encoder.encoder if isinstance(encoder, SeveralTouches) else encoder
        plain.load_state_dict(namer.encoders[modality].state_dict())
        return sum(point.seconds for point in curve)

    def _train_on_features(self, model: ShapeModel, epochs: int) -> list[EpochPoint]:
        """Train fusion and decoder on features of encoders that stay as they are."""
        job, params, net, rows = self.job, self.job.params, model.net, self.job.split.train
        companions = Companions(job.split, self._labels)
        net.to(job.device).eval()

        @lru_cache(maxsize=1)  # statistics are renewed on the same features
        def encoded(epoch: int) -> dict[str, torch.Tensor]:
            rng = numpy_generator(job.seed, *self._purpose, f"features of epoch {epoch}")
            return {name: self._features(net.encoders[name], name, rng) for name in self.modalities}

        def epoch_batches(epoch: int) -> Iterator[FeatureBatch]:
            known = encoded(epoch)
            rng = numpy_generator(job.seed, *self._purpose, f"epoch {epoch}")
            for _ in range(POINT_SETS):
                for some in shuffle(rows, params.batch, rng):
                    drawn = companions.draw(some, params.touches, rng) if "touch" in known else some[:, None]
                    found = [known[name][drawn if name == "touch" else some[:, None]] for name in known]
                    features = torch.cat([values.mean(1) for values in found], 1)
                    yield features, *self._points(some, rng)

        def batch_loss(batch: FeatureBatch) -> torch.Tensor:
            features, points, inside = batch
            logits = net.decoder(points, net.fusion(features))
            return F.binary_cross_entropy_with_logits(logits, inside.float())

        parts = nn.ModuleDict({"fusion": net.fusion, "decoder": net.decoder})
        return job.train(
            self.title,
            Objective(parts, epoch_batches, batch_loss, lambda: self._validate(model)[1], "IoU"),
            self.checkpoint,
            epochs,
            cycle=epochs * POINT_SETS * count_batches(len(rows), params.batch),
        )

    def _features(self, encoder: nn.Module, modality: str, rng: np.random.Generator) -> torch.Tensor:
        """Encode the training rows, one touch each; (N, features), in the other rows 0."""
        job, rows, size = self.job, self.job.split.train, cast(int, encoder.features)

        def make(some: np.ndarray) -> torch.Tensor:
            return self._encode(encoder, modality, some, rng)

        values = torch.zeros(len(self._labels), size, device=job.device)
        if modality == "vision":  # cropped differently in each epoch
            values[rows] = make(rows)
        else:  # they serve all variants with this modality
            kept = job.once(f"{modality} features of seed {self._run}", rows, (size,), make)
            values[rows] = kept.to(job.device)
        return values

    @torch.no_grad()
    def _encode(
        self, encoder: nn.Module, modality: str, rows: np.ndarray, rng: np.random.Generator
    ) -> torch.Tensor:
        """Encode rows, one touch each; (n, features)."""
        several = rows[:, None] if modality == "touch" else rows
        return in_chunks(lambda some: encoder(self._inputs(modality, some, rng)), several)

    def _train_together(self, model: ShapeModel, naming: nn.Linear, epochs: int) -> list[EpochPoint]:
        """Train encoders, fusion and decoder together, and to name the objects from their features."""
        job, params, net = self.job, self.job.params, model.net
        companions = Companions(job.split, self._labels)
        sets = TOUCH_POINT_SETS if "touch" in self.modalities else POINT_SETS

        def epoch_batches(epoch: int) -> Iterator[InputBatch]:
            rng = numpy_generator(job.seed, *self._purpose, f"epoch {epoch}")
            batches = shuffle(job.split.train, params.batch, rng)
            for rows in islice(batches, None, None, sets // POINT_SETS):
                inputs = {}
                for name in self.modalities:
                    seen = companions.draw(rows, params.touches, rng) if name == "touch" else rows
                    inputs[name] = self._inputs(name, seen, rng)
                names = torch.from_numpy(np.searchsorted(self._classes, self._labels[rows])).to(job.device)
                for given in (inputs, *[None] * (sets - 1)):
                    yield given, names, *self._points(rows, rng)

        encoded: list[torch.Tensor] = []

        def batch_loss(batch: InputBatch) -> torch.Tensor:
            inputs, names, points, inside = batch
            if inputs is None:
                (features,) = encoded
            else:
                features = net.features(inputs)
                encoded[:] = [features.detach()]
            logits = net.decoder(points, net.fusion(features))
            loss = F.binary_cross_entropy_with_logits(logits, inside.float())
            return loss if inputs is None else loss + params.naming * F.cross_entropy(naming(features), names)

        parts = nn.ModuleDict({"net": net, "naming": naming})
        return job.train(
            self.title,
            Objective(parts, epoch_batches, batch_loss, lambda: self._validate(model)[1], "IoU"),
            self.checkpoint,
            epochs,
            statistics=STATISTICS * sets,  # of which one in so many is encoded
        )

    def _inputs(self, modality: str, rows: np.ndarray, rng: np.random.Generator) -> torch.Tensor:
        """Return the inputs of training: of rows (B,), or of touches (B, K)."""
        job = self.job
        if modality == "audio":
            return job.inputs(modality, rows)
        if modality == "vision":
            return self._views(rows, rng)
        return shape_inputs(modality, read_observed(job, modality, rows), job.sizes, rng, job.device)

    def _views(self, rows: np.ndarray, rng: np.random.Generator | None) -> torch.Tensor:
        """Return `shape_inputs` of views, each framed once."""
        job = self.job

        def make(some: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(frame_views(job.observations.read("vision", some)))

        views = job.once("framed views", rows, job.observations.shape("vision"), make, torch.uint8)
        return encoder_inputs("vision", views.numpy(), job.sizes, rng, job.device)

    def _points(self, rows: np.ndarray, rng: np.random.Generator) -> Points:
        points, inside = self.occupancy.draw(self._labels[rows], self.job.params.points, rng)
        return torch.from_numpy(points).to(self.job.device), torch.from_numpy(inside).to(self.job.device)

    def _validate(self, model: ShapeModel) -> tuple[float, float]:
        """Return the level that is best on `validation_rows`, and its IoU on those not learnt from."""
        rows = validation_rows(self.job)
        logits = model.logits(model.embed(self._validation), self.occupancy.val_points)
        inside = self.occupancy.val_inside[self._labels[rows]]
        level = best_level(logits, inside, np.log(THRESHOLDS / (1 - THRESHOLDS)))[0]
        apart = np.isin(rows, self.job.split.val)
        return level, float(intersection_over_union(logits[apart] > level, inside[apart]).mean())

    @cached_property
    def _validation(self) -> dict[str, np.ndarray]:
        return read_variant(self.job, self.modalities, validation_rows(self.job))


def first_rows(rows: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """Return the first ``count`` rows of each object, in order; ``labels`` are those of all observations."""
    chosen = [rows[labels[rows] == label][:count] for label in np.unique(labels[rows])]
    return np.concatenate(chosen)


def validation_rows(job: Job[ReconstructConfig]) -> np.ndarray:
    """Return the rows to choose the threshold on; of validation objects alone with training rows.

    A threshold that is best for the few validation objects of the split ``unseen`` may leave all other
    predictions empty. Epochs are chosen on the validation rows alone.
    """
    labels, split = job.observations.labels, job.split
    apart = not np.isin(labels[split.val], labels[split.train]).any()
    parts = [split.val, split.train] if apart else [split.val]
    return np.concatenate([first_rows(rows, labels, job.params.views) for rows in parts])


def read_observed(job: Job[ReconstructConfig], modality: str, rows: np.ndarray) -> np.ndarray:
    """Read the observations of rows of any shape."""
    flat = job.observations.read(modality, rows.ravel())
    return flat.reshape(*rows.shape, *job.observations.shape(modality))


def read_variant(
    job: Job[ReconstructConfig], modalities: Sequence[str], rows: np.ndarray
) -> dict[str, np.ndarray]:
    """Read what a variant is validated or scored on; of touches several of each row's object."""
    rng = numpy_generator(job.seed, "reconstruct", job.split.name, "seen")
    touched = Companions(job.split, job.observations.labels).draw(rows, job.params.touches, rng)
    return {name: read_observed(job, name, touched if name == "touch" else rows) for name in modalities}


def start_from(net: Reconstructor, parts: Sequence[Reconstructor], best: Reconstructor) -> None:
    """Copy the encoders of nets of one modality each; the net initially predicts as the best of them."""
    for part in parts:
        for modality, encoder in part.encoders.items():
            net.encoders[modality].load_state_dict(encoder.state_dict())
    net.decoder.load_state_dict(best.decoder.state_dict())
    fusion = best.fusion.state_dict()
    widths = [part.fusion.get_parameter("0.weight").shape[1] for part in parts]
    own = fusion["0.weight"]
    columns = [own if part is best else own.new_zeros(len(own), w) for part, w in zip(parts, widths)]
    fusion["0.weight"] = torch.cat(columns, 1)
    net.fusion.load_state_dict(fusion)
