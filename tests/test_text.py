"""Words of strangers, by destination."""

import csv
import json
import re

import pytest
from hostile import CONTROLS, LINES, WORDS, Elements
from markdown_it import MarkdownIt

from objectfolder.base.checks import is_web_address
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.text import from_csv, in_csv, in_html, in_markdown, in_script, visible
from objectfolder.base.yamlfile import read_yaml, yaml_text

PLAIN = ("Pots & pans", "blue_mug", "YCB Object and Model Set, Calli et al., 2015", "CC BY 4.0 (https://c.d)")
# With joiners, marks and spaces of their own.
SCRIPTS = ("café", "中文 名", "می\u200cخواهم", "שלום\u200f", "👩\u200d🔬", "a\u00a0b")


@pytest.mark.parametrize("text", [*LINES, *PLAIN, *SCRIPTS])
def test_texts_without_control_characters_are_shown_as_they_are(text):
    assert visible(text) == text
    assert str(ObjectFolderError(text)) == text


@pytest.mark.parametrize("text", CONTROLS)
def test_control_characters_are_shown(text):
    shown = visible(text)
    assert shown.isprintable()
    assert shown.encode()
    assert shown.encode("ascii").decode("unicode_escape") == text
    assert str(ObjectFolderError(text)) == visible(text, lines=True)
    assert not re.search(r"[^\n\t\x20-\x7e]", visible(text, lines=True))


@pytest.mark.parametrize("text", [*PLAIN, *SCRIPTS])
def test_plain_words_stay_as_they_are_in_tables_and_markdown(text):
    assert in_csv(text) == in_markdown(text) == text


@pytest.mark.parametrize("text", WORDS)
def test_no_cell_is_a_formula(text):
    cell = in_csv(text)
    assert from_csv(cell) == visible(text)
    for piece in re.split("[,;]", cell):  # as a spreadsheet of any language splits it
        assert not re.match('["\\s]*[=+\\-@\t\r＝]', piece)
    [[read]] = csv.reader([f'"{cell.replace(chr(34), 2 * chr(34))}"'])
    assert read == cell


STRUCTURES = ("{}", "- {}: a", "# {}", "a {} b.", "|a|\n|---|\n| {} |")


@pytest.mark.parametrize("around", STRUCTURES)
@pytest.mark.parametrize("text", WORDS)
def test_markdown_shows_a_text_and_nothing_else(text, around):
    parser = MarkdownIt().enable(["table", "strikethrough"])

    def parsed(words):
        tokens = parser.parse(around.format(words))
        inner = [token for found in tokens if found.children is not None for token in found.children]
        shown = "\n".join(token.content for token in inner if token.type == "text")
        return [(token.type, token.tag) for token in (*tokens, *inner)], shown

    found, expected = parsed(in_markdown(text)), parsed("x")
    assert found[0] == expected[0]
    assert found[1] == expected[1].replace("x", visible(text).strip())


@pytest.mark.parametrize("text", WORDS)
def test_html_shows_a_text_and_nothing_else(text):
    words, script = in_html(text), in_script({"a": text})
    found = Elements(f'<p title="{words}">{words}</p><script type="application/json">{script}</script>')
    assert found.elements == [("p", "title"), ("script", "type")]
    assert found.values[0] == visible(text)
    assert "".join(found.texts[:-1]) == visible(text)
    assert json.loads(found.texts[-1]) == {"a": text}


@pytest.mark.parametrize("text", [*WORDS, *PLAIN])
def test_yaml_holds_a_text_and_nothing_else(tmp_path, text):
    path = tmp_path / "a.yaml"
    path.write_text(
        yaml_text({"name": text, "tags": ["a", "b"], "c": [{"d": "e"}]}, "name"), encoding="utf-8"
    )
    assert read_yaml(path) == {"name": visible(text), "tags": ["a", "b"], "c": [{"d": "e"}]}


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("https://example.org", True),
        ("http://127.0.0.1:8000/a/b%20c?d=e#f", True),
        ("https://[::1]/a", True),
        ("https://", False),
        ("https:///a", False),
        ("ftp://a.b", False),
        ("javascript:alert(1)", False),
        ("HTTPS://a.b\n", False),
        ("https://user:password@a.b", False),
        ("https://a.b@evil.org", False),
        ("https://a.b\\@evil.org", False),
        ("https://a.b/\x1b[2J", False),
        ('https://a.b/"><script>', False),
        ("https://аpple.com", False),  # Cyrillic а
        (f"https://a.b/{'c' * 2000}", False),
    ],
)
def test_addresses_of_the_web(text, holds):
    assert is_web_address(text) == holds
