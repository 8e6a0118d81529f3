"""The listening study."""

import re
import shutil

import numpy as np
import pytest
import soundfile
from refusals import refused
from web_pages import NEEDS_CHROMIUM, check_whole, heard, page_data, run_node

from objectfolder.benchmarks.listening import COLUMNS, Preference, Scores, preferences, study_page
from objectfolder.cli import app

MATERIALS = ("ceramic", "steel", "wood")


def ring(rate, level, seed):
    time = np.arange(rate) / rate
    return level * np.exp(-8 * time) * np.sin(2 * np.pi * (400 + 40 * seed) * time)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Twelve pairs: four steel, four wood, four ceramic; levels and rates differ."""
    root = tmp_path_factory.mktemp("sounds")
    for folder, rate in (("ours", 16000), ("recorded", 44100)):
        (root / folder).mkdir()
        for n in range(12):
            level = 0.01 if folder == "ours" else 0.1 * (1 + n)
            path = root / folder / f"{MATERIALS[n % 3]}_{n}.wav"
            soundfile.write(path, ring(rate, level, n).clip(-1, 1), rate, subtype="FLOAT")
    return root / "ours", root / "recorded"


def study(page):
    return page_data(page, 'id="study"')


def loudest(sound, rate):
    """Root mean square of the loudest 0.4 s, by brute force."""
    window = int(0.4 * rate)
    return max(np.sqrt(np.square(sound[k : k + window]).mean()) for k in range(0, len(sound) - window, 50))


def test_a_study_matches_levels_and_draws_materials_evenly(folders):
    found = study(study_page(*folders, pairs=6))
    assert found["methods"] == ["ours", "recorded"]
    assert sorted(pair["material"] for pair in found["pairs"]) == sorted(2 * MATERIALS)
    sounds = [heard(uri) for pair in found["pairs"] for uri in pair["sounds"]]
    assert max(np.abs(sound).max() for sound, _ in sounds) == pytest.approx(0.9, abs=1e-3)
    levels = [loudest(sound, rate) for sound, rate in sounds]
    assert max(levels) / min(levels) < 1.01


def test_a_study_loads_nothing_and_is_repeatable(folders):
    page = study_page(*folders, pairs=6, seed=3)
    assert page == study_page(*folders, pairs=6, seed=3)
    assert study(page)["id"] != study(study_page(*folders, pairs=6, seed=4))["id"]
    check_whole(page)


def test_folders_that_make_no_study_are_refused(folders, tmp_path):
    refused(r"have 12 sounds of the same name, expected 16", study_page, *folders)
    refused("have the same name", study_page, folders[0], folders[0])
    shutil.copytree(folders[0], tmp_path / "silent")
    soundfile.write(tmp_path / "silent" / "wood_2.wav", np.zeros(1000), 16000)
    refused(r"wood_2\.wav is silent in its first 10 s", study_page, tmp_path / "silent", folders[1], pairs=12)


@pytest.fixture
def one_pair(tmp_path):
    """Return the page of a pair whose second sound is given, and that sound as it is heard."""
    for name in ("ours", "recorded"):
        (tmp_path / name).mkdir()
    soundfile.write(tmp_path / "ours" / "wood_1.wav", ring(16000, 0.5, 1), 16000)

    def made(sound, rate):
        soundfile.write(tmp_path / "recorded" / "wood_1.wav", sound, rate, subtype="DOUBLE")
        page = study_page(tmp_path / "ours", tmp_path / "recorded", pairs=1)
        return heard(study(page)["pairs"][0]["sounds"][1])

    return made


@pytest.mark.parametrize("rate", [1000, 44100, 96000, 96001, 768000])
def test_sounds_of_any_rate_are_played_at_a_rate_that_flac_holds(one_pair, rate):
    sound, played = one_pair(ring(rate, 0.5, 0), rate)
    assert played == min(rate, 48000)
    expected = ring(played, 0.5, 0)
    rows = slice(played // 100, played // 2)
    error = sound / np.abs(sound).max() - expected / np.abs(expected).max()
    assert np.abs(error[rows]).max() < 5e-3


def test_channels_in_antiphase_do_not_cancel(one_pair):
    one = ring(16000, 0.5, 0)
    alone, _ = one_pair(one, 16000)
    np.testing.assert_array_equal(one_pair(np.stack([one, -one], 1), 16000)[0], alone)
    assert np.abs(alone).max() > 0.1


@pytest.mark.parametrize("level", [1e-300, 1e300])
def test_levels_at_the_limits_of_floats_are_matched(one_pair, level):
    found, expected = (one_pair(ring(16000, size, 0), 16000)[0] for size in (level, 1.0))
    np.testing.assert_allclose(found, expected)


def test_sounds_that_begin_late_are_told_from_broken_ones(one_pair):
    high = r"wood_1\.wav has 1000001 Hz, expected at most 1000000 Hz"
    refused(high, one_pair, ring(16000, 0.5, 0), 1000001)
    late = np.concatenate([np.zeros(106000), ring(10000, 0.5, 0)])
    refused(r"wood_1\.wav is silent in its first 10 s, expected a sound; remove", one_pair, late, 10000)
    assert np.abs(one_pair(late[6100:], 10000)[0]).max() > 0.1
    broken = np.where(np.arange(10000) == 7, np.nan, ring(10000, 0.5, 0))
    refused(r"wood_1\.wav holds values that are not finite", one_pair, broken, 10000)


@pytest.mark.parametrize(("chosen", "answers"), [(0, 10), (67, 160), (160, 160)])
def test_the_interval_is_wilsons(chosen, answers):
    """Its ends are the shares from which the found one is 1.96 of their own standard deviations away."""
    one = Preference(chosen, answers)
    for end in one.interval:
        if 1e-9 < end < 1 - 1e-9:
            deviation = np.sqrt(end * (1 - end) / answers)
            assert abs(one.share - end) / deviation == pytest.approx(1.959964, rel=1e-5)
    assert one.interval[0] <= one.share <= one.interval[1]


def saved(path, rows, study="s"):
    lines = [COLUMNS]
    for listener, pair, sides, chosen in rows:
        lines.append((study, listener, pair, pair.partition("_")[0], *sides, chosen, "ours"))
    path.write_text("".join(",".join(line) + "\n" for line in lines))
    return path


def test_answers_are_counted_by_material_and_once(tmp_path, capsys):
    """A material may have the name of the last row."""
    sides = ("ours", "recorded")
    rows = [
        ("1", "all_1", sides, "ours"),
        ("1", "steel_1", sides[::-1], "recorded"),
        ("2", "all_1", sides[::-1], "ours"),
        ("2", "steel_1", sides, "ours"),
    ]
    paths = [saved(tmp_path / "a.csv", rows[:3]), saved(tmp_path / "b.csv", rows)]
    found = preferences(paths)
    assert found == Scores("ours", {"all": Preference(2, 2), "steel": Preference(1, 2)}, Preference(3, 4), 2)
    app(["listening", "score", *map(str, paths)], standalone_mode=False)
    printed = capsys.readouterr().out
    assert re.search(r"all +│ +2 │ +100%", printed)
    assert re.search(r"all materials +│ +4 │ +75%", printed)


HEAD = "study,listener,trial,pair,material,first,second,chosen,ours"
RIGHT = "s,1,1,wood_1,wood,ours,recorded,ours,ours"
METHODS = r"line 3: the methods are \['ours', 'other'\], ours first, expected \['ours', 'recorded'\]"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["a,b", "1,2"], r"line 1 is \['a', 'b'\], expected one column 'study'"),
        ([HEAD + ",ours", RIGHT + ",ours"], "expected one column 'ours'"),
        ([], r"line 1 is \[\], expected one column"),
        ([HEAD], "no answers"),
        ([HEAD, RIGHT + ",more"], "line 2 does not have 9 cells, as the first line; leave it out"),
        ([HEAD, RIGHT[:-5]], "line 2 does not have 9 cells"),
        ([HEAD, RIGHT, "s,1,2,wood_2,wood,ours,recorded,third,ours"], "line 3: chosen is 'third', expected"),
        ([HEAD, "s,1,1,wood_1,wood,ours,recorded,ours,third"], "line 2: ours is 'third', expected 'ours' or"),
        ([HEAD, "s,1,1,wood_1,wood,ours,ours,ours,ours"], "line 2: first and second are both 'ours'"),
        ([HEAD, "s,1,1,wood_1,steel,ours,recorded,ours,ours"], "material is 'steel', expected 'wood' of 'wo"),
        ([HEAD, "s,1,0,wood_1,wood,ours,recorded,ours,ours"], "trial is '0', expected a whole number of at"),
        ([HEAD, "s,1,²,wood_1,wood,ours,recorded,ours,ours"], "trial is '²', expected a whole number"),
        ([HEAD, "s,1," + "9" * 5000 + ",wood_1,wood,ours,recorded,ours,ours"], "expected a whole number"),
        ([HEAD, RIGHT, "s,1,1,wood_2,wood,ours,recorded,ours,ours"], "trial 1 of listener '1' was pair 'wo"),
        ([HEAD, "s, ,1,wood_1,wood,ours,recorded,ours,ours"], "line 2: listener is empty"),
        ([HEAD, ",1,1,wood_1,wood,ours,recorded,ours,ours"], "line 2: study is empty"),
        ([HEAD, RIGHT, "s,2,1,wood_1,wood,ours,other,ours,ours"], METHODS),
        ([HEAD, RIGHT, "s,2,1,wood_1,wood,ours,recorded,ours,recorded"], r"methods are \['recorded', 'ou"),
        ([HEAD, RIGHT, "s,1,1,wood_1,wood,recorded,ours,ours,ours"], "answers pair wood_1 in two ways"),
        ([HEAD, RIGHT, "\0"], "line 3"),
        ([HEAD, f"s,1,1,wood_1,wood,ours,recorded,{'x' * 200000},ours"], "cannot be read as CSV"),
    ],
)
def test_answers_that_contradict_are_refused_by_line(tmp_path, lines, message):
    path = tmp_path / "x.csv"
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    refused(f"{re.escape(str(path))}.*{message}", preferences, [path])


def test_answers_are_those_of_the_page(folders, tmp_path, capsys):
    """Of its study, pairs and methods, and no more than it has."""
    page, path = tmp_path / "study.html", tmp_path / "x.csv"
    page.write_text(study_page(*folders, pairs=12), encoding="utf-8")
    one = study(page.read_text(encoding="utf-8"))["id"]
    right = f"{one},1,12,wood_2,wood,ours,recorded,ours,ours"
    for line, message in (
        (RIGHT, f"line 2: study is 's', but that of the page is '{one}'"),
        (right.replace("wood_2", "wood_77"), r"line 2: pair is 'wood_77', expected one of \["),
        (right.replace(",12,", ",13,"), "line 2: trial is 13, but the study has 12 pairs"),
        (right.replace("recorded", "theirs"), r"methods are \['ours', 'theirs'\], .* \['ours', 'recorded'\]"),
        (f"{one},1,12,wood_2,wood,ours,recorded,ours,recorded", "ours first, expected"),
    ):
        path.write_text(f"{HEAD}\n{line}\n", encoding="utf-8")
        refused(message, preferences, [path], page)
    path.write_text(f"{HEAD}\n{right}\n", encoding="utf-8")
    app(["listening", "score", str(path), "--study", str(page)], standalone_mode=False)
    assert "100%" in capsys.readouterr().out
    for held, message in (
        (None, "not the page of a study"),
        ("[", "cannot be read as a page"),
        ("[]", "not the page of a study"),
        ('{"id": "s", "methods": 5, "pairs": [{"name": "wood_1"}]}', "not the page of a study"),
        ('{"id": "s", "methods": ["ours", "recorded"], "pairs": [{"name": 1}]}', "not the page of a study"),
    ):
        tag = "" if held is None else f'<script type="application/json" id="study">{held}</script>'
        page.write_text(tag, encoding="utf-8")
        refused(message, preferences, [path], page)
    refused("cannot be read as a page of a study", preferences, [path], tmp_path / "no.html")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pairs": 0}, "pairs is 0, expected a whole number of at least 1"),
        ({"pairs": 1.5}, r"pairs is 1\.5, expected"),
        ({"pairs": None}, "pairs is None"),
        ({"seed": -1}, "seed is -1, expected a whole number of at least 0"),
        ({"seed": True}, "seed is True"),
    ],
)
def test_numbers_of_a_study_are_checked(folders, change, message):
    refused(message, study_page, *folders, **change)


def test_files_that_contradict_each_other_are_refused(tmp_path):
    sides = ("ours", "recorded")
    paths = [saved(tmp_path / f"{name}.csv", [("1", "wood_1", sides, "ours")], name) for name in "st"]
    refused("are of different studies", preferences, paths)
    paths = [saved(tmp_path / f"{chosen}.csv", [("1", "wood_1", sides, chosen)]) for chosen in sides]
    refused(r"ours\.csv and .*recorded\.csv: listener 1 answers pair wood_1 in two ways", preferences, paths)
    assert preferences(paths[:1] * 2).total == Preference(1, 1)


@pytest.mark.slow
@NEEDS_CHROMIUM
def test_two_listeners_in_chromium(folders, tmp_path):
    page = tmp_path / "study.html"
    app(["listening", "make", *map(str, folders), "--pairs", "6", "--out", str(page)], standalone_mode=False)
    run_node("listen.mjs", page, tmp_path)
    # The first listener always chose the first sound, the second the second: each method wins half.
    found = preferences([tmp_path / "answers.csv"], page)
    assert (found.method, found.listeners, found.total) == ("ours", 2, Preference(6, 12))
