"""scripts/dev.py chooses a Python that bpy exists for, and gives every test file that loads bpy its own process."""

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def dev(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """The script as a module, on a machine without any Python but those that a test adds."""
    spec = importlib.util.spec_from_file_location("dev", ROOT / "scripts" / "dev.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("PYENV_ROOT", raising=False)
    monkeypatch.setattr(sys, "_base_executable", str(tmp_path / "none"))
    return module


def fake_python(path: Path, says: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{says}\n")
    path.chmod(0o755)
    return path


def test_a_python_of_another_version_is_not_taken(dev: ModuleType, tmp_path: Path) -> None:
    fake_python(tmp_path / "bin/python3", "echo 3.12 True")
    fake_python(tmp_path / ".pyenv/versions/3.10.13/bin/python3.10", "echo 3.10 True")
    assert dev.interpreter("3.11") is None
    assert dev.interpreter("3.13") is None


def test_pyenv_is_searched_behind_a_shim_that_does_not_run(dev: ModuleType, tmp_path: Path) -> None:
    fake_python(tmp_path / "bin/python3.13", "echo 'command not found' >&2; exit 127")
    real = fake_python(tmp_path / ".pyenv/versions/3.13.0/bin/python3.13", "echo 3.13 True")
    assert dev.interpreter("3.13") == (str(real), True)


def test_a_python_that_can_make_environments_is_preferred(dev: ModuleType, tmp_path: Path) -> None:
    bare = fake_python(tmp_path / "bin/python3.11", "echo 3.11 False")
    assert dev.interpreter("3.11") == (str(bare), False)
    whole = fake_python(tmp_path / ".pyenv/versions/3.11.7/bin/python3.11", "echo 3.11 True")
    assert dev.interpreter("3.11") == (str(whole), True)


def test_without_a_fitting_python_the_message_names_both_and_the_exit_code_is_two(
    dev: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(dev, "ROOT", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["dev.py", "render"])
    assert dev.main() == 2
    said = capsys.readouterr().out
    assert "3.11" in said
    assert "3.13" in said


def test_each_file_that_loads_bpy_has_a_process_of_its_own(dev: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    options, groups = dev.test_groups(["-k", "word", "--tb=short"])
    assert options == ["-k", "word", "--tb=short"]
    assert groups[:3] == [[os.path.join("tests", folder)] for folder in ("core", "render", "extreme")]
    files = sorted(str(p.relative_to(ROOT)) for p in (ROOT / "tests" / "blender").rglob("test_*.py"))
    assert groups[3:] == [[file] for file in files]


def test_named_paths_replace_the_whole_suite(dev: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    options, groups = dev.test_groups(["tests/scripts/test_dev.py", "tests/blender/test_extension.py::test_x", "-x"])
    assert options == ["-x"]
    assert groups == [
        [os.path.join("tests", "core", "test_dev.py")],
        [os.path.join("tests", "blender", "test_extension.py::test_x")],
    ]
