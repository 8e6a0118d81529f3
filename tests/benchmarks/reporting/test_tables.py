import pytest

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.run import list_tasks

ROWS = {
    "rows": {"train": 16, "val": 2, "test": 2},
    "duplicates": {"vision": {"val": 0, "test": 0}, "touch": {"val": 1, "test": 3}},
    "objects": 2,
}


def rate(accuracy, half=None, seeds=None, **more):
    """What recognition says of one combination."""
    return {"accuracy": accuracy, "interval_95": half, "seeds": seeds or [accuracy], **more}


def score_table(task, split, scores):
    (shown,) = list_tasks()[task].tables({split: scores})
    return shown


def cells(shown):
    return {row[0]: row[1:] for row in shown.rows}


def test_recognition_in_percent_with_its_interval_beside_chance_and_the_paper():
    scores = {
        **{"V": rate(0.75, 0.125, [0.5, 1.0]), "VAT": rate(1.0)},
        "chance": {"uniform": 0.5, "majority": 0.625},
        **ROWS,
        "objects": 100,
    }
    shown = score_table("recognize", "seen", scores)
    assert cells(shown) == {
        "V": ("75.0 ± 12.5", "", "50.0 100.0", "94.8"),
        "VAT": ("100.0", "", "100.0", "99.8"),
        "chance": ("62.5", "", "", "1.0"),
    }
    assert "16 rows to train with, 2 for validation, 2 for the test" in shown.note
    source = "of 500 observations of each sense a tenth for the test (Gao et al., CoRL 2021, Table 2)."
    assert shown.note.endswith(source)
    assert "dropped where nothing else is sensed: 3 of touch. From the paper: accuracy" in shown.note
    lost = scores | {"untested": {"A": ["die", "mug"], "VA": ["die"]}}
    assert "row: die (A), mug (A), die (VA)." in score_table("recognize", "seen", lost).note
    few = score_table("recognize", "seen", scores | {"objects": 2})
    assert few.columns == ("modalities", "accuracy", "bound", "each seed")
    assert "The paper has V 94.8, A 98.3" in few.note
    assert "not comparable with 2 test objects here: accuracy in %, 100 objects" in few.note
    head, rule, first, *_ = shown.markdown().splitlines()
    assert head == "| modalities | accuracy | bound | each seed | paper |"
    assert rule == "| --- | --- | --- | --- | --- |"
    assert first.startswith("| V | 75.0 ± 12.5 |")


def test_several_touches_stand_below_the_modalities_with_their_bound():
    scores = {
        **{"T": rate(0.5, bound=0.625), "V": rate(0.5), "flat": 0.25, "flat_accuracy": 0.5},
        # In the order of a sorted JSON file.
        "touches": {"1": rate(0.5, bound=0.75), "16": rate(0.75, bound=1), "4": rate(0.625, bound=0.875)},
        "touches_not_flat": {"1": rate(0.75, bound=1.0)},
        "chance": {"uniform": 0.5, "majority": 0.625},
        **ROWS,
        "objects": 100,
    }
    shown = score_table("recognize", "seen", scores)
    assert [(row[0], *row[1:3], row[-1]) for row in shown.rows] == [
        ("V", "50.0", "", "94.8"),
        ("T", "50.0", "62.5", "72.4"),
        ("T, 4 together", "62.5", "87.5", "-"),
        ("T, 16 together", "75.0", "100.0", "-"),
        ("T, not flat", "75.0", "100.0", "-"),
        ("chance", "62.5", "", "1.0"),
    ]
    assert "Of the test touches 25 % are on flat ground or miss, of which 50 % are answered" in shown.note


def test_materials_stand_beside_the_commonest_and_the_published():
    scores = {
        **dict.fromkeys(("V", "VA", "VAT"), rate(0.5)),
        **{"materials": ["wood", "steel", "gold"], "left_out": ["gold"]},
        "chance": {"uniform": 0.25, "majority": 0.625},
        **ROWS,
        "objects": 1000,
    }
    shown = score_table("materials", "unseen", scores)
    assert shown.title.startswith("Classification of 3 materials, 1000 objects, unseen")
    assert cells(shown) == {
        "V": ("50.0", "", "50.0", "92.25"),
        "VA": ("50.0", "", "50.0", "-"),
        "VAT": ("50.0", "", "50.0", "96.60"),
        "commonest material": ("62.5", "", "", "-"),
        "chance": ("25.0", "", "", "-"),
    }
    assert "622 of the 1,000 are of wood" in shown.note
    seen = score_table("materials", "seen", scores)  # the benchmark has no figures of seen objects
    assert cells(seen)["V"] == ("50.0", "", "50.0")
    assert "Benchmark" not in seen.note
    assert "Left out, since no object for training is of it: gold. Intervals cover training" in shown.note


def test_published_figures_of_retrieval_stand_beside_their_split():
    names = ("V->A", "V->T", "A->V", "A->T", "T->V", "T->A", "V->V")
    score = {"map": 0.5, "interval_95": None, "seeds": [0.5], "cca": 0.25, "chance": 0.125}
    score["named"] = {"map": 0.75, "interval_95": None}
    scores = {"directions": dict.fromkeys(names, score), **ROWS}
    ours = ("0.500", "0.750", "0.250", "0.125")
    tables = [
        score_table("retrieve", split, scores | {"objects": objects})
        for split, objects in (("seen", 100), ("unseen", 1000), ("unseen", 100))
    ]
    seen, unseen, fewer = map(cells, tables)
    assert seen["A->T"] == (*ours, "0.55", "0.31")
    assert (unseen["A->T"], fewer["A->T"]) == ((*ours, "0.070"), ours)
    assert (seen["V->V"], unseen["V->V"]) == ((*ours, "-", "-"), (*ours, "0.893"))
    assert "A->A" not in seen
    assert "README.md at 9e40fde of 2024-07-26)" in tables[1].note
    assert "not comparable with 10 test objects here" in tables[2].note


def test_reconstruction_beside_the_average_shape():
    score = {"iou": 0.5, "chamfer_l1": 0.02, "chamfer_cm": 0.25, "normal_consistency": 0.75}
    counts = {"views": 1, "touches": 4}
    scores = dict.fromkeys(("V", "A", "T", "VA", "VT", "AT", "VAT", "average_shape"), score) | ROWS | counts
    scores |= {"objects": 100}
    shown = score_table("reconstruct", "seen", scores)
    assert list(cells(shown)) == [
        *("average shape", "image", "audio", "4 touches", "image + audio", "image + 4 touches"),
        *("audio + 4 touches", "image + audio + 4 touches"),
    ]
    assert cells(shown)["audio"] == ("0.5000", "0.0200", "0.25", "0.7500", "0.8729", "0.0048", "0.9504")
    used = "16 rows to train with; of each object the first 1 for validation and for the test, 2 and 2 in all"
    assert shown.note.startswith(used)
    known = {"similar_view": score, "perfect": {"chamfer_l1": 0.01, "normal_consistency": 0.99}}
    shown = score_table("reconstruct", "unseen", scores | known)
    assert cells(shown)["known object with the most similar view"] == ("0.5000", "0.0200", "0.25", "0.7500")
    assert cells(shown)["truth, sampled again"] == ("-", "0.0100", "-", "0.9900")
    with pytest.raises(ObjectFolderError, match="lacks 'views', so it is of an earlier version"):
        score_table("reconstruct", "seen", {name: x for name, x in scores.items() if name != "views"})


def held(rate, low, high, *seeds):
    """What grasp stability says of one variant."""
    interval = {"accuracy": rate, "wilson_95": [low, high]}
    return interval | {"balanced_accuracy": 0.5, "auc": None, "seeds": seeds or (rate,)}


def test_grasp_stability_by_number_of_grasps():
    few = {"V": held(0.5, 0.25, 0.75), "VT": held(0.625, 0.4, 0.8), "majority": held(0.5, 0.25, 0.75)}
    many = {"V": held(0.75, 0.5, 0.875), "VT": held(1.0, 0.875, 1.0), "majority": held(0.5, 0.25, 0.75)}
    few["compared"] = {"VT - V": {"difference": -0.125, "interval_95": None}}
    many["compared"] = {"VT - V": {"difference": 0.25, "interval_95": 0.1}}
    sizes = {"1600": {"asked": 10000, **many}, "200": {"asked": 200, **few}}
    scores = {"sizes": sizes, "success": {"train": 0.5, "val": 0.5, "test": 0.25}, **ROWS}
    shown = score_table("grasp_stability", "unseen", scores)
    assert shown.columns == ("from", "200", "all 1,600 (of 10,000)", "balanced accuracy", "AUC")
    assert cells(shown) == {
        "vision": ("50.0 (25-75)", "75.0 (50-88)", "0.500", "-"),
        "vision + touch": ("62.5 (40-80)", "100.0 (88-100)", "0.500", "-"),
        "commonest outcome": ("50.0 (25-75)", "50.0 (25-75)", "0.500", "-"),
        "vision + touch − vision": ("-12.5", "+25.0 ± 10.0", "", ""),
    }
    assert "Of the test grasps 25 % succeed, of those for training 50 %" in shown.note
    assert "unseen objects" in shown.title


def test_grasp_stability_shows_each_of_several_seeds():
    found = {
        "asked": 100,
        "V": held(0.5, 0.25, 0.75, 0.25, 0.75),
        "VT": held(0.75, 0.5, 0.875, 0.75, 0.75),
        "majority": held(0.5, 0.25, 0.75),
        "compared": {"VT - V": {"difference": 0.25, "interval_95": 0.1}},
    }
    success = {"train": 0.5, "test": 0.25}
    shown = score_table("grasp_stability", "seen", {"sizes": {"100": found}, "success": success, **ROWS})
    assert shown.columns[-1] == "each seed"
    assert {name: row[-1] for name, row in cells(shown).items()} == {
        "vision": "25.0 75.0",
        "vision + touch": "75.0 75.0",
        "commonest outcome": "-",
        "vision + touch − vision": "+50.0 +0.0",
    }
