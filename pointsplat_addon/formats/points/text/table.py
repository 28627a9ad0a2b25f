"""Reads text: XYZ, TXT, ASC, CSV and PTS, a point a line.

What columns mean is told by a line of names, else guessed from how many there are and what numbers they hold; `guess`
says what it came to, so that a person can look at it before the points are read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from ....core.numeric.record import value_record
from ..columns import assemble, attributes_of, distinct
from ..reader import CHUNK, Columns, FileReader, Header, PointFileError, origin_of
from .rows import BLANK, NUMERIC, TextRows, blocks, tokens_of_lines

SAMPLE = 1 << 16  # bytes from which columns are guessed
MOST_NAMED_LINES = 64  # lines among which one of names may be
MOST_COUNT = 32  # characters of a line that says how many points follow
Z_ALONE = ("x", "y", "z")


@value_record
class Layout:
    """What the columns of a text file are."""

    names: tuple[str, ...]  # of the columns
    named: bool  # by the file; else they are guessed

    def __str__(self) -> str:
        return f"{', '.join(self.names)} ({'named by the file' if self.named else 'guessed'})"


def guess(path: Path) -> Layout:
    """Returns what a file's columns seem to be. Raises PointFileError where it holds no rows of three numbers."""
    with path.open("rb") as file:
        sample = file.read(SAMPLE)
    if b"\0" in sample:
        raise PointFileError(path, "is no text")
    lines = sample.decode("utf-8-sig", "replace").splitlines()
    lines = lines[:-1] if len(sample) == SAMPLE else lines
    rows, title = [], None
    for number, line in enumerate(lines):
        words = line.encode().translate(BLANK).decode().split()
        values = _numbers(words)
        if values is not None and len(values) >= len(Z_ALONE):
            rows.append(values)
        elif values is None and number < MOST_NAMED_LINES and not rows:
            names = _names(line)
            title = names if len(names) >= len(Z_ALONE) and len(_numbers_among(names)) == 0 else title
    if not rows:
        raise PointFileError(path, "has no line of three numbers")
    width = max({len(row) for row in rows}, key=lambda n: sum(len(row) == n for row in rows))
    if title is not None and len(title) == width:
        return Layout(tuple(title), True)
    return Layout(_guessed(np.array([row for row in rows if len(row) == width])), False)


def _beginning(path: Path) -> tuple[int, int | None]:
    """Bytes before the first line that may be a point, and how many points the line before it promises, if it does."""
    with path.open("rb") as file:
        start = 3 if file.read(3) == b"\xef\xbb\xbf" else 0
        file.seek(start)
        line = file.readline(MOST_COUNT)
    if path.suffix.lower() == ".pts" and line.endswith(b"\n") and line.strip().isdigit():
        return start + len(line), int(line)
    return start, None


def _names(line: str) -> list[str]:
    """The names of columns in a line of them: between commas, semicolons or tabs, else blanks."""
    line = line.lstrip("#/ \t").strip()
    cut = next((mark for mark in (",", ";", "\t") if mark in line), None)
    return [word.strip().strip("\"'").strip() for word in line.split(cut)]


def _numbers(words: list[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _numbers_among(words: list[str]) -> list[str]:
    return [word for word in words if _numbers([word]) is not None]


def _guessed(values: np.ndarray) -> tuple[str, ...]:
    """Names of columns, from rows of values (N, C)."""
    rest = values[:, 3:]
    whole = (np.mod(rest, 1) == 0) & (rest >= 0) & (rest <= 65535)
    colors = whole.all(axis=0)
    names: list[str] = []
    column = 0
    while column < rest.shape[1]:
        left = rest.shape[1] - column
        unit = left >= 3 and bool((np.abs((rest[:, column : column + 3] ** 2).sum(axis=1) - 1) < 0.02).all())
        if unit and "nx" not in names:
            names += ["nx", "ny", "nz"]
        elif left >= 3 and left != 4 and colors[column : column + 3].all() and "red" not in names:
            names += ["red", "green", "blue"]
        else:
            names.append(f"column_{column + 4}" if "intensity" in names else "intensity")
        column = len(names)
    return (*Z_ALONE, *names)


class TextReader(FileReader):
    """A text file of a point a line."""

    def __init__(self, path: Path, names: tuple[str, ...] | None = None) -> None:
        """`names`: what the columns are; None: as `guess` says."""
        layout = guess(path) if names is None else Layout(names, True)
        self._layout, self._path, self.warnings = layout, path, []
        start, promised = _beginning(path)
        self._rows = TextRows(path, start, 0, None, len(layout.names))
        attributes = attributes_of([(name, np.dtype(np.float64)) for name in layout.names], path)
        self._attributes = attributes
        count, first = 0, None
        for block in blocks(path, start):
            counts, _, _, leads = tokens_of_lines(block.translate(BLANK))
            count += int(((counts == len(layout.names)) & NUMERIC[leads]).sum())
        self.header = Header(path, f"text, columns {layout}", count, attributes)
        if promised not in (None, count):
            self.warnings.append(f"{path.name}: promises {promised:,} points and has {count:,}")
        first = next(self.chunks((), 1 << 16), None)
        origin = origin_of(None, None if first is None else first["position"])
        self.header = Header(path, self.header.format, count, attributes, origin=origin)

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        wanted = self.wanted(columns)
        for rows in self._rows.chunks(size):
            yield assemble(dict(zip(distinct(list(self._layout.names)), rows.T, strict=True)), wanted)
        left_out = self._rows.left_out
        if left_out:
            self.warnings.append(
                f"{self._path.name}: {left_out:,} lines that do not have {len(self._layout.names)} numbers are left out"
            )
