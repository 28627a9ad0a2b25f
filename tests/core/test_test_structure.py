"""No test module is imported, and no script imports tests: what they share lies in tests/support and scripts/scenes."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS, SCRIPTS = (sorted((ROOT / folder).rglob("*.py")) for folder in ("tests", "scripts"))


def imported(file: Path) -> set[str]:
    """Names of all modules that a file may import, at its top or inside functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("file", TESTS, ids=lambda f: str(f.relative_to(ROOT)))
def test_no_test_module_is_imported(file: Path) -> None:
    modules = {".".join(f.relative_to(ROOT).with_suffix("").parts) for f in TESTS if f.name.startswith("test_")}
    assert imported(file) & modules == set()


@pytest.mark.parametrize("file", SCRIPTS, ids=lambda f: str(f.relative_to(ROOT)))
def test_no_script_imports_tests(file: Path) -> None:
    assert [name for name in imported(file) if name.split(".")[0] == "tests"] == []
