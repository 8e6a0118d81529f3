"""Imagine a touch from a close view (visuo-tactile generation of the ObjectFolder Benchmark, CVPR 2023)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch.nn import functional as F

from objectfolder.base.arrays import write_png
from objectfolder.base.figures import tile
from objectfolder.base.io import keep
from objectfolder.base.metrics import psnr, ssim
from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.models.training import EpochPoint, Objective, count_batches, shuffle
from objectfolder.benchmarks.models.translator import Translator
from objectfolder.benchmarks.scoring.scores import over_seeds
from objectfolder.benchmarks.tasks.job import CHUNK, Job, in_chunks
from objectfolder.benchmarks.tasks.vision_to_touch import TranslationConfig, VisionToTouchConfig

ROUNDING = 1 / 12 / 255**2  #: mean squared error of rounding to grey levels; 59 dB
POOLED = (10, 8)  #: size of the pictures by which the nearest is sought
SHOWN = 16  #: test rows in the picture

Batch = tuple[torch.Tensor, torch.Tensor]  #: pictures given and asked for, both in [0, 1] and (B, 3, H, W)


@dataclass(frozen=True)
class Translation:
    """Which picture of a contact is given, and which is asked for."""

    name: str  #: of the task
    source: str
    target: str


def vision_to_touch(job: Job[VisionToTouchConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score a net that draws the tactile image of what a close view shows; see `translate`."""
    job, counts = job.without_duplicates(("view",))
    return translate(job, Translation("vision_to_touch", "view", "touch"), counts)


def translate(
    job: Job[Any], way: Translation, counts: dict[str, Any]
) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score a net that draws one picture of a contact from the other.

    The net learns the mean squared difference. The best epoch is chosen by the pooled PSNR of the validation
    rows.

    Returns ``net``, ``nearest`` (the answer of the training row whose given picture is most similar, of
    `POOLED` pixels) and ``mean`` (the mean answer of the training rows): ``psnr`` of the mean squared error
    of each image, at least `ROUNDING`, averaged over images, dB; ``psnr_pooled`` of that of all; ``ssim``. Of
    the net also the ``seeds`` of the first and its ``interval_95``. Then the counts of
    `Job.without_duplicates`, and ``seconds``.
    """
    test = job.split.test
    truth = job.observations.read(way.target, test)
    finished = [_train_once(job, way, run) for run in range(job.params.seeds)]
    runs = [unit["scores"] for unit in finished]
    net = {name: float(np.mean([run[name] for run in runs])) for name in runs[0]}
    blank = np.broadcast_to(_mean(job, way), truth.shape)
    answers = job.observations.read(way.target, _nearest(job, way))
    scores = {
        "net": net | over_seeds("psnr", [run["psnr"] for run in runs]),
        "nearest": score_answers(answers, truth),
        "mean": score_answers(blank, truth),
        **counts,
        "seconds": sum(unit["seconds"] for unit in finished),
    }
    curve = [[run, *row] for run, unit in enumerate(finished) for row in unit["curve"]]
    return scores, curve


def score_answers(answers: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Score images (N, H, W, 3) uint8 by the truth."""
    a, b = answers.astype(np.float32) / 255, truth.astype(np.float32) / 255
    errors = ((a - b) ** 2).mean((1, 2, 3), dtype=np.float64)
    return {
        "psnr": float(np.mean(psnr(np.maximum(errors, ROUNDING)))),
        "psnr_pooled": float(psnr(errors.mean())),
        "ssim": float(np.mean([ssim(one, other) for one, other in zip(a, b, strict=True)])),
    }


def _mean(job: Job[Any], way: Translation) -> np.ndarray:
    """Return the mean answer of the training rows, (H, W, 3) uint8."""
    parts = np.array_split(job.split.train, -(-len(job.split.train) // CHUNK))
    total = sum(job.observations.read(way.target, part).sum(0, dtype=np.int64) for part in parts)
    return np.round(total / len(job.split.train)).astype(np.uint8)


def _nearest(job: Job[Any], way: Translation) -> np.ndarray:
    """Return the training row whose given picture is most similar, for each test row."""

    def pooled(rows: np.ndarray) -> np.ndarray:
        small = in_chunks(lambda some: F.adaptive_avg_pool2d(_tensor(job, way.source, some), POOLED), rows)
        return small.flatten(1).cpu().numpy()

    return job.split.train[cKDTree(pooled(job.split.train)).query(pooled(job.split.test))[1]]


def _train_once(job: Job[Any], way: Translation, run: int) -> dict[str, Any]:
    """Return the scores of one net, trained unless finished earlier."""
    checkpoint, sheet = job.progress / f"{run}.pt", job.progress / "0.png"

    def score(net: Translator) -> dict[str, Any]:
        answers = _answers(job, way, net, _blank(job, way), job.split.test)
        truth = job.observations.read(way.target, job.split.test)
        if run == 0:
            write_png(sheet, _sheet(job, way, answers, truth))
        return {"scores": score_answers(answers, truth)}

    result = job.train_once(str(run), lambda: _train(job, way, run, checkpoint), score, [checkpoint])
    if run == 0:
        keep(sheet, job.progress / "sheet.png")  # moved to the results at each call
    return result


def _train(
    job: Job[Any], way: Translation, run: int, checkpoint: Path
) -> tuple[Translator, list[EpochPoint]]:
    params: TranslationConfig = job.params
    train, val = job.split.train, job.split.val
    purpose = (way.name, job.split.name, str(run))
    with seeded(job.seed, *purpose):
        net = Translator(params.width)
    blank = _blank(job, way)

    def epoch_batches(epoch: int) -> Iterator[Batch]:
        rng = numpy_generator(job.seed, *purpose, f"epoch {epoch}")
        for rows in shuffle(train, params.batch, rng):
            yield _tensor(job, way.source, rows), _tensor(job, way.target, rows)

    def batch_loss(batch: Batch) -> torch.Tensor:
        given, asked = batch
        return F.mse_loss(blank + net(given).float(), asked)

    truth = job.observations.read(way.target, val)

    def val_score() -> float:
        return score_answers(_answers(job, way, net, blank, val), truth)["psnr_pooled"]

    curve = job.train(
        f"{way.name.replace('_', ' ')} {job.split.name}, seed {run + 1} of {params.seeds}",
        Objective(net, epoch_batches, batch_loss, val_score, "PSNR"),
        checkpoint,
        cycle=params.epochs * count_batches(len(train), params.batch),
    )
    return net, curve


@torch.no_grad()
def _answers(
    job: Job[Any], way: Translation, net: Translator, blank: torch.Tensor, rows: np.ndarray
) -> np.ndarray:
    """Return the pictures that a net draws, (N, H, W, 3) uint8."""

    def draw(some: np.ndarray) -> torch.Tensor:
        return ((blank + net(_tensor(job, way.source, some))).clamp(0, 1) * 255).round().byte()

    return in_chunks(draw, rows).permute(0, 2, 3, 1).cpu().numpy()


def _blank(job: Job[Any], way: Translation) -> torch.Tensor:
    """Return the mean answer as (3, H, W) in [0, 1]."""
    return torch.from_numpy(_mean(job, way)).permute(2, 0, 1).float().to(job.device) / 255


def _tensor(job: Job[Any], name: str, rows: np.ndarray) -> torch.Tensor:
    """Return images of rows as (B, 3, H, W) in [0, 1]."""
    images = torch.from_numpy(job.observations.read(name, rows)).to(job.device)
    return images.permute(0, 3, 1, 2).float() / 255


def _sheet(job: Job[Any], way: Translation, answers: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Draw some test rows as columns: the picture given, the net's answer, the true one."""
    rows = np.unique(np.linspace(0, len(truth) - 1, SHOWN).round().astype(int))
    given = job.observations.read(way.source, job.split.test[rows])
    return tile(np.concatenate([given, answers[rows], truth[rows]]), len(rows))
