"""GLSL text: files of shaders/, `#include "lib/x.glsl"` resolved, `#line` set so that errors name file and line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

FOLDER = Path(__file__).resolve().parent.parent.parent / "shaders"
INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
# Mesa: "2:15(3): error"; NVIDIA: "2(15) : error"; others: "ERROR: 2:15:".
ERROR_PLACE = re.compile(r"(?<![\w.])(\d+)(?::(\d+)|\((\d+)\))")


class ShaderError(RuntimeError):
    """A shader does not compile or link; the message names the file and the line in it."""


@dataclass(frozen=True)
class Source:
    text: str
    files: tuple[str, ...]  # source number n in a #line directive is files[n]

    def explain(self, log: str) -> str:
        """A driver's log with source numbers replaced by file names."""

        def name(match: re.Match[str]) -> str:
            number, line = int(match.group(1)), match.group(2) or match.group(3)
            return f"{self.files[number]}:{line}" if number < len(self.files) else match.group(0)

        return ERROR_PLACE.sub(name, log)


@lru_cache(maxsize=None)
def load(file: str) -> Source:
    """The text of shaders/<file> with includes, each of which is taken once. FileNotFoundError: no such file."""
    files: list[str] = []
    return Source(_expand(file, files), tuple(files))


def _expand(file: str, files: list[str]) -> str:
    number = len(files)
    files.append(file)
    parts = [f"#line 1 {number}\n"]
    for index, line in enumerate((FOLDER / file).read_text(encoding="utf-8").splitlines(), start=1):
        match = INCLUDE.match(line)
        if not match:
            parts.append(line + "\n")
        elif match.group(1) not in files:
            parts += [_expand(match.group(1), files), f"#line {index + 1} {number}\n"]
        else:
            parts.append("\n")
    return "".join(parts)
