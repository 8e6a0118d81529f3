"""Lines of a Wavefront ``.obj``, by their keywords."""

from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh.reading.text import (
    DECIMAL_COMMAS,
    IS_SPACE,
    between,
    decode_text,
    find_words,
    has_decimal_commas,
    parse_numbers,
    starts,
)

#: Keywords of lines of numbers; the corners of a face have the numbers of lines of the first three.
KEYWORDS = ("v", "vt", "vn", "f")
VERTEX, COORDINATE, NORMAL, FACE, OTHER = range(5)  #: kinds of lines
NOT_NUMBERS = "has words that are no numbers, or too few; export the mesh again"
NOT_A_FACE = "is not a face, expected corners such as 1, 1/2, 1//3 or 1/2/3; export the mesh again"


class ObjLines:
    """Lines of an ``.obj`` that are not blank.

    The numbers of all lines of a keyword are parsed at once, from their bytes: a file has millions.
    """

    def __init__(self, path: Path):
        text = decode_text(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", "")
        text = text.replace("\0", " ").replace("\x1a", " ")  # at the end of some files
        self.path = path
        self.raw = text.encode() + b"\n" * 9  # as long as any keyword, from the start of any word
        self._split(np.frombuffer(self.raw, np.uint8))
        sign = np.flatnonzero(self.data == ord("#"))
        sign = sign[self.data[sign - 1] != ord(".")]  # 1.#IND is no number, and no comment
        line, first = np.unique(np.searchsorted(self.end, sign), return_index=True)
        numeric = self.kind[line] != OTHER  # names may hold a #
        if numeric.any():
            comment = between(sign[first[numeric]], self.end[line[numeric]], len(self.data))
            self._split(np.where(comment, np.uint8(ord(" ")), self.data))

    def _split(self, data: np.ndarray) -> None:
        end = np.flatnonzero(data == ord("\n"))
        words = starts(IS_SPACE[data])
        count = np.diff(np.searchsorted(words, end), prepend=0)
        filled = count > 0
        self.data = data
        self.end = end[filled]  #: (L,) place of the newline
        self.words = count[filled]  #: (L,) with the keyword
        self.start = words[np.cumsum(self.words) - self.words]  #: (L,) place of the keyword
        self.kind = np.full(len(self.end), OTHER)  #: (L,)
        for kind, keyword in enumerate(KEYWORDS):
            self.kind[find_words(data, self.start, keyword)] = kind

    def line(self, row: int | np.integer[Any]) -> str:
        """Return the text of a line."""
        return self.raw[self.start[row] : self.end[row]].decode().strip()

    def statements(self, keyword: str) -> tuple[list[int], list[str]]:
        """Return the lines with another keyword, and what follows it, which may be empty."""
        rows: list[int] = find_words(self.data, self.start, keyword).tolist()
        return rows, [self.line(row)[len(keyword) :].strip() for row in rows]

    def table(self, kind: int, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the first numbers of the lines of a kind, (N, width), and how many each has, (N,).

        They are 0 where a line has fewer.
        """
        rows, data = self._numbers(kind)
        counts = self.words[rows] - 1
        values = self._parse(rows, data, int(counts.sum()), np.float64, NOT_NUMBERS)
        if len(counts) and (counts == counts[0]).all() and counts[0] >= width:
            return values.reshape(len(counts), -1)[:, :width], counts
        table, column = np.zeros((len(counts), width)), np.arange(width)
        held = column < counts[:, None]
        table[held] = values[((np.cumsum(counts) - counts)[:, None] + column)[held]]
        return table, counts

    def corners(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the faces of three or more corners: their lines, (F,), and how many corners each has, (F,).

        And vertex, texture coordinates and normal of all corners, (C, 3), counted from 1; 0: none.
        """
        rows, data = self._numbers(FACE, 3)
        sizes = self.words[rows] - 1
        space, slash = IS_SPACE[data], data == ord("/")
        word, number = starts(space), starts(space | slash)
        numbers = np.where(slash, np.uint8(ord(" ")), data)
        values = self._parse(rows, numbers, len(number), np.int64, NOT_A_FACE)
        corner = np.searchsorted(word, number, "right") - 1
        slashes = np.cumsum(slash, dtype=np.int32)
        column = slashes[number] - slashes[word[corner]]
        row = np.repeat(rows, sizes)
        self.refuse(row[slash[word]], NOT_A_FACE)  # begins with one
        row = row[corner]
        self.refuse(row[column > 2], NOT_A_FACE)
        self.refuse(row[values == 0], "has the index 0, but .obj counts from 1")
        back = np.flatnonzero(values < 0)
        if len(back):
            before = np.stack([np.cumsum(self.kind == kind) for kind in (VERTEX, COORDINATE, NORMAL)])
            count = before[column[back], row[back]]
            for i in np.flatnonzero(values[back] < -count)[:1]:
                name = f"{KEYWORDS[column[back[i]]]} {values[back[i]]}"
                problem = f"counts back to {name}, but {count[i]} precede it; export the mesh again"
                self.refuse(row[back[i : i + 1]], problem)
            values[back] += count + 1
        corners = np.zeros((len(word), 3), np.int64)
        corners[corner, column] = values
        return rows, sizes, corners

    def refuse(self, rows: np.ndarray, problem: str) -> None:
        """Raise for the first of some lines, if there are any."""
        if len(rows):
            raise ObjectFolderError(f"{self.path}: {shortened(self.line(rows[0]))!r} {problem}")

    def _numbers(self, kind: int, least: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return the lines of a kind with that many words after the keyword, and the bytes of these words."""
        rows = np.flatnonzero((self.kind == kind) & (self.words > least))
        start = self.start[rows] + len(KEYWORDS[kind])
        return rows, self.data[between(start, self.end[rows] + 1, len(self.data))]

    def _parse(self, rows: np.ndarray, data: np.ndarray, count: int, dtype: type, problem: str) -> np.ndarray:
        """Parse the numbers of some lines, given their bytes."""
        text = data.tobytes()
        values = parse_numbers(text, count, dtype)
        if values is None:
            lines = zip(rows, text.splitlines())
            row, line = next(
                (row, line) for row, line in lines if parse_numbers(line, len(line.split()), dtype) is None
            )
            commas = problem == NOT_NUMBERS and has_decimal_commas(line)
            self.refuse(np.array([row]), f"has {DECIMAL_COMMAS}" if commas else problem)
        assert values is not None
        return values
