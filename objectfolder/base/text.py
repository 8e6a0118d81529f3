"""Words of strangers, by destination: names, notices and messages that others wrote.

Each function returns a text that its destination shows and does not obey: a terminal, a table for
spreadsheets, Markdown, HTML, a script element. YAML has an emitter, `objectfolder.base.yamlfile.yaml_text`.
Plain words stay as they are.
"""

import json
import re
import unicodedata
from html import escape
from typing import Any

#: Joiners and marks without which Arabic, Hebrew, Persian and Indic scripts are wrong; they move no others.
_JOINERS = "\u200c\u200d\u200e\u200f"
#: What spreadsheets take for a formula, after quotes and spaces; the last four signs are of full width.
_FORMULA = "(?=['\"\\s]*[=+\\-@\\t\\r\\n\uff1d\uff0b\uff0d\uff20])"
#: Where a cell begins: also after what some spreadsheets take for the end of one, whatever the quotes.
_BEGINNING = "(^|[,;])"
#: What Markdown takes for markup: in a line, and where a line begins.
_MARKUP = re.compile(r"[\\`*\[\]<>|~$#]|(?<![^\W_])_|_(?![^\W_])|&(?=#?\w+;)|^[-+=]")
_NUMBERED = re.compile(r"^([0-9]{1,9})(?=[.)])")


def visible(text: object, lines: bool = False) -> str:
    """Return a text without control characters, for terminals and people; they become Python's escapes.

    So do those that cannot be seen, reverse the order of others (bidirectional overrides), or cannot be
    encoded (bytes of file names). ``lines``: whether line breaks and tabs stay; without them, a text cannot
    pass for two messages.
    """
    shown = str(text)
    if shown.isprintable():
        return shown
    kept = _JOINERS + "\n\t" if lines else _JOINERS
    return "".join(
        char
        if char.isprintable() or char in kept or unicodedata.category(char) == "Zs"
        else char.encode("unicode_escape").decode()
        for char in shown
    )


def in_csv(text: str) -> str:
    """Return a cell that no spreadsheet takes for a formula, by an apostrophe before it; see `from_csv`."""
    return re.sub(_BEGINNING + _FORMULA, r"\1'", visible(text))


def from_csv(cell: str) -> str:
    """Return the text of a cell that `in_csv` made."""
    return re.sub(f"{_BEGINNING}'{_FORMULA}", r"\1", cell) if "'" in cell else cell


def in_markdown(text: str) -> str:
    """Return a text as a part of a line of Markdown: no markup, HTML, link or column of a table.

    Addresses stay plain text: renderers that link them show where they lead.
    """
    escaped = _MARKUP.sub(lambda found: f"\\{found[0]}", visible(text).strip())
    return _NUMBERED.sub(r"\1\\", escaped)


def in_html(text: str) -> str:
    """Return a text as content of an element of HTML, or as a value of an attribute in quotes."""
    return escape(visible(text))


def in_script(value: Any) -> str:
    """Return a value as JSON that may stand in a script element."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
