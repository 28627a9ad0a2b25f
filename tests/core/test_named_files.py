"""Files that comments, docstrings and documentation name are there."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("docs", "pointsplat_addon", "scripts", "shaders", "tests")
KINDS = (".py", ".md", ".glsl", ".vert", ".frag", ".comp")
NAME = re.compile(r"(?<![\w*{<>-])((?:[\w.-]+/)*\w[\w-]*\.(?:py|md|glsl|vert|frag|comp))(?![\w*])")
FILES = sorted(
    f for top in SOURCES for f in (ROOT / top).rglob("*") if f.suffix in KINDS and f.is_file() and not f.is_symlink()
)
DOCS = (ROOT / "README.md", ROOT / "assets" / "CREDITS.md")
OWN = Path(__file__).resolve()  # its examples are no files
# An example of an include, and what scripts write.
OTHERS = {"lib/x.glsl", "figures.md", "media.md"}


def prose(file: Path) -> str:
    """What of a file is written for people."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".md":
        return text
    if file.suffix != ".py":
        return "\n".join(re.findall(r"//[^\n]*|/\*.*?\*/", text, re.DOTALL))
    return "\n".join(_python(text))


def _python(text: str) -> Iterator[str]:
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.string
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""


def unknown(text: str, ends: set[str]) -> list[str]:
    """Names of files in a text that are the end of no file's path."""
    return [name for name in NAME.findall(text) if re.sub(r"^(\.{1,2}/)+", "", name) not in ends | OTHERS]


@pytest.fixture(scope="module")
def ends() -> set[str]:
    """The ends of all files' paths: a.py, b/a.py, ..."""
    paths = [f.relative_to(ROOT).parts for f in (*FILES, *ROOT.glob("*.*"), *(ROOT / "assets").rglob("*"))]
    return {"/".join(parts[i:]) for parts in paths for i in range(len(parts))}


def test_a_file_that_is_not_there_is_found() -> None:
    text = "`passes/a.py` and (b/c.frag, ../d.md): <pass>.vert, *.glsl, a.py."
    assert unknown(text, {"a.py", "passes/a.py", "d.md"}) == ["b/c.frag"]


@pytest.mark.parametrize("file", [f for f in (*FILES, *DOCS) if f != OWN], ids=lambda f: str(f.relative_to(ROOT)))
def test_files_that_are_named_are_there(file: Path, ends: set[str]) -> None:
    assert unknown(prose(file), ends) == []
