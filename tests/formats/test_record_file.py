"""Files of records: what is read is what was written, and bad bytes are refused."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.numeric.record import record
from pointsplat_addon.formats import record_file, whole_file
from pointsplat_addon.formats.record_file import RecordError

ROOT = Path(__file__).resolve().parents[2]


@record
class Inner:
    name: str
    values: np.ndarray


@record
class Outer:
    parts: tuple[Inner, ...]
    named: dict
    number: float
    exact: np.float64
    nothing: None = None


CLASSES = {"Inner": Inner, "Outer": Outer}
DTYPES = "u1", "bool", "f2", "i4", "u4", "f4", "i8", "f8"


def item() -> Outer:
    rng = np.random.default_rng(3)
    shapes = (5,), (0, 3), (3, 2), (), (2, 3, 4), (1, 2, 1, 3), (7,), (11,)
    parts = tuple(
        Inner(name, rng.integers(0, 2, shape).astype(name)) for name, shape in zip(DTYPES, shapes, strict=True)
    )
    bits = np.array([0x7FC00001, 0xFFFFFFFF, 0x00000001, 0x80000000], np.uint32).view(np.float32)
    named = {"bits": bits, "flag": True, "count": 2**53, "other way": np.arange(12.0).reshape(3, 4).T}
    return Outer(parts, named, float("inf"), np.float64(0.1))


def assert_same(found: object, expected: object) -> None:
    assert type(found) is type(expected)
    if isinstance(expected, np.ndarray | np.generic):
        assert isinstance(found, np.ndarray | np.generic)
        assert (found.dtype, found.shape, found.tobytes()) == (expected.dtype, expected.shape, expected.tobytes())
    elif isinstance(expected, tuple):
        assert isinstance(found, tuple)
        for one, other in zip(found, expected, strict=True):
            assert_same(one, other)
    elif isinstance(expected, dict):
        assert isinstance(found, dict)
        assert list(found) == list(expected)
        for name in expected:
            assert_same(found[name], expected[name])
    elif isinstance(expected, Inner | Outer):
        for f in fields(expected):
            assert_same(getattr(found, f.name), getattr(expected, f.name))
    else:
        assert found == expected


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "new" / "item.psitem"
    assert record_file.read(path, CLASSES) is None
    record_file.write(path, item())
    assert_same(record_file.read(path, CLASSES), item())
    assert list(path.parent.iterdir()) == [path]


def test_arrays_of_several_pieces_have_one_checksum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(1).random(5000)
    monkeypatch.setattr(record_file, "PIECE", 999)
    record_file.write(tmp_path / "a", {"values": values, "again": values[:7]})
    assert_same(record_file.read(tmp_path / "a", {}), {"values": values, "again": values[:7]})


def test_damaged_and_truncated_files_are_refused(tmp_path: Path) -> None:
    path, bad = tmp_path / "item", tmp_path / "bad"
    record_file.write(path, item())
    content = path.read_bytes()
    for at in range(len(content)):
        bad.write_bytes(content[:at] + bytes([content[at] ^ (1 << at % 8)]) + content[at + 1 :])
        with pytest.raises(RecordError, match="bad"):
            record_file.read(bad, CLASSES)
        bad.write_bytes(content[:at])
        with pytest.raises(RecordError, match="bad"):
            record_file.read(bad, CLASSES)
    bad.write_bytes(content + b"\0")
    with pytest.raises(RecordError):
        record_file.read(bad, CLASSES)


@pytest.mark.parametrize(
    "header",
    [
        {"item": ["array", 0], "arrays": []},
        {"item": ["array", 0], "arrays": [["<f8", [2**60, 2**60]]]},
        {"item": ["array", 0], "arrays": [["<f8", [-1]]]},
        {"item": ["array", 0], "arrays": [["|O", [1]]]},
        {"item": ["record", "Path", {}], "arrays": []},
        {"item": ["record", "Inner", {"other": 1}], "arrays": []},
        {"item": ["module", 1], "arrays": []},
        {"item": [], "arrays": []},
        {"arrays": []},
        [],
    ],
)
def test_headers_that_nobody_wrote_are_refused(tmp_path: Path, header: object) -> None:
    text = record_file.json.dumps(header).encode()
    text += b" " * (-len(text) % record_file.ALIGNMENT)
    checksum = record_file._checksum(memoryview(text), [])
    fixed = record_file.FIXED.pack(record_file.MAGIC, record_file.VERSION, len(text), checksum)
    (tmp_path / "a").write_bytes(fixed + text)
    with pytest.raises(RecordError):
        record_file.read(tmp_path / "a", CLASSES)


@pytest.mark.parametrize("other", [object(), {"a": [1]}, np.zeros(2, object), (np.zeros((1,) * 5),)])
def test_what_cannot_be_kept_is_said_before_anything_is_written(tmp_path: Path, other: object) -> None:
    with pytest.raises(TypeError, match="not kept"):
        record_file.write(tmp_path / "a", other)
    assert not list(tmp_path.iterdir())


def test_a_write_that_fails_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record_file.write(tmp_path / "a", item())
    before = (tmp_path / "a").read_bytes()

    def full(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(whole_file.os, "replace", full)
    with pytest.raises(OSError, match="full"):
        record_file.write(tmp_path / "a", (1, 2))
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [before]


def test_trim_deletes_what_was_not_used_for_longest_with_its_lock(tmp_path: Path) -> None:
    paths = [tmp_path / f"{i}.psitem" for i in range(4)]
    for age, path in enumerate(paths):
        record_file.write(path, (path.stem, np.zeros(100)))
        path.with_suffix(".lock").touch()
        whole_file.os.utime(path, (age, age))
    (tmp_path / "other.txt").write_text("not ours")
    record_file.read(paths[0], {})
    size = paths[0].stat().st_size
    assert whole_file.trim(tmp_path, 2 * size, (".psitem", ".pshier")) == 2 * size
    assert [path.exists() for path in paths] == [True, False, False, True]
    assert [path.with_suffix(".lock").exists() for path in paths] == [True, False, False, True]
    assert (tmp_path / "other.txt").exists()


def test_the_version_of_the_code_is_known_without_numpy() -> None:
    """Scripts say how many threads NumPy may use before it is loaded."""
    code = "import sys; import pointsplat_addon.formats.code_version; print('numpy' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "False"
