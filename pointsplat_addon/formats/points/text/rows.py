"""Rows of numbers in text: the same number of them on each line, between blanks, commas, semicolons or tabs.

Lines are read in blocks, and all tokens of a block at once. Lines that have another number of tokens are left out and
counted: comments, blank lines, headers that come again.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..reader import PointFileError

BLOCK = 1 << 24  # bytes
BLANK = bytes.maketrans(b",;\t\r\"'", b"      ")  # what stands between numbers becomes a blank
NEWLINE, SPACE = 10, 32
NUMERIC = np.isin(np.arange(256), np.frombuffer(b"+-.0123456789nNiI", np.uint8))  # what numbers begin with


class TextRows:
    """A part of a text file."""

    def __init__(self, path: Path, start: int, skip: int, count: int | None, columns: int) -> None:
        """`start`: bytes before the first line. `skip`: lines of numbers before the first row. `count`: rows there
        should be; None: as many as there are. `columns`: numbers on a line."""
        self._path, self._start, self._skip, self._count, self._columns = path, start, skip, count, columns
        self.left_out = 0  # lines that begin with a number and have another number of tokens
        if count is not None and 2 * columns * count > path.stat().st_size - start + 1:
            raise PointFileError(path, f"promises {count:,} points, for which it is too short")

    def chunks(self, size: int) -> Iterator[np.ndarray]:
        """Yields (N, C) float64. Raises PointFileError for what is no number, and where rows are missing."""
        found, skip, self.left_out = 0, self._skip, 0
        for block in blocks(self._path, self._start):
            rows = self._rows(block)
            skip, rows = skip - min(skip, len(rows)), rows[skip:]
            if self._count is not None:
                rows = rows[: self._count - found]
            found += len(rows)
            for first in range(0, len(rows), size):
                yield rows[first : first + size]
            if self._count is not None and found >= self._count:
                return
        if self._count is not None and found < self._count:
            raise PointFileError(self._path, f"promises {self._count:,} points and has {found:,}")

    def _rows(self, block: bytes) -> np.ndarray:
        """The rows of whole lines."""
        text = block.translate(BLANK)
        counts, starts, ends, leads = tokens_of_lines(text)
        good = (counts == self._columns) & NUMERIC[leads]
        if not good.all():
            self.left_out += int((~good & (counts > 0) & NUMERIC[leads]).sum())
            kept = np.repeat(good, ends - starts)
            text = np.frombuffer(text, np.uint8)[: len(kept)][kept].tobytes()
        rows = int(good.sum())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of what is no number, which is found below
            try:
                values = np.fromstring(text, np.float64, sep=" ") if rows else np.empty(0)
            except ValueError:  # what newer versions of NumPy do there
                values = np.empty(0)
        if len(values) != rows * self._columns:
            raise PointFileError(self._path, f'has what is no number: "{_no_number(text)}"')
        return values.reshape(rows, self._columns)


def blocks(path: Path, start: int) -> Iterator[bytes]:
    """Yields a file's bytes from `start` on in blocks of whole lines."""
    with path.open("rb") as file:
        file.seek(start)
        left = b""
        while data := file.read(BLOCK):
            data = left + data
            end = data.rfind(b"\n") + 1
            left = data[end:]
            if len(left) > BLOCK:
                raise PointFileError(path, f"has a line of more than {BLOCK >> 20} megabytes")
            if end:
                yield data[:end]
        if left:
            yield left + b"\n"


def tokens_of_lines(text: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """How many words each line has, where lines begin and end (beyond their newline), and the first character of their
    first word: (L,) each. `text`: whole lines, words between blanks."""
    codes = np.frombuffer(text, np.uint8)
    word = (codes != SPACE) & (codes != NEWLINE)
    begins = word.copy()
    begins[1:] &= ~word[:-1]
    ends = np.flatnonzero(codes == NEWLINE) + 1
    if len(ends) == 0:
        nothing = np.empty(0, np.int64)
        return nothing, nothing, nothing, np.empty(0, np.uint8)
    starts = np.concatenate([[0], ends[:-1]])
    words = np.append(np.flatnonzero(begins), len(codes) - 1)
    leads = codes[words[np.searchsorted(words[:-1], starts)]]
    return np.add.reduceat(begins, starts, dtype=np.int64), starts, ends, leads


def _no_number(text: bytes) -> str:
    """The first word that is none."""
    for word in text.split():
        try:
            float(word)
        except ValueError:
            return word.decode("utf-8", "replace")[:40]
    return ""
