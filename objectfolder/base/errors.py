"""The exception that the command line shows without a traceback, and the form of values in its messages."""

import reprlib
from typing import Any

from objectfolder.base.text import visible

MAX_MESSAGE = 4000  #: characters

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxdict, _SHORT.maxlist, _SHORT.maxtuple = 4, 12, 12, 12
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 120


class ObjectFolderError(ValueError):
    """An error that the user can fix.

    The message names the object or file, the offending value, what was expected and what to do next. Its
    middle is left out if it is very long. Control characters in it, such as of a file's name, are shown.
    """

    def __init__(self, message: object = ""):
        super().__init__(visible(shortened(message, MAX_MESSAGE), lines=True))


def shortened(value: object, most: int = 60) -> str:
    """Return a value's text for a message; of a long one, its beginning and its end."""
    text = str(value)
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"


def plural(count: int, noun: str) -> str:
    """Return a count with its noun, for a message: ``1 view``, ``2 views``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def quoted(value: Any) -> str:
    """Return a value as in Python code, for a message: shortened, and not deeply nested."""
    try:
        return shortened(_SHORT.repr(value), 300)
    except ValueError:  # Python does not print numbers of thousands of digits
        return f"a {type(value).__name__}"
