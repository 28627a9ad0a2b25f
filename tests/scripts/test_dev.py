"""scripts/dev.py chooses a Python that bpy exists for, and says which test files share a process."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
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


def test_files_that_load_bpy_have_a_process_of_their_own_but_those_beside_cycles(
    dev: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    options, groups = dev.test_groups(["-k", "word", "--tb=short"])
    assert options == ["-k", "word", "--tb=short"]
    files = {str(p.relative_to(ROOT)) for p in (ROOT / "tests" / "blender").rglob("test_*.py")}
    beside = {file for file in files if file.endswith("_cycles.py")}
    alone = [group for group in groups if "blender" in group[0] and not beside.intersection(group)]
    assert sorted(alone) == [[file] for file in sorted(files - beside)]
    together = [group for group in groups if beside.intersection(group)]
    assert len(together) == dev.BESIDE_CYCLES
    assert sorted(file for group in together for file in group) == sorted(beside)
    costs = [dev.cost_of(group) for group in together]
    assert max(costs) <= min(costs) + max(dev.cost_of([file]) for file in beside)


def test_processes_of_tests_find_modules_compiled(dev: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where Python is told to leave no files; what a person has set stays."""
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.delenv("PYTHONPYCACHEPREFIX", raising=False)
    assert "PYTHONDONTWRITEBYTECODE" not in dev.test_environment(1)
    assert Path(dev.test_environment(1)["PYTHONPYCACHEPREFIX"]).is_relative_to(ROOT / ".venv")
    monkeypatch.setenv("PYTHONPYCACHEPREFIX", "elsewhere")
    monkeypatch.setenv("LP_NUM_THREADS", "7")
    environment = dev.test_environment(1)
    assert (environment["PYTHONPYCACHEPREFIX"], environment["LP_NUM_THREADS"]) == ("elsewhere", "7")


def test_the_groups_of_the_whole_suite_hold_every_test_file_once(
    dev: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    paths = [ROOT / path for group in dev.test_groups([])[1] for path in group]
    found = [file for path in paths for file in ([path] if path.is_file() else path.rglob("test_*.py"))]
    assert sorted(found) == sorted((ROOT / "tests").rglob("test_*.py"))
    assert dev.test_groups([])[1][0] == [os.path.join("tests", "render", "passes")]  # which takes longest


@pytest.mark.parametrize("pythons", [1, 2])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_each_group_runs_with_each_python_but_not_at_once(dev: ModuleType, count: int, pythons: int) -> None:
    groups = [[f"room {i}"] for i in range(count)]
    tasks = dev.in_turns(groups, pythons)
    assert sorted(tasks) == [(group, i) for group in groups for i in range(pythons)]
    begun = [group for group, _ in tasks]
    assert [group for i, group in enumerate(begun) if group not in begun[:i]] == groups  # the longest still come first
    if pythons == 2:  # those that begin at once are of two groups, but the last where their number is odd
        assert all(one != other for one, other in zip(begun[: count // 2 * 4 : 2], begun[1::2], strict=False))


def test_processes_run_side_by_side_and_one_that_hangs_is_killed(
    dev: ModuleType, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Each waits for the other's file: one after the other, both would hang."""
    for own, other in (("a", "b"), ("b", "a")):
        wait = f"open({str(tmp_path / own)!r}, 'w')\n    while not os.path.exists({str(tmp_path / other)!r}): pass\n"
        (tmp_path / f"test_{own}.py").write_text(f"import os\ndef test_{own}():\n    {wait}")
    (tmp_path / "test_hangs.py").write_text("def test_hangs():\n    while True: pass\n")
    tasks = [(sys.executable, ["-p", "no:cacheprovider"], [str(tmp_path / f"test_{n}.py")]) for n in ("a", "b")]
    assert [code for _, code in dev.run_all(tasks, 2, 300)] == [0, 0]
    hanging = [(sys.executable, [], [str(tmp_path / "test_hangs.py")])]
    assert [code for _, code in dev.run_all(hanging, 1, 4)] == [1]
    assert "killed after 4 s" in capfd.readouterr().out


def test_sigterm_ends_the_processes_of_tests_too(tmp_path: Path) -> None:
    marker = tmp_path / "pid"
    body = f"open({str(marker)!r}, 'w').write(f'{{os.getpid()}}\\n')\n    while True: pass\n"
    (tmp_path / "test_hangs.py").write_text(f"import os\ndef test_hangs():\n    {body}")
    # The script's `main`, with tasks that need no environment.
    code = (
        "import dev, sys\n"
        f"task = (sys.executable, ['-p', 'no:cacheprovider'], [{str(tmp_path / 'test_hangs.py')!r}])\n"
        "dev.VERBS['test'] = lambda args, rest: dev.run_all([task], 1, 300)\n"
        "sys.argv = ['dev.py', 'test']\n"
        "sys.exit(dev.main())"
    )
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT / "scripts", stdout=subprocess.DEVNULL)
    try:
        while not (marker.exists() and marker.read_text().endswith("\n")):
            assert process.poll() is None
            time.sleep(0.05)
        process.terminate()
        assert process.wait(60) == 128 + signal.SIGTERM
    finally:
        process.kill()
    with pytest.raises(ProcessLookupError):
        os.kill(int(marker.read_text()), 0)


def test_each_process_is_named_when_it_starts(
    dev: ModuleType, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for name in "ab":
        (tmp_path / f"test_{name}.py").write_text("def test(): pass\n")
    dev.run_all([(sys.executable, ["-p", "no:cacheprovider"], [str(tmp_path / f"test_{n}.py")]) for n in "ab"], 1, 300)
    started = [line for line in capfd.readouterr().out.splitlines() if line.startswith("dev: started ")]
    assert [line.split("/")[-1] for line in started] == ["test_a.py (1 of 2)", "test_b.py (2 of 2)"]


def test_a_process_that_crashes_runs_once_more(
    dev: ModuleType, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    marker = tmp_path / "crashed"
    crash = "    os.kill(os.getpid(), signal.SIGSEGV)\n"
    once = f"    if not os.path.exists({str(marker)!r}):\n        open({str(marker)!r}, 'w')\n    {crash}"
    for name, body in (("once", once), ("always", crash)):
        (tmp_path / f"test_{name}.py").write_text(f"import os, signal\ndef test_{name}():\n{body}")
    tasks = [(sys.executable, ["-p", "no:cacheprovider"], [str(tmp_path / f"test_{n}.py")]) for n in ("once", "always")]
    codes = {Path(name.split()[-1]).stem: code for name, code in dev.run_all(tasks, 1, 300)}
    assert codes == {"test_once": 0, "test_always": -signal.SIGSEGV}
    assert capfd.readouterr().out.count("CRASHED by signal 11") == 2


def test_shares_of_the_drawing_tests_have_no_test_twice_and_leave_none_out() -> None:
    def names(*options: str) -> list[str]:
        command = [sys.executable, "-m", "pytest", "--collect-only", "-qq", "-o", "addopts=", *options]
        paths = ["tests/render/plan/test_technique.py", "tests/scripts/test_beside_cycles.py"]
        out = subprocess.run([*command, "-v", *paths], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        return sorted(line for line in out.splitlines() if "::" in line)

    whole, shares = names(), [names("--share", f"{i}/2") for i in range(2)]
    both = [name for name in whole if "tests/scripts" in name]
    assert both
    assert set(shares[0]) & set(shares[1]) == set(both)
    assert sorted(set(shares[0]) | set(shares[1])) == whole
    assert all(len(share) < len(whole) for share in shares)


def test_named_paths_replace_the_whole_suite(dev: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    options, groups = dev.test_groups(["tests/scripts/test_dev.py", "tests/blender/test_extension.py::test_x", "-x"])
    assert options == ["-x"]
    assert sorted(groups) == [
        [os.path.join("tests", "blender", "test_extension.py::test_x")],
        [os.path.join("tests", "scripts", "test_dev.py")],
    ]
