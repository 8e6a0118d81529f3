"""The table docs/formats.csv: what each format may contain and what becomes of it, a file per row."""

import csv
import re
from pathlib import Path

import gltf_features
import pytest
import text_features

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.reading.load import default_up, load_mesh

ROWS = gltf_features.ROWS | text_features.ROWS
TABLE = [
    (row["format"], row["may contain"], row["what becomes of it"])
    for row in csv.DictReader(
        (Path(__file__).parents[3] / "docs" / "formats.csv").read_text(encoding="utf-8").splitlines()
    )
]


def test_every_row_of_the_table_has_a_file():
    assert sorted(ROWS) == sorted(row[:2] for row in TABLE)


@pytest.mark.parametrize(("format", "feature", "becomes"), TABLE)
def test_it_becomes_what_the_table_says(tmp_path, format, feature, becomes):
    """A builder writes a file and returns its path and what checks the mesh, nothing if it is refused."""
    path, check = ROWS[format, feature](tmp_path)
    kind, words = re.match(r"\w+", becomes)[0], re.findall(r"`([^`]*)`", becomes)
    assert kind in ("read", "noted", "refused")
    if kind == "refused":
        with pytest.raises(ObjectFolderError) as caught:
            load_mesh(path, default_up(path))
        assert str(path) in str(caught.value)
        said = [str(caught.value)]
    else:
        mesh = load_mesh(path, default_up(path))
        check(mesh)
        said = [note for note in mesh.source["notes"] if "baked into" not in note]
    assert [word for word in words if not any(word in note for note in said)] == []
    assert len(said) == len(words) or kind == "refused"
