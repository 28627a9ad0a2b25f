"""What scripts import from this repository is there: no test runs most of them."""

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted((ROOT / "scripts").rglob("*.py"))
OURS = ("scripts", "pointsplat_addon")


def file_of(module: str) -> Path | None:
    """The file of a module or package of this repository, None if there is none. A folder may do without __init__."""
    stem = ROOT.joinpath(*module.split("."))
    return next((f for f in (stem.with_suffix(".py"), stem / "__init__.py") if f.is_file()), None)


@cache
def names_in(file: Path) -> frozenset[str]:
    """Names that a module binds outside functions and classes, also below `if` and `try`."""
    names: set[str] = set()
    waiting: list[ast.AST] = [ast.parse(file.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            names |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        waiting.extend(ast.iter_child_nodes(node))
    return frozenset(names)


def missing(text: str) -> list[str]:
    """Modules and names that a file's text imports from this repository and that are not there."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found += [a.name for a in node.names if a.name.split(".")[0] in OURS and file_of(a.name) is None]
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OURS:
            file = file_of(node.module)
            bound = names_in(file) if file is not None else frozenset()
            found += [
                f"{node.module}.{alias.name}"
                for alias in node.names
                if alias.name not in bound and file_of(f"{node.module}.{alias.name}") is None
            ]
    return found


def test_a_name_that_is_not_there_is_found() -> None:
    assert missing("import numpy\nfrom scripts import dev\nfrom scripts.dev import main, nothing") == [
        "scripts.dev.nothing"
    ]
    assert missing("def f():\n    from scripts.nowhere import main") == ["scripts.nowhere.main"]


@pytest.mark.parametrize("file", SCRIPTS, ids=lambda f: str(f.relative_to(ROOT)))
def test_a_script_imports_only_what_is_there(file: Path) -> None:
    assert missing(file.read_text(encoding="utf-8")) == []
