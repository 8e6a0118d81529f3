"""Words of strangers in all that a release writes, from SOURCE.txt to its site."""

import csv
import json
import re

import pytest
from hostile import WORDS
from index_rows import MUG
from markdown_it import MarkdownIt
from refusals import refused

from objectfolder.base.text import visible
from objectfolder.base.yamlfile import read_yaml
from objectfolder.hub.release.croissant import croissant
from objectfolder.hub.release.entries import index_text
from objectfolder.hub.release.notices import MAX_NOTICE, licence_address, read_notice
from objectfolder.hub.release.pages import card, datasheet, describe_release
from objectfolder.objectfile.dataset import IndexEntry, read_index


def mesh(folder, text):
    """A mesh with a notice whose fields are a text; a line break in it begins another line."""
    fields = ("Mesh and textures", "Licence", "Attribution", "Changes")
    (folder / "SOURCE.txt").write_text(
        "".join(f"{field}: {text}\n" for field in fields), encoding="utf-8", errors="surrogateescape"
    )
    return folder / "mesh.glb"


def release(folder, text):
    """Texts of a release all of whose words are a stranger's; their entry."""
    notice = read_notice(mesh(folder, text))
    said = {name: getattr(notice, name) for name in ("licence", "source", "title", "attribution", "changes")}
    said |= {"licence_url": licence_address(notice.licence), "category": visible(text)[:100]}
    entries = [IndexEntry(**MUG | said | {"key": "blue_mug", "path": "objects/blue_mug.safetensors"})]
    named = {"name": text, "creator": text, "version": "1.0.0", "date": "2026-11-24", "url": "https://a.b"}
    words, notices = describe_release(entries, **named), {"blue_mug": notice}
    texts = {
        "objects.csv": index_text(entries),
        "README.md": card(entries, words, notices, site=True),
        "DATASHEET.md": datasheet(entries, words),
        "croissant.json": json.dumps(croissant(entries, words, "0" * 64)),
    }
    return texts, entries


def structure(markdown):
    """Blocks and marks of a page, and the text that it shows."""
    tokens = MarkdownIt().enable(["table", "strikethrough"]).parse(markdown)
    inner = [token for found in tokens for token in found.children or ()]
    shown = [token.content for token in inner if token.type in ("text", "code_inline")]
    kinds = [(token.type, token.tag, token.attrs.get("href")) for token in (*tokens, *inner)]
    return kinds, "\n".join(shown)


@pytest.mark.parametrize("text", WORDS)
def test_no_destination_obeys(tmp_path, text):
    texts, entries = release(tmp_path, text)
    plain, _ = release(tmp_path, "plain")
    shown = visible(text)
    for name in ("README.md", "DATASHEET.md"):
        body, expected = (held[name].split("\n---\n")[-1] for held in (texts, plain))
        assert structure(body)[0] == structure(expected)[0]
        assert structure(body)[1].count(shown.strip()) >= 2
        assert texts[name].replace("\n", "").isprintable()
    front, _, _ = texts["README.md"].removeprefix("---\n").partition("\n---\n")
    (tmp_path / "front.yaml").write_text(front, encoding="utf-8")
    found = read_yaml(tmp_path / "front.yaml")
    assert found == {
        "pretty_name": shown,
        "license": "other",
        "tags": ["multisensory", "robotics", "3d", "audio", "tactile", "safetensors"],
        "size_categories": ["n<1K"],
        "configs": [{"config_name": "default", "data_files": [{"split": "objects", "path": "objects.csv"}]}],
    }
    index = tmp_path / "objects.csv"
    index.write_text(texts["objects.csv"], encoding="utf-8")
    assert list(read_index(index)) == entries
    [row] = csv.DictReader(texts["objects.csv"].splitlines())
    for cell in row.values():
        for piece in re.split("[,;]", cell):
            assert not re.match('["\\s]*[=+\\-@\t\r＝]', piece) or re.fullmatch(r"-[0-9.]+", piece)
    assert json.loads(texts["croissant.json"])["license"] == [entries[0].licence_url or entries[0].licence]
    for content in texts.values():
        assert content.encode()


def test_plain_words_are_written_as_they_are(tmp_path):
    text = "YCB, Calli et al. 2015 (https://a.b)"
    texts, _ = release(tmp_path, text)
    assert f'pretty_name: "{text}"\n' in texts["README.md"]
    assert f"# {text}\n" in texts["README.md"]
    assert f"- {text}; {text}: blue_mug. Changes: {text}.\n" in texts["README.md"]
    assert f'"{text}"' in texts["objects.csv"]


def test_a_notice_is_short_and_no_link_to_a_private_file(tmp_path):
    home = tmp_path / "cup"
    home.mkdir()
    notice, secret, cached = home / "SOURCE.txt", tmp_path / "id_rsa", tmp_path / ".dvc/cache/files/md5/ab/cd"
    refused("its licence has 1001 characters, expected at most 1000", read_notice, mesh(home, "l" * 1001))
    notice.write_text("a" * (MAX_NOTICE + 1))
    refused("has more than 65,536 bytes, expected a notice", read_notice, home / "mesh.glb")
    notice.unlink()
    secret.write_text("Licence: secret")
    notice.symlink_to(secret)
    refused(r"SOURCE\.txt is a link to .*id_rsa, expected a file of its own", read_notice, home / "mesh.glb")
    cached.parent.mkdir(parents=True)
    secret.rename(cached)
    notice.unlink()
    notice.symlink_to(cached)  # with cache.type symlink
    assert read_notice(home / "mesh.glb").licence == "secret"
