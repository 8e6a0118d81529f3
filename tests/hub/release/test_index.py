"""The index of a release: its rules, and the files that it names."""

import csv
import os
import shutil
import time
from dataclasses import asdict
from pathlib import Path

import pytest
from folders import contents
from index_rows import BELL, MUG
from refusals import refused

from objectfolder import Dataset
from objectfolder.base.io import file_digest
from objectfolder.benchmarks.run import load_object_files
from objectfolder.hub.release.entries import index_text
from objectfolder.objectfile.dataset import COLUMNS, IndexEntry, read_index
from objectfolder.objectfile.samples import sample_path


def written(folder, *rows):
    """An index of rows as they are; values of None are left empty."""
    folder.mkdir(exist_ok=True)
    with (folder / "objects.csv").open("w", newline="", encoding="utf-8", errors="surrogateescape") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        writer.writerows(row.values() if isinstance(row, dict) else row for row in rows)
    return folder / "objects.csv"


def test_what_is_written_is_read(tmp_path):
    entries = tuple(IndexEntry(**row) for row in (MUG, BELL))
    (tmp_path / "objects.csv").write_text(index_text(entries))
    assert read_index(tmp_path / "objects.csv") == entries
    assert [asdict(entry) for entry in entries] == [MUG, BELL]


KEY, WHOLE, REAL = "expected a letter, then", "expected a whole number from", "expected a number from"
PATH = "expected one in the release, of at most 1000 characters and names of at most 255 bytes"


@pytest.mark.parametrize(
    ("column", "values", "expected"),
    [
        ("key", ("", "Mug", "../mug", "1mug", "mug\n", "m" * 101, "múg", "=mug", "mug "), KEY),
        ("material", ("", "<b>", "steel\n", "=steel", "steel|", "s" * 101, "stéel"), "a name such as"),
        ("path", ("", "/etc/passwd", "../mug", "objects/../../mug", ".", "a/" * 501, "a" * 256), PATH),
        ("path", ("objects/\x00", "objects/\x1b[2J", "objects/\u202e", "objects/\n"), "without control char"),
        ("size", ("wide", "", "nan", "inf", "-0.1", "0", "1e7", "0x1", "1_0", "١", " 1", "9" * 400), REAL),
        ("modes", ("3.0", "-1", "", "1_000", "٣", "1e3", "9" * 10), WHOLE),
        ("bytes", ("0", "-5", "", "1.5", str(2**31)), WHOLE),
        ("lowest_hz", ("0", "-1", "nan", "1e12", "inf"), REAL),
        ("vision_psnr", ("inf", "4l.2", "1001", "9" * 400), REAL),
        ("gain_error", ("-0.1", "nan"), REAL),
        ("touch_psnr", ("=1+1", "1,5"), REAL),
        ("split", ("", "Train", "all"), "expected train, val or test"),
        ("sha256", ("", "0" * 63, "g" * 64, "A" * 64), "expected 64 hexadecimal digits"),
        ("licence", ("", "l" * 1001, "a\x1b]0;b\x07"), "expected a text of 1 to 1000 characters"),
        ("licence_url", ("ftp://a.b", "javascript:alert(1)", "https://a.b\n"), "expected an address such as"),
        ("title", ("t" * 1001, "a\x1b[2J"), "expected a text of at most 1000 characters"),
        ("attribution", ("a" * 1001, "a\nb"), "expected a text of at most 1000 characters"),
        ("changes", ("c" * 2001, "a\u202eb"), "expected a text of at most 2000 characters"),
        ("uncertain", ("", "2", "-1", "True"), WHOLE),
        ("source", ("s" * 1001, "a\u2028b", "a\rb"), "expected a text of at most 1000 characters"),
        ("category", ("c" * 101, "a\tb"), "expected a text of at most 100 characters"),
    ],
)
def test_a_row_that_breaks_a_rule_is_named(tmp_path, column, values, expected):
    for value in values:
        index = written(tmp_path, MUG, BELL | {column: value})
        message = refused(expected, Dataset, tmp_path)
        assert message.startswith(f"{index}, object 2: {column} is ")
        assert message.isprintable()


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ((), "objects.csv holds no objects, expected at least one"),
        ((MUG, BELL, MUG), "object 3: key is 'mug', expected another than that of object 1"),
        (([*MUG.values()][:-2],), "object 1: lacks changes, uncertain"),
        (([*MUG.values(), "more"],), r"object 1: \['more'\] is beyond the last column"),
        ((MUG, BELL | {"source": "s" * 200_000}), "after object 1, is damaged: field larger than"),
        ((MUG | {"source": "\udcff"},), "after object 0, is damaged: .* can't decode"),
    ],
)
def test_a_damaged_index_is_refused(tmp_path, rows, message):
    written(tmp_path, *rows)
    refused(message, Dataset, tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "objects.csv lacks key, path, .* source, expected columns of these names"),
        (",".join(COLUMNS).replace("source", "origin"), "objects.csv lacks source, expected columns"),
        (",".join([*COLUMNS, "key"]), "objects.csv has the column key twice"),
        (None, "is not a release"),
    ],
)
def test_the_first_line_names_the_columns(tmp_path, text, message):
    if text is not None:
        (tmp_path / "objects.csv").write_text(text)
    refused(message, Dataset, tmp_path)


def test_columns_of_newer_versions_are_left_alone(tmp_path):
    index = written(tmp_path, MUG)
    head, row = index.read_text().splitlines()
    index.write_text(f"weight,{head}\n1 kg,{row}\n")
    assert Dataset(tmp_path).keys == ("mug",)


def test_an_older_index_without_attributions_is_read(tmp_path):
    later = ("licence_url", "title", "attribution", "changes", "uncertain")
    older = {name: value for name, value in MUG.items() if name not in later}
    assert [*older] == [*COLUMNS][:15]
    (tmp_path / "objects.csv").write_text(f"{','.join(older)}\n")
    with (tmp_path / "objects.csv").open("a", newline="") as stream:
        csv.writer(stream).writerow(older.values())
    [entry] = read_index(tmp_path / "objects.csv")
    assert asdict(entry) == MUG | dict.fromkeys(later[:-1], "") | {"uncertain": 0}


@pytest.fixture
def release(tmp_path):
    """A release of two objects."""
    (tmp_path / "release/objects").mkdir(parents=True)
    rows = []
    for row in (MUG, BELL):
        sample = sample_path(row["key"])
        shutil.copy(sample, tmp_path / "release" / row["path"])
        rows.append(row | {"sha256": file_digest(sample), "bytes": sample.stat().st_size})
    written(tmp_path / "release", *rows)
    return tmp_path / "release"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("bell,objects/bell", "gong,objects/bell", "object 2: key is 'gong', expected 'bell' as in"),
        (",steel,", ",wood,", "object 2: material is 'wood', expected 'steel' as in"),
        ("bell,objects/bell", "bell,objects/mug", "object 2: key is 'bell', expected 'mug' as in"),
    ],
)
def test_a_file_of_another_object_is_refused(release, old, new, message):
    index = release / "objects.csv"
    assert old in index.read_text()
    index.write_text(index.read_text().replace(old, new))
    dataset = Dataset(release)
    assert dataset[0].key == "mug"
    for read in (lambda: dataset[1], lambda: dataset[1:][0], lambda: load_object_files([release])):
        refused(message, read)


@pytest.mark.parametrize("place", ["objects/bell.safetensors", "objects", "objects.csv"])
def test_links_out_of_a_release_are_refused(release, place):
    dataset, target = Dataset(release), release.with_name(f"elsewhere{Path(place).suffix}")
    (release / place).rename(target)
    (release / place).symlink_to(target)
    refused(r"leads to .*elsewhere.*, expected a file in the release", Dataset, release)
    if place != "objects.csv":  # the link came after the index was read
        refused(r"object 2: path 'objects/bell.*' leads to .*elsewhere", lambda: dataset["bell"])


def test_links_inside_a_release_and_to_it_are_followed_but_not_in_a_circle(release):
    path, outer = release / BELL["path"], release.with_name("outer")
    path.rename(release / "bell")
    path.symlink_to("../bell")
    outer.symlink_to(release)
    assert Dataset(outer)["bell"].key == "bell"
    path.unlink()
    path.symlink_to(path.name)
    refused(r"bell\.safetensors is missing", lambda: Dataset(release)["bell"])


def test_a_snapshot_of_the_hub_consists_of_links(release):
    """As `huggingface_hub.snapshot_download` leaves it."""
    hub = release.with_name("models--a--b")
    blobs, snapshot = hub / "blobs", hub / "snapshots" / "abc"
    blobs.mkdir(parents=True)
    for name in contents(release):
        held, blob = snapshot / name, blobs / file_digest(release / name)
        held.parent.mkdir(parents=True, exist_ok=True)
        (release / name).rename(blob)
        held.symlink_to(os.path.relpath(blob, held.parent))
    assert [file.key for file in Dataset(snapshot)] == ["mug", "bell"]
    secret = release.with_name("secret")
    secret.touch()
    (snapshot / BELL["path"]).unlink()
    (snapshot / BELL["path"]).symlink_to(secret)
    refused(r"object 2: path .* leads to .*secret", Dataset, snapshot)


def test_sixty_thousand_rows_take_linear_time(tmp_path):
    """Before, duplicates were counted for each key, and a key was looked up in all rows."""

    def seconds(count):
        rows = [MUG | {"key": f"k{n}", "path": f"objects/k{n}.safetensors"} for n in range(count)]
        index = written(tmp_path, *rows)
        begin = time.process_time()
        dataset = Dataset(tmp_path)
        assert all(dataset.entry(key).key == key and key in dataset for key in dataset.keys[::7])
        assert dataset[[*dataset.keys[::7]]].index(f"k{(count - 1) // 7 * 7}") == (count - 1) // 7
        taken = time.process_time() - begin
        with index.open("a") as stream:
            stream.write(index.read_text().splitlines()[-1] + "\n")
        refused(rf"object {count + 1}: key is 'k{count - 1}'", Dataset, tmp_path)
        return taken, time.process_time() - begin

    few, many = seconds(6000), seconds(60_000)
    assert many[0] < 30 * few[0]
    assert many[1] < 30 * few[1]
    assert many[1] < 120
