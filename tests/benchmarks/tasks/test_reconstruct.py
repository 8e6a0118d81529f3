import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from encoding import encoding
from made_up import Linear, MadeUp, hum, picture
from PIL import Image
from refusals import refused
from solids import box, sphere
from torch import nn

from objectfolder.base.seeding import seeded
from objectfolder.benchmarks.datasets.occupancy import HALF_SIDE, sample_occupancy
from objectfolder.benchmarks.datasets.splits import Split, per_sample
from objectfolder.benchmarks.models import encoders, shape_model
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.scoring import truth
from objectfolder.benchmarks.scoring.shapes import intersection_over_union
from objectfolder.benchmarks.scoring.truth import Truth, best_level
from objectfolder.benchmarks.tasks import reconstruct_training
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.naming import namer_checkpoint
from objectfolder.benchmarks.tasks.reconstruct import TASK, ReconstructConfig
from objectfolder.benchmarks.tasks.reconstruct_training import mean_scores, reconstruct
from objectfolder.benchmarks.tasks.shape_training import (
    VARIANTS,
    ShapeTraining,
    first_rows,
    read_observed,
    read_variant,
    validation_rows,
)
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sdf import distance_grid
from objectfolder.objectfile.file import ObjectFile

SOLIDS = {
    "ball": sphere(0.45, 3),
    "block": box((1, 0.3, 0.3)),
    "slab": box((0.3, 0.3, 1)),
    "cube": box((0.6, 0.6, 0.6)),
}
COUNT = 20
SURFACES = {key: Isosurface(DistanceGrid(*distance_grid(*solid, 40))) for key, solid in SOLIDS.items()}
PARAMS = ReconstructConfig(
    **{"seeds": 1, "epochs": 8, "batch": 8, "learning_rate": 2e-3, "weight_decay": 1e-4, "patience": 8},
    **{"points": 128, "width": 24, "blocks": 1, "frequencies": 1, "resolution": 12, "score_points": 1500},
    **{"pretrain_epochs": 2, "touches": 4},
)
SIZES = InputSizes(12, (16, 10), (8, 6))
SPLIT = per_sample(tuple(SOLIDS), COUNT)


class Observed(MadeUp):
    """Pictures of one colour and hums of one pitch per object, with a little noise: easy to tell apart."""

    def __init__(self):
        rng, labels = np.random.default_rng(0), np.repeat(np.arange(len(SOLIDS)), COUNT)
        colours = 200 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])[labels]
        arrays = {name: picture(colours, 16, 5, rng) for name in ("vision", "touch")}
        arrays["audio"] = hum(500 * (1 + labels), rng)
        super().__init__(SOLIDS, arrays, object_sha256=[*SOLIDS], scale=[0.1] * len(SOLIDS))

    def object_file(self, key):
        return Path(key)


LABELS = Observed().labels
BALL, BLOCK, SLAB, CUBE = (np.flatnonzero(i == LABELS) for i in range(4))
UNSEEN = Split("unseen", np.concatenate([BALL, SLAB]), BLOCK, CUBE)


def make_job(progress, split=SPLIT, observed=None, **changes):
    observed, params = observed or Observed(), replace(PARAMS, **changes)
    return Job(observed, split, params, encoding("linear", SIZES), seed=0, progress=progress)


@pytest.fixture
def occupancy(monkeypatch):
    """Four solids whose surfaces are known, without Object Files."""
    opened = {key: (lambda surface=surface: surface) for key, surface in SURFACES.items()}
    sampled = sample_occupancy(opened, 3000, 600, PARAMS.score_points, PARAMS.resolution, 0)
    monkeypatch.setattr(truth, "cached_occupancy", lambda *given: sampled)
    monkeypatch.setattr(reconstruct_training, "_surface", lambda path, key: SURFACES[key])
    return sampled


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.slow
@pytest.mark.parametrize("pretrain_epochs", [0, 2])
def test_every_variant_beats_the_average_shape(occupancy, tmp_path, pretrain_epochs):
    epochs = 2 * PARAMS.epochs
    job = make_job(tmp_path, pretrain_epochs=pretrain_epochs, epochs=epochs, patience=epochs)
    seen, curves = reconstruct(job)
    json.dumps(seen, allow_nan=False)
    assert set(seen) == {
        *(*VARIANTS, "average_shape", "similar_view", "perfect", "seconds"),
        *("touches", "views", "objects", "rows", "duplicates", "untested"),
    }
    assert seen["rows"] == {"train": 64, "val": 8, "test": 8}  # two of each object
    for variant in VARIANTS:
        scores = seen[variant]
        assert scores["iou"] > seen["average_shape"]["iou"] + 0.1
        assert seen["perfect"]["chamfer_l1"] < scores["chamfer_l1"] < seen["average_shape"]["chamfer_l1"]
        assert scores["normal_consistency"] < seen["perfect"]["normal_consistency"]
        assert scores["samples"] == 2 * len(SOLIDS)
        assert scores["iou"] == pytest.approx(np.mean(list(scores["per_object"].values())))
        rows = [row for row in curves if row[0] == variant]
        assert {row[1] for row in rows} == {0}
        assert [row[2] for row in rows] == list(range(1, len(rows) + 1))
        assert max(row[4] for row in rows) == scores["val_iou"]
        assert all(len(row) == len(TASK.columns) for row in rows)
    first = {variant: next(row for row in curves if row[0] == variant) for variant in VARIANTS}
    for variant in ("VA", "VT", "AT", "VAT"):
        assert len([row for row in curves if row[0] == variant]) == epochs / 2
        assert first[variant][3] < 0.9 * first[variant[0]][3]  # it starts from what the others learnt
    assert shape_model.load_model(tmp_path / "model.safetensors").setup.modalities == ("vision",)
    with Image.open(tmp_path / "sheet.png") as page:
        assert page.size[0] > page.size[1] / 2 > 200


@pytest.mark.parametrize("variant", ["V", *(pytest.param(name, marks=pytest.mark.slow) for name in "AT")])
def test_encoders_that_name_the_objects_stay_as_they_are(occupancy, tmp_path, variant):
    job = make_job(tmp_path)
    model, curve, before = ShapeTraining(job, occupancy, variant, 0, tmp_path / "last.pt").train([], 0)
    assert before > 0
    assert curve[-1].train_loss < 0.9 * curve[0].train_loss
    (modality,), (encoder,) = VARIANTS[variant], model.net.encoders.values()
    stored = torch.load(namer_checkpoint(job, modality, 0), weights_only=True)["best"]
    plain = encoder.encoder if variant == "T" else encoder
    for name, value in plain.state_dict().items():
        assert torch.equal(value, stored[f"encoders.{modality}.{name}"])


def test_touches_of_a_row_are_of_its_object_and_encoded_as_one_by_one(occupancy, tmp_path):
    job = make_job(tmp_path)
    training = ShapeTraining(job, occupancy, "T", 0, tmp_path / "last.pt")
    rows = SPLIT.val[[0, 7]]
    touches = read_variant(job, ("touch",), rows)["touch"]
    assert touches.shape == (2, PARAMS.touches, 16, 16, 3)
    np.testing.assert_array_equal(touches[:, 0], Observed().read("touch", rows))
    colours = touches.mean((2, 3)).round(-2)
    assert (colours == colours[:, :1]).all()
    net = shape_model.new_net(training.train([], 0)[0].setup)
    encoder, rng = net.eval().encoders["touch"], np.random.default_rng(0)
    few = SPLIT.train[:3]
    one_by_one = training._encode(encoder, "touch", few, rng)
    with torch.no_grad():
        together = encoder(shape_model.shape_inputs("touch", read_observed(job, "touch", few[None]), SIZES))
    torch.testing.assert_close(one_by_one.mean(0, keepdim=True), together)
    whole = training._features(encoder, "touch", rng)
    assert whole[SPLIT.train].any()
    assert not whole[SPLIT.test].any()


def test_what_no_epoch_changes_is_encoded_once(occupancy, tmp_path):
    """Features of sounds and touches, those of A also for VA; of views only the frame."""
    asked, observed = [], Observed()

    class Encoder(nn.Module):
        features = 1

        def forward(self, x):
            asked.append(len(x))
            return x.flatten(1).mean(1, keepdim=True)

    job = make_job(tmp_path, observed=observed)
    rows, encoder, rng = SPLIT.train, Encoder(), np.random.default_rng(0)
    for modality, times in (("audio", 1), ("touch", 1), ("vision", 3)):
        found = []
        for variant in ("VA", "A", "A") if modality == "audio" else [modality[0].upper()] * 3:
            training = ShapeTraining(replace(job, split=SPLIT), occupancy, variant, 0, tmp_path / "none.pt")
            found.append(training._features(encoder, modality, rng))
        assert sum(asked) == times * len(rows)
        assert sum(map(len, observed.reads[modality])) == len(rows)
        assert torch.equal(found[0], found[1]) == torch.equal(found[0], found[2]) == (modality != "vision")
        asked.clear()
    crops = training._views(rows[:3], np.random.default_rng(1))
    raw = Observed().read("vision", rows[:3])
    assert torch.equal(crops, shape_model.shape_inputs("vision", raw, SIZES, np.random.default_rng(1)))
    other = ShapeTraining(job, occupancy, "A", 1, tmp_path / "none.pt")
    other._features(encoder, "audio", rng)  # another seed has other encoders
    assert sum(asked) == len(rows)


def test_scores_over_seeds_are_means_with_an_interval():
    runs = [
        {"iou": iou, "chamfer_l1": chamfer, "per_object": {"ball": iou}}
        for iou, chamfer in ((0.4, 0.1), (0.6, None), (0.8, 0.2))
    ]
    seen = mean_scores(runs)
    assert seen["iou"] == seen["per_object"]["ball"] == pytest.approx(0.6)
    assert seen["chamfer_l1"] is None  # an empty mesh has none
    assert seen["seeds"] == [0.4, 0.6, 0.8]
    assert seen["interval_95"] == pytest.approx(4.303 * 0.2 / 3**0.5, rel=1e-3)  # Student's, two degrees
    assert mean_scores(runs[:1])["interval_95"] is None


def test_selection_is_the_first_rows_of_each_object():
    rows = np.array([3, 5, 7, 21, 40, 41, 42])
    assert first_rows(rows, LABELS, 2).tolist() == [3, 5, 21, 40, 41]


def test_of_objects_without_validation_rows_training_rows_help_to_choose(tmp_path):
    # Not those of an object whose own validation rows are all repeated.
    silent = replace(SPLIT, val=SPLIT.val[LABELS[SPLIT.val] > 0])
    others = np.concatenate([BLOCK[:2], BALL[:2], SLAB[:2]])
    for split, rows in ((SPLIT, SPLIT.val), (silent, silent.val), (UNSEEN, others)):
        assert validation_rows(make_job(tmp_path, split)).tolist() == rows.tolist()


def test_epochs_are_chosen_on_objects_that_are_not_learnt(occupancy, tmp_path):
    """A net that knows the training objects by heart and nothing else has learnt nothing."""
    job = make_job(tmp_path, UNSEEN)
    training = ShapeTraining(job, occupancy, "V", 0, tmp_path / "none.pt")
    labels = LABELS[validation_rows(job)]

    def validated(answers):
        logits = np.where(occupancy.val_inside[answers], 5.0, -5.0)
        model = SimpleNamespace(embed=lambda seen: seen, logits=lambda embedding, points: logits)
        return training._validate(model)[1]

    assert validated(labels) == 1
    by_heart = np.where(labels == 1, 0, labels)  # the block is taken for the ball
    expected = intersection_over_union(occupancy.val_inside[:1], occupancy.val_inside[1:2])[0]
    assert validated(by_heart) == pytest.approx(expected)


@pytest.fixture
def untrained(monkeypatch, tmp_path):
    """Lists which objects' rows each variant is tested with, instead of training it."""
    tested = {}

    def finished(jobs, truth, variant, run):
        rows = reconstruct_training._test(jobs[variant])
        tested[variant] = np.bincount(LABELS[rows], minlength=4).tolist()
        return {"scores": {"iou": 0.5}, "curve": [], "seconds": 0.0}

    (tmp_path / "V_0.safetensors").touch()
    monkeypatch.setattr(reconstruct_training, "_train_once", finished)
    monkeypatch.setattr(reconstruct_training, "_sheet", lambda *_: np.zeros((1, 1, 3), np.uint8))
    return tested


def test_counts_are_of_the_scored_rows_and_a_silent_object_is_lost_to_hearing_alone(
    occupancy, tmp_path, untrained
):
    silent = Observed()
    silent.arrays["audio"][LABELS == 1] = 0
    scores, _ = reconstruct(make_job(tmp_path, observed=silent, views=1))
    assert untrained == dict.fromkeys(VARIANTS, [1] * 4) | {"A": [1, 0, 1, 1]}
    assert scores["rows"] == {"train": 64, "val": 4, "test": 4}
    assert scores["duplicates"]["audio"] == {"val": 1, "test": 1}
    assert scores["untested"] == {"A": ["block"]}
    assert scores["similar_view"]["iou"] == 1  # each object has a colour of its own
    assert scores["similar_view"]["chamfer_l1"] < 2 * scores["perfect"]["chamfer_l1"]
    assert "nearest_shape" not in scores  # the objects themselves are known


def test_unknown_objects_are_compared_with_known_ones(occupancy, tmp_path, untrained):
    scores, _ = reconstruct(make_job(tmp_path, UNSEEN))
    inside = occupancy.score_inside
    to_cube = [(inside[i] & inside[3]).sum() / (inside[i] | inside[3]).sum() for i in (0, 2)]
    assert to_cube[0] != to_cube[1]
    assert scores["nearest_shape"]["iou"] == pytest.approx(max(to_cube))
    # The cube's white is as far from the ball's red as from the slab's blue but for noise: one of the two.
    assert min(to_cube) <= scores["similar_view"]["iou"] <= max(to_cube)
    assert scores["similar_view"]["samples"] == PARAMS.views


def test_average_shape_is_the_mean_of_the_training_objects(occupancy, tmp_path):
    opened = {key: (lambda surface=surface: surface) for key, surface in SURFACES.items()}
    digests = {key: key for key in SOLIDS}
    sides = {key: 0.05 if key == "cube" else 0.2 for key in SOLIDS}
    shapes = Truth(opened, digests, sides, PARAMS.score_points, PARAMS.resolution, 0, tmp_path)

    def labels(*keys):
        return np.array([shapes.keys.index(key) for key in keys])

    # Of one object, tested on it, the average is that object.
    same = shapes.average_shape(*[labels("cube")] * 3)
    assert same["iou"] == 1
    assert same["per_object"] == {"cube": 1}
    # Of two that are tested on a third: where both are, or where either is, as validation prefers.
    block, slab, cube = occupancy.score_inside[labels("block", "slab", "cube")]
    both = shapes.average_shape(labels("block", "slab"), labels("cube"), labels("cube"))
    candidates = [(both_ & cube).sum() / (both_ | cube).sum() for both_ in (block & slab, block | slab)]
    assert both["iou"] == pytest.approx(max(candidates))
    assert both["threshold"] == (0.05 if candidates[1] >= candidates[0] else 0.5)
    # A tenth of 20 cm and three tenths of 5 cm.
    found = shapes._means(np.array([(0.1, 0.9), (0.3, 0.7)]), labels("block", "cube"))
    assert found == pytest.approx({"chamfer_l1": 0.2, "chamfer_cm": 1.75, "normal_consistency": 0.8})
    assert same["chamfer_cm"] == pytest.approx(100 * 0.05 * same["chamfer_l1"])


def test_best_level_by_hand():
    values = np.array([[0.1, 0.4, 0.6, 0.9], [0.2, 0.3, 0.7, 0.8]])
    inside = np.array([[0, 0, 1, 1], [0, 0, 0, 1]], bool)
    assert best_level(values, inside, np.array([0.05, 0.5, 0.75])) == (0.5, 0.75)
    assert best_level(values, inside, np.array([0.35, 0.65, 0.75])) == (0.75, 0.75)
    assert best_level(values, inside, np.array([0.95, 0.99])) == (0.95, 0.0)  # empty answers are no error


def test_model_file_keeps_everything_and_refuses_what_it_is_not(occupancy, tmp_path, brick_path):
    setup = shape_model.Setup(("vision",), "linear", SIZES, 16, 8, 1, 2, 8, tuple(SOLIDS), 0.45)
    with seeded(0, "model"):
        net = shape_model.new_net(setup).eval()
    nn.init.normal_(net.decoder.blocks[0].norm1.beta.weight)  # not 0: the embedding counts
    path = tmp_path / "model.safetensors"
    shape_model.save_model(path, shape_model.ShapeModel(setup, net))
    model = shape_model.load_model(path)
    assert model.setup == setup
    shape_model.save_model(tmp_path / "copy.safetensors", model)
    assert (tmp_path / "copy.safetensors").read_bytes() == path.read_bytes()
    view = Observed().read("vision", np.array([9, 30]))
    embedding = model.embed({"vision": view})
    torch.testing.assert_close(embedding[1:], shape_model.load_model(path).embed({"vision": view[1:]}))
    points = occupancy.score_points
    inside = model.is_inside(embedding, points)
    probability = torch.from_numpy(model.logits(embedding, points)).double().sigmoid().numpy()
    clear = np.abs(probability - model.setup.threshold) > 1e-6
    assert np.array_equal(inside[clear], (probability > model.setup.threshold)[clear])
    level = float(np.median(model.logits(embedding[:1], points)))
    model = replace(model, setup=replace(setup, threshold=1 / (1 + np.exp(-level))))
    vertices, faces = model.mesh(embedding[0])
    assert len(faces) > 20
    inner = (np.abs(vertices) < HALF_SIDE).all(1)  # the rest closes the surface outside
    there = model.logits(embedding[:1], vertices[inner].astype(np.float32))
    assert np.median(np.abs(there - level)) < 0.1 * np.ptp(model.logits(embedding[:1], points))
    refused("no reconstruction model", shape_model.load_model, brick_path)
    refused("does not exist", shape_model.load_model, tmp_path / "none.safetensors")
    broken = replace(model, setup=replace(model.setup, width=25))
    shape_model.save_model(tmp_path / "wrong.safetensors", broken)
    refused("damaged", shape_model.load_model, tmp_path / "wrong.safetensors")


def test_encoders_start_from_given_weights(tmp_path):
    weights = encoders.Weights(tmp_path, Linear(3).state_dict())
    ones = {name: torch.ones_like(value) for name, value in weights.items()}
    net = shape_model.new_net(
        shape_model.Setup(("vision",), "linear", SIZES, 16, 8, 1, 0, 8, ("ball",)),
        encoders.Weights(tmp_path, ones),
    )
    assert all((value == 1).all() for value in net.encoders["vision"].state_dict().values())


def test_an_object_file_of_another_object_is_named(brick_path):
    vertices = reconstruct_training._surface(brick_path, "brick").vertices
    assert np.array_equal(vertices, ObjectFile.load(brick_path).surface.vertices)
    refused(f"{brick_path} holds brick, expected mug", reconstruct_training._surface, brick_path, "mug")
