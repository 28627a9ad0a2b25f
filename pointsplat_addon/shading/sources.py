"""GLSL text: files of shaders/ with `#include "lib/x.glsl"` resolved, and the way back from a driver's
message to the file and the line in it.

Drivers count the lines of the joined text. (GLSL's own way, a source number in `#line`, is not printed
by Mesa, and Metal's compiler refuses it.)
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from ..core.numeric.record import value_record

FOLDER = Path(__file__).resolve().parent.parent.parent / "shaders"
INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
# Source number and line, as Mesa: "0:15(3): error"; NVIDIA: "0(15) : error"; others: "ERROR: 0:15:".
LINE_NUMBER = re.compile(r"(?<![\w.:])\d+(?::(\d+)(?:\(\d+\))?|\((\d+)\))")
# The joined text starts at this line, so that the declarations before it are not taken for it.
FIRST_LINE = 1001


class ShaderError(RuntimeError):
    """A shader does not compile or link, or a file is missing; the message names the file and the line in it."""


@value_record
class Source:
    """A file with its includes."""

    text: str
    lines: tuple[tuple[str, int], ...]  # file and line (from 1) of each line of text

    @property
    def body(self) -> str:
        """The text as it follows the declarations that Interface.header prints."""
        return f"#line {FIRST_LINE}\n{self.text}"

    def location(self, line: int) -> str:
        """Returns FILE:LINE of a line (from 1) of `text`."""
        if not 1 <= line <= len(self.lines):
            return f"declarations:{line}"
        file, number = self.lines[line - 1]
        return f"{file}:{number}"

    def explain(self, log: str) -> str:
        """Returns a driver's log about declarations and `body`, with files and their lines instead of its own
        numbers."""

        def name(match: re.Match[str]) -> str:
            line = int(match.group(1) or match.group(2))
            return self.location(line - FIRST_LINE + 1) if line >= FIRST_LINE else f"declarations:{line}"

        return LINE_NUMBER.sub(name, log)


@cache
def load(file: str) -> Source:
    """Loads the text of `file` in shaders/ (or at an absolute path) with its includes, each of which is taken once.

    Included files are named from shaders/ too, wherever the including file lies. ShaderError: no such file.
    """
    text, lines = [], []
    _expand(file, file, set(), text, lines)
    return Source("".join(text), tuple(lines))


def _expand(file: str, wanted_by: str, seen: set[str], out: list[str], lines: list[tuple[str, int]]) -> None:
    seen.add(file)
    try:
        path = FOLDER / file
        at = path.stat()
        parts = _parts(path, file, (at.st_mtime_ns, at.st_size))
    except OSError as error:
        raise ShaderError(f"{wanted_by}: cannot read the shader {file}: {error.strerror}") from error
    for text, numbered, number, included in parts:
        out.append(text)
        lines += numbered
        if included and included not in seen:
            _expand(included, f"{file}:{number}", seen, out, lines)


@cache
def _parts(path: Path, file: str, version: tuple[int, int]) -> list[tuple[str, list[tuple[str, int]], int, str]]:
    """A file's text up to each include and from the last one on: the text, file and line of each of its lines, the
    include's line, and what it includes; "" at the end. Many programs include the same files. `version`: a file that is
    written anew is read anew. OSError: no such file."""
    parts, lines, first = [], path.read_text(encoding="utf-8").splitlines(), 0
    for number, line in enumerate([*lines, '#include ""']):
        match = INCLUDE.match(line) if "#include" in line else None
        if match or number == len(lines):
            text = "".join(f"{each}\n" for each in lines[first:number])
            numbered = [(file, each) for each in range(first + 1, number + 1)]
            parts.append((text, numbered, number + 1, match.group(1) if match else ""))
            first = number + 1
    return parts
