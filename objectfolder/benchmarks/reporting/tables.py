"""Tables of scores beside chance, baselines and the paper's figures (Gao et al., CoRL 2021, Tables 2-4)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from objectfolder.benchmarks.reporting import published
from objectfolder.errors import ObjectFolderError

SAME_SENSE = ("V->V", "A->A", "T->T")
#: Rows of grasping, in their order, and the paper's success in %.
GRASP_POLICIES = {
    "touch": ("touch", "-"),
    "touch_exact": ("touch, exact", "-"),
    "tactile": ("tactile images alone", "75.5"),
    "width": ("width alone", "-"),
    "blind": ("blind", "-"),
    "random": ("random actions", "53.0"),
    "nothing": ("none", "-"),
}
HANDS = {"reach": "floating hand", "metaworld_reach": "Meta-World's Sawyer arm"}
REACH_POLICIES = {
    "ppo": "PPO",
    "controller": "straight to the goal",
    "random": "random actions",
    "nothing": "none",
}
#: Rows of grasp stability, in their order.
PREDICTED_FROM = {
    "V": "vision",
    "T": "touch",
    "VT": "vision + touch",
    "T_explicit": "explicit touch",
    "VT_explicit": "vision + explicit touch",
    "T_on_explicit": "touch, tested with explicit",
    "VT_on_explicit": "vision + touch, tested with explicit",
    "majority": "commonest outcome",
    "object_majority": "commonest outcome of the object",
    "geometry": "width, offset",
    "geometry_force": "width, offset, force",
}
SENSES = {"T": "touch", "A": "sound", "TA": "touch + sound"}  #: that contacts are localized by
#: Which test rows a task drops; the others as recognition.
DROPPED = {
    "materials": "repeat an input of their material, and were dropped where nothing else is sensed",
    "reconstruct": "repeat an input of their object, and gave way to later ones where nothing else is sensed",
    "retrieve": "repeat an input of their object, and were dropped if both inputs of a pair do",
    "grasp_stability": "repeat a camera picture of their object, and were dropped",
}
NAMES = {"V": "image", "A": "audio", "VA": "image + audio", "average_shape": "average shape"}
#: Rows of reconstruction below the paper's, and what they are.
KNOWN_SHAPES = {
    "similar_view": "known object with the most similar view",
    "nearest_shape": "known object of the most similar shape",
    "perfect": "truth, sampled again",
}


#: Note of tables of the split unseen.
NEW_OBJECTS = " Intervals cover training seeds, not the choice of the few test objects."


@dataclass(frozen=True)
class Table:
    """Text table.

    Parameters
    ----------
    title : str
    columns : tuple of str
    rows : sequence of tuples of str
    note : str
        Explanation below the table.
    """

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str

    def markdown(self) -> str:
        """Return a Markdown table with its note."""
        lines = [self.columns, ("---",) * len(self.columns), *self.rows]
        return "\n".join([*(f"| {' | '.join(line)} |" for line in lines), "", self.note])


def score_table(task: str, split: str, scores: Mapping[str, Any]) -> Table:
    """Lay out the scores of a task on a split.

    Parameters
    ----------
    task : str
        One of `objectfolder.workspace.params.TASKS`, ``materials`` or ``vision_to_touch``.
    split : str
    scores : mapping
        Contents of the task's result file.

    Raises
    ------
    ObjectFolderError
        If an earlier version wrote it.
    """
    layouts: dict[str, Callable[[str, Mapping[str, Any]], Table]] = {
        "recognize": _recognition,
        "materials": _materials,
        "retrieve": _retrieval,
        "reconstruct": _reconstruction,
        "grasp_stability": _stability,
        "vision_to_touch": _vision_to_touch,
    }
    layout = layouts[task]
    try:
        return layout(split, scores)
    except KeyError as error:
        raise ObjectFolderError(
            f"{task}, split {split}: its result lacks {error}, so it is of an earlier version; run it again"
        ) from error


def reach_table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    """Lay out the scores of `objectfolder.benchmarks.tasks.reach.reach` by object."""
    rows = []
    for key, score in scores.items():
        for policy, name in REACH_POLICIES.items():
            played = score[policy]
            rows.append(
                (
                    key,
                    name,
                    *(_rate(played[when]) for when in ("last", "any")),
                    f"{1000 * played['distance']:.0f}",
                    f"{played['return'] / score['horizon']:.2f}",
                    *((_thousands(score["steps"]), published.REACH) if policy == "ppo" else ("-", "-")),
                )
            )
    first = next(iter(scores.values()))
    return Table(
        f"Reach, {HANDS[first['task']]}: success in %",
        (
            *("object", "policy", "at the last step", "at any time", "mm from the goal at the end"),
            *("reward per step, of 10", "steps of training", "paper"),
        ),
        rows,
        f"{first['episodes']} fresh goals per training, {first['horizon']} control steps each; in brackets "
        f"the 95 % interval (Wilson) of these policies; other trainings may differ.",
    )


def grasping_table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    """Lay out the scores of `objectfolder.benchmarks.tasks.grasp_policy.grasp_policy` by object."""
    rows = []
    for key, score in scores.items():
        for policy, (name, paper) in GRASP_POLICIES.items():
            seeds = " ".join(f"{100 * value:.1f}" for value in score[policy]["seeds"])
            rows.append((key, name, _rate(score[policy]), seeds, paper))
    first = next(iter(scores.values()))
    return Table(
        "Grasping by touch: success in %",
        ("object", "policy", "success", "each seed", "paper"),
        rows,
        f"{first['rollouts']} fresh rollouts per seed, at most {first['episodes']} episodes of training; in "
        "brackets the 95 % interval (Wilson) over all rollouts of these policies; how much trainings differ, "
        "the seeds show. While policies learn, and in row touch, features are those of the nearest of "
        f"{first['presses']} presses; exact: the Object File is asked.",
    )


def _vision_to_touch(split: str, scores: Mapping[str, Any]) -> Table:
    names = {"net": "net", "nearest": "touch of the most similar view", "mean": "mean touch"}
    rows = []
    for kind, name in names.items():
        score = scores[kind]
        figures = (f"{score['psnr_pooled']:.1f}", f"{score['ssim']:.3f}")
        spread = _interval(score, 1, ".1f") if kind == "net" else ""
        rows.append((name, f"{score['psnr']:.1f}" + spread, *figures))
    counts = scores["rows"]
    return Table(
        f"Touch from a close view, {split} objects",
        ("", "PSNR, dB", "PSNR, pooled", "SSIM"),
        rows,
        f"{scores['objects']} objects; {counts['train']:,} contacts to train with, {counts['val']:,} for "
        f"validation, {counts['test']:,} for the test. All presses are 1 mm deep."
        + NEW_OBJECTS
        * (split == "unseen"),
    )


def localization_table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    """Lay out the scores of `objectfolder.benchmarks.tasks.localization.localize` by object."""
    rows: list[tuple[str, ...]] = []
    for senses, name in SENSES.items():
        found = [score[senses] for score in scores.values()]
        for key, one in zip(scores, found):
            net, nearest = one["net"], one["nearest"]
            rows.append(
                (
                    *(name, key),
                    f"{100 * net['mean']:.1f}" + _interval(net, 100, ".1f"),
                    *(f"{100 * value:.1f}" for value in (net["median"], net["together"])),
                    *(f"{100 * nearest[kind]:.1f}" for kind in ("mean", "together")),
                    *(f"{100 * scores[key][kind]:.1f}" for kind in ("constant", "random")),
                )
            )
        if len(found) > 1:
            means = [
                *(_mean(one["net"][kind] for one in found) for kind in ("mean", "median", "together")),
                *(_mean(one["nearest"][kind] for one in found) for kind in ("mean", "together")),
                *(_mean(score[kind] for score in scores.values()) for kind in ("constant", "random")),
            ]
            rows.append((name, f"mean of {len(found)}", *(f"{100 * value:.1f}" for value in means)))
    contacts = next(iter(scores.values()))["contacts"]
    return Table(
        "Localization of contacts: mean error in % of the longest side",
        ("from", "object", "net", "median", "eight", "nearest", "eight nearest", "constant", "random"),
        rows,
        f"{contacts['train']} contacts to train with, {contacts['val']} for validation, "
        f"{contacts['test']} for the test. Eight: after eight contacts with known moves between them. "
        "Nearest: the training contact with the most similar input, for eight a belief by similarity. "
        "Constant: the best single answer.",
    )


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return sum(found) / len(found)


def _thousands(steps: Sequence[int]) -> str:
    return "/".join(f"{count / 1000:.0f}k" for count in steps)


def _rate(share: Mapping[str, Any]) -> str:
    low, high = share["interval_95"]
    return f"{100 * share['rate']:.0f} ({100 * low:.0f}-{100 * high:.0f})"


def _recognition(split: str, scores: Mapping[str, Any]) -> Table:
    rows = _modalities(scores, published.RECOGNITION)
    return Table(
        f"Instance recognition, {scores['objects']} objects: accuracy in %",
        ("modalities", "accuracy", "bound", "each seed", "paper, 100 objects"),
        [*rows, ("chance", f"{100 * scores['chance']['majority']:.1f}", "", "", "1.0")],
        _note(scores) + _touches_note(scores),
    )


def _materials(split: str, scores: Mapping[str, Any]) -> Table:
    rows = _modalities(scores, published.MATERIALS)
    chance = {"commonest material": "majority", "chance": "uniform"}
    rows += [(name, f"{100 * scores['chance'][kind]:.1f}", "", "", "-") for name, kind in chance.items()]
    absent = ", ".join(scores["left_out"])
    return Table(
        f"Classification of {len(scores['materials'])} materials, {scores['objects']} objects, {split}: "
        "accuracy in %",
        ("modalities", "accuracy", "bound", "each seed", "ObjectFolder Benchmark, 1,000 objects"),
        rows,
        _note(scores, "materials")
        + _touches_note(scores)
        + (f" Left out, since no object for training is of it: {absent}." if absent else "")
        + NEW_OBJECTS * (split == "unseen"),
    )


def _modalities(scores: Mapping[str, Any], theirs: Mapping[str, float]) -> list[tuple[str, ...]]:
    """Rows of combinations of modalities, and of several touches together."""
    rows: list[tuple[str, ...]] = []
    for modalities in published.RECOGNITION:
        if modalities in scores:
            figure = f"{theirs[modalities]:.1f}" if modalities in theirs else "-"
            rows.append((modalities, *_seeds(scores[modalities]), figure))
    for kind, name in (("touches", "T"), ("touches_not_flat", "T, not flat")):
        for size, score in sorted(scores.get(kind, {}).items(), key=lambda item: int(item[0])):
            together = name if size == "1" else f"{name}, {size} together"
            if together != "T":  # its row is above, over all rows
                rows.append((together, *_seeds(score), "-"))
    return rows


def _seeds(score: Mapping[str, Any]) -> tuple[str, ...]:
    """Cells of an accuracy, its bound, and the accuracy of each seed."""
    bound = f"{100 * score['bound']:.1f}" if "bound" in score else ""
    return _percent(score), bound, " ".join(f"{100 * value:.1f}" for value in score["seeds"])


def _touches_note(scores: Mapping[str, Any]) -> str:
    if "flat" not in scores:
        return ""
    right = scores.get("flat_accuracy")
    named = "" if right is None else f", of which {100 * right:.0f} % are answered correctly"
    return (
        f" Of the test touches {100 * scores['flat']:.0f} % are on flat ground or miss{named}; "
        "bound: these tell nothing, all others are answered correctly. Together: by the mean log "
        "probability of random test touches of an object; this and not flat as means over objects."
    )


def _retrieval(split: str, scores: Mapping[str, Any]) -> Table:
    rows, new = [], split == "unseen"
    for direction in [*published.RETRIEVAL, *(name for name in SAME_SENSE if name in scores["directions"])]:
        score = scores["directions"][direction]
        paper = published.RETRIEVAL.get(direction)
        papers = ("-", "-") if paper is None else (f"{paper[0]:.2f}", f"{paper[1]:.2f}")
        ours = (_map(score), _map(score["named"]), f"{score['cca']:.3f}", f"{score['chance']:.3f}")
        unseen = published.UNSEEN_RETRIEVAL.get(direction)
        rows.append((direction, *ours, *(("-" if unseen is None else f"{unseen:.3f}",) if new else papers)))
    theirs = ("ObjectFolder Benchmark, 200 objects",) if new else ("paper", "paper's CCA")
    columns = ("direction", "mAP", "mAP by names", "CCA", "chance", *theirs)
    title = f"Cross-sensory retrieval, {split} objects: mean average precision"
    note = _note(scores, "retrieve")
    if new:
        note += " Chance among the 200 objects of the ObjectFolder Benchmark is lower." + NEW_OBJECTS
    return Table(title, columns, rows, note)


def _reconstruction(split: str, scores: Mapping[str, Any]) -> Table:
    rows, counts = [], scores["rows"]
    names = NAMES | KNOWN_SHAPES | {"T": f"{scores['touches']} touches"}
    for kind in [*published.RECONSTRUCTION, *(name for name in KNOWN_SHAPES if name in scores)]:
        score, paper = scores[kind], published.RECONSTRUCTION.get(kind)
        ours = [_figure(score.get(name)) for name in ("iou", "chamfer_l1", "normal_consistency")]
        ours[0] += _interval(score, 1, ".4f") if "interval_95" in score else ""
        papers = " / ".join(f"{value:.4f}" for value in paper) if paper and split == "seen" else "-"
        rows.append((names[kind], *ours, papers))
    return Table(
        f"3D reconstruction, {split} objects",
        ("from", "IoU", "Chamfer-L1", "normal consistency", "paper: IoU / Chamfer-L1 / normal consistency"),
        rows,
        f"{counts['train']} rows to train with; of each object the first {scores['views']} for validation "
        f"and for the test, {counts['val']} and {counts['test']} in all; "
        + _repeats_note(scores, "reconstruct")
        + NEW_OBJECTS * (split == "unseen"),
    )


def _stability(split: str, scores: Mapping[str, Any]) -> Table:
    """Accuracy by number of training grasps; the rest at the largest number."""
    sizes = [scores["sizes"][size] for size in sorted(scores["sizes"], key=int)]
    largest = sizes[-1]
    repeated = len(largest["V"]["seeds"]) > 1
    rows: list[tuple[str, ...]] = []
    for variant, name in PREDICTED_FROM.items():
        if variant in largest:
            cells = [_with_range(found[variant]) for found in sizes]
            best = largest[variant]
            each = " ".join(f"{100 * rate:.1f}" for rate in best["seeds"])
            cells += [_figure(best["balanced_accuracy"], 3), _figure(best["auc"], 3)]
            rows.append((name, *cells, *[each if len(best["seeds"]) > 1 else "-"] * repeated))
    for pair in largest["compared"]:
        first, second = pair.split(" - ")
        differences = [found["compared"][pair] for found in sizes]
        cells = [f"{100 * d['difference']:+z.1f}{_interval(d, 100, '.1f')}" for d in differences]
        by_seed = zip(largest[first]["seeds"], largest[second]["seeds"])
        each = " ".join(f"{100 * (rate - other):+z.1f}" for rate, other in by_seed)
        name = f"{PREDICTED_FROM[first]} − {PREDICTED_FROM[second]}"
        rows.append((name, *cells, "", "", *[each] * repeated))
    heads = [
        f"{count:,}" if count == found["asked"] else f"all {count:,} (of {found['asked']:,})"
        for count, found in zip(sorted(map(int, scores["sizes"])), sizes)
    ]
    return Table(
        f"Grasp stability, {split} objects: accuracy in % by number of training grasps",
        ("from", *heads, "balanced accuracy", "AUC", *["each seed"] * repeated),
        rows,
        f"{_note(scores, 'grasp_stability')} Of the test grasps {100 * scores['success']['test']:.0f} % "
        f"succeed, of those for training {100 * scores['success']['train']:.0f} %. In brackets Wilson's "
        "95 % interval over the test rows; ± of differences: 95 %, paired by row. Balanced accuracy, "
        "AUC and each seed with the most grasps. The paper shows a figure, no numbers.",
    )


def _note(scores: Mapping[str, Any], task: str = "recognize") -> str:
    """Describe the rows of a split."""
    rows = scores["rows"]
    return (
        f"{rows['train']} rows to train with, {rows['val']} for validation, {rows['test']} for the test; "
        + _repeats_note(scores, task)
    )


def _repeats_note(scores: Mapping[str, Any], task: str) -> str:
    counts = scores["duplicates"]
    found = ", ".join(f"{parts['test']} of {name}" for name, parts in counts.items() if parts["test"])
    lost = ", ".join(f"{key} ({name})" for name, keys in scores.get("untested", {}).items() for key in keys)
    rule = DROPPED.get(task, "repeat an input of their object, and were dropped where nothing else is sensed")
    return f"test rows that {rule}: {found or 'none'}." + (f" Without a test row: {lost}." if lost else "")


def _percent(score: Mapping[str, Any]) -> str:
    return f"{100 * score['accuracy']:.1f}" + _interval(score, 100, ".1f")


def _with_range(score: Mapping[str, Any]) -> str:
    low, high = (100 * end for end in score["wilson_95"])
    return f"{100 * score['accuracy']:.1f} ({low:.0f}-{high:.0f})"


def _map(score: Mapping[str, Any]) -> str:
    return f"{score['map']:.3f}" + _interval(score, 1, ".3f")


def _interval(score: Mapping[str, Any], factor: float, digits: str) -> str:
    """Format a half width; empty for a single seed."""
    half = score["interval_95"]
    return "" if half is None else f" ± {factor * half:{digits}}"


def _figure(value: float | None, digits: int = 4) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
