"""A listening study: which of two sounds is more real? The paper's user study (supplementary D)."""

import base64
import csv
import hashlib
import io
import json
from collections import defaultdict
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from objectfolder.audio.recordings import at_rate, loudest_channel, opened_sound, read_channels
from objectfolder.errors import ObjectFolderError, shortened
from objectfolder.viewer.page import filled_page, static_text

PAIRS = 16  #: of the paper's study
SUFFIXES = (".wav", ".flac", ".ogg")
WINDOW = 0.4  # seconds, of the loudest part, as of a momentary loudness (ITU-R BS.1771)
PEAK = 0.9  # of full scale, of the loudest sound of a study
LONGEST = 10.0  # seconds
PLAYED = 48000  # Hz; sounds of higher rates are brought to it, since FLAC does not hold every one of them
MOST = 1_000_000  # Hz, of a sound that is brought to it
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


def study_page(ours: Path, other: Path, pairs: int = PAIRS, seed: int = 0) -> str:
    """Return the page of a study, which works from disk.

    Sounds of the same name in both folders are a pair; of each, the first 10 s of the loudest channel are
    played. Both are brought to the same level: the root mean square of their loudest 0.4 s. If there are more
    pairs than asked for, materials are drawn evenly.

    Parameters
    ----------
    ours, other : Path
        Folders of WAV, FLAC or OGG files, named MATERIAL_anything; the folders' names are the methods'.
    pairs : int
    seed : int
        Of the draw, and of the orders in which listeners hear the pairs.

    Raises
    ------
    ObjectFolderError
        If the folders hold too few pairs, or a file cannot be read, is silent or is not finite.
    """
    if ours.resolve().name == other.resolve().name:
        raise ObjectFolderError(f"{ours} and {other} have the same name, which names the method; rename one")
    first, second = (_sound_files(folder) for folder in (ours, other))
    names = sorted(first.keys() & second.keys())
    if len(names) < pairs:
        raise ObjectFolderError(
            f"{ours} and {other} have {len(names)} sounds of the same name, expected {pairs}; "
            "add some, or ask for fewer with --pairs"
        )
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
                "sounds": [_encoded(sound * PEAK / peak, rate) for sound, rate in pair],
            }
            for name, pair in zip(chosen, sounds)
        ],
    }
    study["id"] = hashlib.sha256(json.dumps(study).encode()).hexdigest()[:12]
    return filled_page(
        "listening.html",
        {
            "title": escape("Which sounds more real?"),
            "study": json.dumps(study, separators=(",", ":")).replace("<", "\\u003c"),
            "script": static_text("listening.js"),
        },
    )


def material_of(name: str) -> str:
    """Return the material that the name of a sound begins with."""
    return name.partition("_")[0]


def preferences(paths: list[Path]) -> tuple[str, dict[str, Preference], int]:
    """Count answers that listeners saved.

    Parameters
    ----------
    paths : list of Path
        CSV files of one study; an answer that is in several counts once.

    Returns
    -------
    method : str
        The method whose preference is counted: that of the first folder of `study_page`.
    preferences : dict
        By material, then ``all``.
    listeners : int

    Raises
    ------
    ObjectFolderError
        If a file is none, the files are of different studies, or one listener's answers differ.
    """
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    places: dict[tuple[str, str, str], Path] = {}
    studies: dict[str, Path] = {}
    for path in paths:
        try:
            with path.open(encoding="utf-8-sig", newline="") as file:
                table = list(csv.DictReader(file))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise ObjectFolderError(f"{path} cannot be read as CSV ({shortened(error, 200)})") from error
        for number, row in enumerate(table, 2):
            sides = row.get("first"), row.get("second")
            if any(row.get(name) is None for name in COLUMNS) or not {row["chosen"], row["ours"]} <= {*sides}:
                raise ObjectFolderError(
                    f"{path}: line {number} is not an answer of a study, whose columns are "
                    f"{', '.join(COLUMNS)}"
                )
            studies.setdefault(row["study"], path)
            answer = {name: row[name] for name in COLUMNS}
            key = row["study"], row["listener"], row["pair"]
            place = places.setdefault(key, path)
            if rows.setdefault(key, answer) != answer:
                raise ObjectFolderError(
                    f"{place} and {path}: listener {shortened(row['listener'])} answers pair "
                    f"{shortened(row['pair'])} in two ways; leave one file out, or rename a listener"
                )
    if len(studies) > 1:
        raise ObjectFolderError(f"{', '.join(map(str, studies.values()))} are of different studies")
    if not rows:
        raise ObjectFolderError(f"{', '.join(map(str, paths))}: no answers")
    method = next(iter(rows.values()))["ours"]
    counts: dict[str, list[bool]] = defaultdict(list)
    for row in rows.values():
        counts[row["material"]].append(row["chosen"] == method)
    found = {name: Preference(sum(won), len(won)) for name, won in sorted(counts.items())}
    total = Preference(sum(p.chosen for p in found.values()), len(rows))
    return method, found | {"all": total}, len({listener for _, listener, _ in rows})


def _sound_files(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise ObjectFolderError(f"{folder} is not a folder, expected one of sounds ({', '.join(SUFFIXES)})")
    return {path.stem: path for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES}


def _drawn(names: list[str], count: int, seed: int) -> list[str]:
    """Draw names so that materials are as even as they can be."""
    rng = np.random.default_rng(seed)
    turns: dict[str, int] = defaultdict(int)
    ranked = []
    for name in rng.permutation(names).tolist():
        ranked.append((turns[material_of(name)], name))
        turns[material_of(name)] += 1
    return [name for _, name in sorted(ranked, key=lambda pair: pair[0])[:count]]


def _levelled(path: Path) -> tuple[np.ndarray, int]:
    """Read a sound, (samples,), whose loudest part has a root mean square of 1, and its sample rate."""
    with opened_sound(path) as file:
        rate = file.samplerate
        if rate > MOST:
            raise ObjectFolderError(f"{path} has {rate} Hz, expected at most {MOST} Hz; resample it")
        sound = loudest_channel(read_channels(file, path, LONGEST), path)
    peak = np.abs(sound).max(initial=0)
    if not peak > 0:
        raise ObjectFolderError(
            f"{path} is silent in its first {LONGEST:g} s, expected a sound; remove the silence before it"
        )
    played = min(rate, PLAYED)
    sound = at_rate(sound / peak, rate, played)
    power = np.concatenate([[0.0], np.square(sound).cumsum()])
    window = max(min(int(WINDOW * played), len(sound)), 1)
    loudest = (power[window:] - power[:-window]).max() / window
    return sound / np.sqrt(loudest), played


def _encoded(sound: np.ndarray, rate: int) -> str:
    buffer = io.BytesIO()
    soundfile.write(buffer, sound, rate, format="FLAC", subtype="PCM_16")
    return "data:audio/flac;base64," + base64.b64encode(buffer.getvalue()).decode()
