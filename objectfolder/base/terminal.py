"""The terminal: what commands and stages print shows the control characters in it, and no markup is read."""

import codecs
import logging
import sys
import threading
import traceback
import unicodedata
import warnings
from collections.abc import Iterable
from io import TextIOWrapper
from types import TracebackType
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from objectfolder.base.text import visible


class Terminal(Console):
    """Console of rich for texts that others wrote: names, messages, logs.

    Texts are not markup: `rich.text.Text` gives them a style.
    """

    def __init__(self, **options: Any):
        super().__init__(emoji=False, markup=False, **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Return the segments of what is printed; overrides the method through which all of it goes."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=visible(segment.text, lines=True))


def guard_streams() -> None:
    """Let Python itself show control characters: in log records, warnings, and uncaught errors.

    Streams that are not UTF-8 get the nearest plain characters: ``cm3`` for cm and a superscript.
    """
    codecs.register_error("plain", _plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="plain")
    for handler in (logging.lastResort, *logging.root.handlers):
        if handler is not None:
            handler.setFormatter(_Formatter("%(message)s"))
    warnings.formatwarning = _warning
    sys.excepthook = _uncaught
    threading.excepthook = lambda args: _uncaught(args.exc_type, args.exc_value, args.exc_traceback)


_PLAIN = str.maketrans("·−✓°", ".-+ ")


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Replace what an encoding lacks by letters and signs of ASCII, or question marks."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wanted = error.object[error.start : error.end].translate(_PLAIN)
    plain = (unicodedata.normalize("NFKD", char).encode("ascii", "ignore").decode() for char in wanted)
    return "".join(char or "?" for char in plain), error.end


class _Formatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return visible(super().format(record), lines=True)


_plain_warning = warnings.formatwarning


def _warning(*arguments: Any, **options: Any) -> str:
    return visible(_plain_warning(*arguments, **options), lines=True)


def _uncaught(kind: type[BaseException], error: BaseException | None, trace: TracebackType | None) -> None:
    if sys.stderr is not None:  # closed
        sys.stderr.write(visible("".join(traceback.format_exception(kind, error, trace)), lines=True))
