"""Slide a sensor to a contact by touch, sight or both (ObjectFolder Benchmark, CVPR 2023).

A net learns from pairs of contacts near each other how the sensor has to move from one reading to the other.
The learned policy moves by what it says of the present reading and the goal's, at most by a step.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import permutations
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from objectfolder.base.arrays import read_npz, write_npz, write_png
from objectfolder.base.figures import tile
from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.datasets.samples import Samples, object_digest
from objectfolder.benchmarks.datasets.splits import Split
from objectfolder.benchmarks.models.displacement import DisplacementNet, compared
from objectfolder.benchmarks.models.training import EpochPoint, Objective, count_batches, shuffle
from objectfolder.benchmarks.scoring.scores import over_seeds
from objectfolder.benchmarks.tasks.job import Job, ObjectJob, in_chunks
from objectfolder.benchmarks.tasks.slide import SENSES, SlideConfig
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import sliding
from objectfolder.sim.sliding import SLIDES, Poses, Slide

CHANNELS = {"T": slice(0, 3), "V": slice(3, 6), "TV": slice(0, 6)}  #: of the pictures of contacts
CLUSTER = 8  #: contacts near each other, of which each two are a pair
TENTH = 10  #: every tenth cluster is for validation
SHARE = 0.5  #: of the greatest step, that the pixel descent first moves by
SHOWN = 7  #: poses of an episode in the figure

Batch = tuple[torch.Tensor, torch.Tensor]  #: what was compared, and motions in steps


@dataclass(frozen=True)
class _Way:
    """What all policies of a way share. Pictures are (N, H, W, 3 or 6) uint8: touch, then the close view."""

    file: ObjectFile
    slide: Slide
    pictures: np.ndarray  #: of contacts to learn from
    pairs: np.ndarray  #: (P, 2) contacts of a cluster
    motions: np.ndarray  #: (P, 3) float32 from the first to the second, in greatest steps
    starts: Poses
    goals: Poses
    aims: np.ndarray  #: pictures of the goals
    senses: tuple[str, ...]

    @classmethod
    def of(cls, job: ObjectJob[SlideConfig], slide: Slide, senses: tuple[str, ...]) -> "_Way":
        assert job.encode is not None
        file, count, size = job.file, job.params.contacts, job.encode.touch
        rng = numpy_generator(job.seed, "slide", file.key, slide.name)
        centres = sliding.random_poses(file, count // CLUSTER, rng)
        around = [sliding.strayed(file, slide, centres, rng, near=True) for _ in range(CLUSTER - 1)]
        parts = ([getattr(one, name) for one in (centres, *around)] for name in ("points", "normals", "up"))
        contacts = Poses(*(np.stack(part, 1).reshape(-1, 3) for part in parts))
        first = np.arange(0, count, CLUSTER)[:, None]
        pairs = np.concatenate([first + pair for pair in permutations(range(CLUSTER), 2)])
        motions = sliding.offsets(contacts.take(pairs[:, 0]), contacts.take(pairs[:, 1])) / slide.steps
        goals = sliding.random_poses(file, job.params.episodes, rng)
        return cls(
            *(file, slide, sliding.observe(file, contacts, senses, size), pairs, motions.astype(np.float32)),
            *(sliding.strayed(file, slide, goals, rng), goals),
            *(sliding.observe(file, goals, senses, size), senses),
        )

    def sense(self, letters: str, poses: Poses) -> np.ndarray:
        """Return the pictures of poses by some senses."""
        names = [name for name, letter in zip(sliding.SENSES, "TV", strict=True) if letter in letters]
        return sliding.observe(self.file, poses, names, self.aims.shape[1:3])

    def scores(self, policy: sliding.Policy) -> tuple[dict[str, float], list[Poses]]:
        """Run the episodes; return the scores and the poses by step."""
        last, reached, poses = sliding.follow_policy(self.file, self.slide, self.starts, self.goals, policy)
        left = sliding.errors(last, self.goals).mean(0)
        found = {"success": reached.mean(), "distance": left[0], "degrees": np.degrees(left[1])}
        return {name: float(value) for name, value in found.items()}, poses


def slide_object(job: ObjectJob[SlideConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train and score policies that slide a sensor over an object.

    Returns scores: by way (``refine``, ``traverse``) and policy, the ``success`` as a share of the episodes,
    and the mean ``distance`` (m) and angle (``degrees``) left at the end. ``net`` and ``descent`` are by the
    letters of `objectfolder.benchmarks.tasks.slide.SENSES`; the net's success has ``interval_95`` and
    ``seeds``. ``still``: nothing moves; ``random``: motions of up to a step; ``oracle``: it knows where the
    goal is. Also ``contacts``, ``episodes``, ``steps``, and ``seconds``.

    Raises ObjectFolderError if the object cannot be felt wherever a sensor slides.
    """
    sliding.require_sliding(job.file, ())
    senses = sliding.SENSES if "vision" in job.file.header else ("touch",)
    runs = {slide.name: _run_way(job, _Way.of(job, slide, senses)) for slide in SLIDES.values()}
    figure = [read_npz(job.progress / f"{name}.npz", "strips")["strips"] for name in runs]
    write_png(job.progress / "sheet.png", tile(np.concatenate(figure), SHOWN + 1))
    given = {"contacts": job.params.contacts, "episodes": job.params.episodes, "steps": sliding.STEPS}
    scores = {name: found for name, (found, _, _) in runs.items()}
    curve = [row for _, rows, _ in runs.values() for row in rows]
    return scores | given | {"seconds": sum(seconds for _, _, seconds in runs.values())}, curve


def _run_way(job: ObjectJob[SlideConfig], way: _Way) -> tuple[dict[str, Any], list[list[Any]], float]:
    """Return the scores of all policies, the training curves and the seconds."""
    assert job.encode is not None
    name, count = way.slide.name, len(way.pictures)
    samples = Samples({way.file.key: {"count": count, "object": object_digest(way.file)}}, {})
    validated = way.pairs[:, 0] // CLUSTER % TENTH == TENTH - 1
    split = Split(name, np.flatnonzero(~validated), np.flatnonzero(validated), np.arange(0))
    given = job.params, job.encode, job.seed, job.progress, job.weights, job.device, job.report
    trained: Job[SlideConfig] = Job(samples, split, *given)
    used = [*SENSES] if "vision" in way.senses else ["T"]
    finished = {
        (run, letters): _train_once(trained, way, run, letters)
        for run in range(job.params.seeds)
        for letters in used
    }
    scores: dict[str, Any] = {"net": {}, "descent": {}}
    for letters in used:
        runs = [finished[run, letters]["scores"] for run in range(job.params.seeds)]
        mean = {kind: float(np.mean([one[kind] for one in runs])) for kind in runs[0]}
        scores["net"][letters] = mean | over_seeds("success", [one["success"] for one in runs])
        descent = trained.compute_once(f"{name}_descent_{letters}", partial(_descend, way, letters))
        scores["descent"][letters] = descent
    rng = numpy_generator(job.seed, "slide", way.file.key, name, "random")
    simple: dict[str, sliding.Policy] = {
        "still": lambda step, rows, poses: np.zeros((len(rows), 3)),
        "random": lambda step, rows, poses: rng.uniform(-1, 1, (len(rows), 3)) * way.slide.steps,
        "oracle": lambda step, rows, poses: sliding.offsets(poses, way.goals.take(rows)),
    }
    scores |= {policy: way.scores(choose)[0] for policy, choose in simple.items()}
    curve = [[run, name, letters, *row] for (run, letters), unit in finished.items() for row in unit["curve"]]
    return scores, curve, sum(unit["seconds"] for unit in finished.values())


def _train_once(job: Job[SlideConfig], way: _Way, run: int, letters: str) -> dict[str, Any]:
    """Return the scores of one net, trained unless finished earlier; some episodes are kept as pictures."""
    name = f"{way.slide.name}_{run}_{letters}"
    checkpoint = job.progress / f"{name}.pt"

    def score(net: DisplacementNet) -> dict[str, Any]:
        scores, poses = way.scores(_learned(job, way, net, letters))
        if run == 0 and letters[0] == "T":  # of touch and close view, if it is seen
            write_npz(job.progress / f"{way.slide.name}.npz", strips=_strips(way, poses))
        return {"scores": scores}

    return job.train_once(name, lambda: _train(job, way, run, letters, checkpoint), score, [checkpoint])


def _tensor(job: Job[SlideConfig], way: _Way, letters: str, pictures: np.ndarray) -> torch.Tensor:
    """Return pictures (B, C, H, W) of some senses, without what all contacts have in common."""
    channels = CHANNELS[letters]
    mean = torch.from_numpy(way.pictures[..., channels].mean(0, dtype=np.float32)).to(job.device)
    spread = torch.from_numpy(_deviations(way, channels)).to(job.device)
    return ((torch.from_numpy(pictures).to(job.device).float() - mean) / spread).permute(0, 3, 1, 2)


def _deviations(way: _Way, channels: slice) -> np.ndarray:
    """Return the root mean squares of the differences from the mean picture, (C,); 1 where there are none."""
    some = way.pictures[:: -(-len(way.pictures) // 400), ..., channels].astype(np.float32)
    found = np.sqrt(((some - some.mean(0)) ** 2).mean((0, 1, 2)))
    return np.where(found > 0, found, 1).astype(np.float32)


def _train(
    job: Job[SlideConfig], way: _Way, run: int, letters: str, checkpoint: Any
) -> tuple[DisplacementNet, list[EpochPoint]]:
    params, purpose = job.params, ("slide", way.file.key, way.slide.name, str(run), letters)
    pictures = _tensor(job, way, letters, way.pictures[..., CHANNELS[letters]])
    motions = torch.from_numpy(way.motions).to(job.device)

    def compare(rows: np.ndarray) -> torch.Tensor:
        first, second = way.pairs[rows].T
        return compared(pictures[first], pictures[second])

    inputs = in_chunks(compare, np.arange(len(way.pairs)))
    with seeded(job.seed, *purpose):
        net = DisplacementNet(inputs.shape[1])

    def epoch_batches(epoch: int) -> Iterator[Batch]:
        rng = numpy_generator(job.seed, *purpose, f"epoch {epoch}")
        with seeded(job.seed, *purpose, f"epoch {epoch}"):  # of what is dropped
            for rows in shuffle(job.split.train, params.batch, rng):
                yield inputs[rows], motions[rows]

    def batch_loss(batch: Batch) -> torch.Tensor:
        given, asked = batch
        return F.smooth_l1_loss(net(given).float(), asked)

    def val_score() -> float:
        return -float((net(inputs[job.split.val]).float() - motions[job.split.val]).abs().mean())

    curve = job.train(
        f"{way.slide.name} by {SENSES[letters]}, seed {run + 1} of {params.seeds}",
        Objective(net, epoch_batches, batch_loss, val_score, "minus error"),
        checkpoint,
        cycle=params.epochs * count_batches(len(job.split.train), params.batch),
    )
    return net, curve


def _learned(job: Job[SlideConfig], way: _Way, net: DisplacementNet, letters: str) -> sliding.Policy:
    """Move by what a net says of the present reading and the goal's."""
    aims = _tensor(job, way, letters, way.aims[..., CHANNELS[letters]])

    @torch.no_grad()
    def choose(step: int, rows: np.ndarray, poses: Poses) -> np.ndarray:
        present = _tensor(job, way, letters, way.sense(letters, poses))
        return net(compared(present, aims[rows])).double().cpu().numpy() * way.slide.steps

    return choose


def _descend(way: _Way, letters: str) -> dict[str, float]:
    """Score pixel descent: along an axis while the reading becomes more like the goal's, else the next.

    Once no axis helps, motions are halved.
    """
    axes = 3 if np.isfinite(way.slide.turned) else 2
    tried = SHARE * np.concatenate([np.eye(3)[:axes], -np.eye(3)[:axes]]) * way.slide.steps
    count, aims = len(way.aims), way.aims[..., CHANNELS[letters]].astype(np.float32)
    which, failed = np.zeros(count, int), np.zeros(count, int)
    best, last = np.full(count, np.inf), np.zeros((count, 3))

    def choose(step: int, rows: np.ndarray, poses: Poses) -> np.ndarray:
        difference = abs(way.sense(letters, poses) - aims[rows]).mean((1, 2, 3))
        worse = difference >= best[rows]
        which[rows] = (which[rows] + worse) % len(tried)
        failed[rows] = np.where(worse, failed[rows] + 1, failed[rows] // len(tried) * len(tried))
        new = tried[which[rows]] * 0.5 ** (failed[rows] // len(tried))[:, None]
        motions = new - np.where(worse[:, None], last[rows], 0)
        best[rows], last[rows] = np.minimum(best[rows], difference), new
        return motions

    return way.scores(choose)[0]


def _strips(way: _Way, poses: Sequence[Poses]) -> np.ndarray:
    """Draw an episode that reached its goal and one that did not, by step; (N, H, W, 3) uint8.

    Rows are touches and close views; the last column is the goal's.
    """
    reached, strips = sliding.is_reached(way.slide, poses[-1], way.goals), []
    for episodes in (np.flatnonzero(reached), np.flatnonzero(~reached)):
        if len(episodes):
            number = episodes[:1]
            steps = np.linspace(0, len(poses) - 1, SHOWN).round().astype(int)
            shown = [way.sense("TV" if "vision" in way.senses else "T", poses[k].take(number)) for k in steps]
            episode = np.concatenate([*shown, way.aims[number]])
            strips += [episode[..., k : k + 3] for k in range(0, episode.shape[3], 3)]
    return np.concatenate(strips)
