"""Text of mesh files: encodings, and numbers."""

import re
import warnings
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE

import numpy as np

#: How C libraries write what is not a number.
NOT_A_NUMBER = re.compile(rb"[-+]?(?:\d\.#[A-Z0-9]+|nan\([^\s)]*\))", re.I)
IS_SPACE = np.isin(np.arange(256), list(b" \t\n\v\f\r"))  #: of bytes
CUT_OFF = "it may be cut off: copy or export it again"
DECIMAL_COMMAS = "decimal commas: export with points"


def decode_text(data: bytes) -> str:
    """Decode the text of a mesh file: UTF-8 or UTF-16, or else Latin-1, in which any bytes are characters.

    Names in an unknown encoding stay apart this way, and those in Latin-1 are right.
    """
    encoding = utf16_order(data)
    if encoding:
        return data.decode(encoding, "replace").removeprefix("\ufeff")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.removeprefix(BOM_UTF8).decode("latin-1")


def utf16_order(data: bytes) -> str:
    """Return the encoding of a text in UTF-16, which may begin without a mark; "" if it is in another."""
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        return "utf-16-le" if data.startswith(BOM_UTF16_LE) else "utf-16-be"
    even, odd = any(data[:8:2]), any(data[1:8:2])  # Latin letters, as of any keyword
    if len(data) < 4 or 0 in (data[:8:2] if even else data[1:8:2]):
        return ""
    return {(True, False): "utf-16-le", (False, True): "utf-16-be"}.get((even, odd), "")


def parse_numbers(text: bytes, count: int, dtype: type = np.float64) -> np.ndarray | None:
    """Parse as many words as numbers, NaN in any spelling; None if some are none, or hold two: ``1.5-2``."""
    if not count:  # of which NumPy warns
        return np.zeros(0, dtype)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # of NumPy before 2.3, in place of the error
        try:
            values: np.ndarray = np.fromstring(text, dtype, sep=" ")
            return values if len(values) == count else None
        except (ValueError, DeprecationWarning):
            replaced = NOT_A_NUMBER.sub(b"nan", text)
            return None if replaced == text else parse_numbers(replaced, count, dtype)


def has_decimal_commas(text: bytes) -> bool:
    """Whether a number in a text has a comma, as some languages write it."""
    return re.search(rb"(?<![\w.])[-+]?\d+,\d+(?:e[-+]?\d+)?(?!\S)", text, re.I) is not None


def starts(apart: np.ndarray) -> np.ndarray:
    """Return the places that are not apart, and follow one that is, or nothing."""
    return np.flatnonzero(np.diff(apart.view(np.int8), prepend=np.int8(1)) < 0)


def between(start: np.ndarray, stop: np.ndarray, size: int) -> np.ndarray:
    """Mark the places from each start to before its stop; (size,) bool."""
    step = np.zeros(size + 1, np.int8)
    step[start] += 1
    step[stop] -= 1
    return np.cumsum(step[:-1], dtype=np.int8).view(bool)


def count_words(data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ends (L,) and numbers of words (L,) of the lines of a text, (N,) uint8, that are not blank."""
    end = np.flatnonzero(data == ord("\n"))
    count = np.diff(np.searchsorted(starts(IS_SPACE[data]), end), prepend=0)
    return end[count > 0], count[count > 0]


def find_words(data: np.ndarray, places: np.ndarray, word: str) -> np.ndarray:
    """Return which of the words that begin at some places of a text, (N,) uint8, are the given one."""
    found = np.flatnonzero(data[places] == ord(word[0]))
    for i, letter in enumerate(word[1:], 1):
        found = found[data[places[found] + i] == ord(letter)]
    return found[IS_SPACE[data[places[found] + len(word)]]]
