"""A listening study: which of two sounds is more real? The paper's user study (supplementary D)."""

import csv
import hashlib
import itertools
import json
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.checks import whole_number
from objectfolder.base.errors import ObjectFolderError, plural, quoted, shortened
from objectfolder.base.text import from_csv, in_script
from objectfolder.report.pictures import flac_uri
from objectfolder.sound.recordings import loudest_channel, open_sound, read_channels, resample_sound
from objectfolder.viewer.page import fill_page, static_text

PAIRS = 16  #: of the paper's study
SUFFIXES = (".wav", ".flac", ".ogg")
WINDOW = 0.4  # seconds, of the loudest part, as of a momentary loudness (ITU-R BS.1771)
PEAK = 0.9  # of full scale, of the loudest sound of a study
LONGEST = 10.0  # seconds
PLAYED = 48000  # Hz; sounds of higher rates are brought to it, since FLAC does not hold every one of them
MOST = 1_000_000  # Hz, of a sound that is brought to it
TRIAL = "trial"  #: column that files of the page have; not needed
REPAIR = "leave it out, or save the answers from the page again"
COLUMNS = ("study", "listener", "pair", "material", "first", "second", "chosen", "ours")


@dataclass(frozen=True)
class Preference:
    """How often one method was preferred."""

    chosen: int
    answers: int

    @property
    def share(self) -> float:
        """Share of the answers."""
        return self.chosen / self.answers

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's score interval of 95 % (1927)."""
        from scipy.stats import binomtest  # slow to import

        found = binomtest(self.chosen, self.answers).proportion_ci(method="wilson")
        return float(found.low), float(found.high)


@dataclass(frozen=True)
class Scores:
    """What the listeners of a study preferred."""

    method: str  #: whose preference is counted: that of the first folder of `study_page`
    materials: dict[str, Preference]  #: by material
    total: Preference
    listeners: int


def study_page(ours: Path, other: Path, pairs: int = PAIRS, seed: int = 0) -> str:
    """Return the page of a study, which works from disk.

    Sounds of the same name in both folders are a pair: WAV, FLAC or OGG files, named MATERIAL_anything; the
    folders' names are the methods'. Of each, the first 10 s of the loudest channel are played. Both are
    brought to the same level: the root mean square of their loudest 0.4 s. If there are more pairs than asked
    for, materials are drawn evenly, with the seed, which also orders the pairs for listeners.

    Raises ObjectFolderError if a number is wrong, the folders hold too few pairs, or a file cannot be read,
    is silent or is not finite.
    """
    pairs, seed = whole_number("pairs", pairs, 1), whole_number("seed", seed)
    if ours.resolve().name == other.resolve().name:
        raise ObjectFolderError(f"{ours} and {other} have the same name, which names the method; rename one")
    first, second = (_sound_files(folder) for folder in (ours, other))
    names = sorted(first.keys() & second.keys())
    if len(names) < pairs:
        few = f"{ours} and {other} have {len(names)} sounds of the same name, expected {pairs}"
        raise ObjectFolderError(f"{few}; add some, or ask for fewer with --pairs")
    chosen = _drawn(names, pairs, seed)
    sounds = [tuple(_levelled(files[name]) for files in (first, second)) for name in chosen]
    peak = max(np.abs(sound).max() for pair in sounds for sound, _ in pair)
    study: dict[str, Any] = {
        "seed": seed,
        "methods": [ours.resolve().name, other.resolve().name],
        "pairs": [
            {
                "name": name,
                "material": material_of(name),
                "sounds": [flac_uri(sound * PEAK / peak, rate) for sound, rate in pair],
            }
            for name, pair in zip(chosen, sounds)
        ],
    }
    study["id"] = hashlib.sha256(json.dumps(study).encode()).hexdigest()[:12]
    content = {"title": "Which sounds more real?", "study": in_script(study)}
    return fill_page("listening.html", content | {"script": static_text("listening.js")})


def material_of(name: str) -> str:
    """Return the material that the name of a sound begins with."""
    return name.partition("_")[0]


def preferences(paths: list[Path], page: Path | None = None) -> Scores:
    """Count answers that listeners saved in CSV files of one study; one that is in several counts once.

    If the page of the study is given, answers must be of its pairs and methods. Raises ObjectFolderError if a
    file or page is none, an answer contradicts itself, another answer or the page, the files are of different
    studies, or there are no answers.
    """
    study = None if page is None else _study_of(page)
    rows: dict[tuple[str, str], dict[str, str]] = {}
    places: dict[tuple[str, str], Path] = {}
    trials: dict[tuple[str, str], str] = {}  # pairs, by listener and trial
    studies: dict[str, Path] = {}
    model: dict[str, str] = {}  # the first answer
    for path in paths:
        for number, row in _answers(path):
            listener, pair, trial = row["listener"], row["pair"], row.get(TRIAL)
            studies.setdefault(row["study"], path)
            if len(studies) > 1:
                raise ObjectFolderError(f"{', '.join(map(str, studies.values()))} are of different studies")
            model = model or row
            problem = _contradiction(row, model, study)
            if trial is not None and not problem and trials.setdefault((listener, trial), pair) != pair:
                other = trials[listener, trial]
                problem = f"trial {trial} of listener {quoted(listener)} was pair {quoted(other)}"
            if problem:
                raise ObjectFolderError(f"{path}: line {number}: {problem}; {REPAIR}")
            answer, key = {name: row[name] for name in COLUMNS}, (listener, pair)
            place = places.setdefault(key, path)
            if rows.setdefault(key, answer) != answer:
                twice = f"listener {shortened(listener)} answers pair {shortened(pair)} in two ways"
                advice = "leave one file out, or rename a listener"
                raise ObjectFolderError(f"{place} and {path}: {twice}; {advice}")
    if not rows:
        raise ObjectFolderError(f"{', '.join(map(str, paths))}: no answers")
    counts: dict[str, list[bool]] = defaultdict(list)
    for row in rows.values():
        counts[row["material"]].append(row["chosen"] == row["ours"])
    found = {name: Preference(sum(won), len(won)) for name, won in sorted(counts.items())}
    total = Preference(sum(one.chosen for one in found.values()), len(rows))
    return Scores(model["ours"], found, total, len({listener for listener, _ in rows}))


def _answers(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the answers of a CSV file and the numbers of their lines."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            head = reader.fieldnames or ()
            if wrong := [name for name in COLUMNS if head.count(name) != 1]:
                columns = f"answers of a study have the columns {', '.join(COLUMNS)}"
                found = f"{path}: line 1 is {quoted(list(head))}, expected one column {wrong[0]!r}"
                raise ObjectFolderError(f"{found}: {columns}")
            for row in reader:
                if row.get(None) or None in row.values():
                    problem = f"does not have {len(head)} cells, as the first line"
                    raise ObjectFolderError(f"{path}: line {reader.line_num} {problem}; {REPAIR}")
                yield reader.line_num, {name: from_csv(cell) for name, cell in row.items()}
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ObjectFolderError(f"{path} cannot be read as CSV ({shortened(error, 200)})") from error


def _contradiction(row: dict[str, str], model: dict[str, str], study: dict[str, Any] | None) -> str | None:
    """Return what is wrong with an answer beside another of its study, and its study, if anything is."""
    sides = row["first"], row["second"]
    for name in ("study", "listener", "pair", "first", "second"):
        if not row[name].strip():
            return f"{name} is empty"
    if sides[0] == sides[1]:
        return f"first and second are both {quoted(sides[0])}, expected two methods"
    for name in ("chosen", "ours"):
        if row[name] not in sides:
            return f"{name} is {quoted(row[name])}, expected {quoted(sides[0])} or {quoted(sides[1])}"
    if row["material"] != (expected := material_of(row["pair"])):
        return f"material is {quoted(row['material'])}, expected {quoted(expected)} of {quoted(row['pair'])}"
    trial = row.get(TRIAL)
    if trial is not None and not re.fullmatch("[1-9][0-9]{0,8}", trial):
        return f"trial is {quoted(trial)}, expected a whole number of at least 1"
    methods = [model["ours"], *({model["first"], model["second"]} - {model["ours"]})]
    if study is not None:
        methods, pairs = study["methods"], [pair["name"] for pair in study["pairs"]]
        if row["study"] != study["id"]:
            return f"study is {quoted(row['study'])}, but that of the page is {study['id']!r}"
        if row["pair"] not in pairs:
            return f"pair is {quoted(row['pair'])}, expected one of {quoted(pairs)}"
        if trial is not None and int(trial) > len(pairs):
            return f"trial is {trial}, but the study has {plural(len(pairs), 'pair')}"
    if {*sides} != {*methods} or row["ours"] != methods[0]:
        found = [row["ours"], *({*sides} - {row["ours"]})]
        return f"the methods are {quoted(found)}, ours first, expected {quoted(methods)}"
    return None


def _study_of(page: Path) -> dict[str, Any]:
    """Return the study that a page of `study_page` holds."""
    try:
        text = page.read_text(encoding="utf-8")
        found = re.search(r'<script type="application/json" id="study">(.*?)</script>', text, re.DOTALL)
        study = json.loads(found[1]) if found else {}
    except (OSError, ValueError) as error:
        unread = f"{page} cannot be read as a page of a study ({shortened(error, 200)})"
        raise ObjectFolderError(unread) from error
    match study:
        case {"id": str(), "methods": [str(), str()], "pairs": [*pairs]}:
            if all(isinstance(one, dict) and isinstance(one.get("name"), str) for one in pairs):
                return study
    raise ObjectFolderError(
        f"{page} is not the page of a study; expected one that `objectfolder listening make` wrote"
    )


def _sound_files(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise ObjectFolderError(f"{folder} is not a folder, expected one of sounds ({', '.join(SUFFIXES)})")
    return {path.stem: path for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES}


def _drawn(names: list[str], count: int, seed: int) -> list[str]:
    """Draw names so that materials are as even as they can be."""
    rounds: dict[str, Iterator[int]] = defaultdict(itertools.count)
    drawn = np.random.default_rng(seed).permutation(names).tolist()
    turns = {name: next(rounds[material_of(name)]) for name in drawn}
    return sorted(drawn, key=turns.__getitem__)[:count]


def _levelled(path: Path) -> tuple[np.ndarray, int]:
    """Read a sound, (samples,), whose loudest part has a root mean square of 1, and its sample rate."""
    with open_sound(path) as file:
        rate = file.samplerate
        if rate > MOST:
            raise ObjectFolderError(f"{path} has {rate} Hz, expected at most {MOST} Hz; resample it")
        sound = loudest_channel(read_channels(file, path, LONGEST), path)
    peak = np.abs(sound).max(initial=0)
    if not peak > 0:
        silent = f"{path} is silent in its first {LONGEST:g} s, expected a sound"
        raise ObjectFolderError(f"{silent}; remove the silence before it")
    played = min(rate, PLAYED)
    sound = resample_sound(sound / peak, rate, played)
    power = np.concatenate([[0.0], np.square(sound).cumsum()])
    window = max(min(int(WINDOW * played), len(sound)), 1)
    loudest = (power[window:] - power[:-window]).max() / window
    return sound / np.sqrt(loudest), played
