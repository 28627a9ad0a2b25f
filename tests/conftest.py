"""Puts the repository's root on the path, so that tests import the package as it lies there; shares tests out."""

import sys
import zlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

# What these tests check does not depend on Blender, and hardly on the version of Python.
SHARED = tuple(ROOT / "tests" / room for room in ("core", "formats", "stream", "reference", "render", "extreme"))
# Pictures beside Cycles' and on both devices: each file has so many that both Pythons, and so both Blenders, draw some.
# In other files such tests are marked `either`.
SHARED_FILES = ROOT / "tests" / "blender" / "test_*_cycles.py", ROOT / "tests" / "blender" / "test_*devices*.py"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--share",
        metavar="I/N",
        help="of the tests that hardly depend on Blender and Python, only those whose names' hash is I modulo N",
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    share = config.getoption("--share")
    if not share:
        return
    index, count = map(int, share.split("/"))
    kept, rest = [], []
    for item in items:
        # The hash depends on the test's own name alone: other tests may come and go.
        shared = any(folder in item.path.parents for folder in SHARED)
        shared = shared or any(item.path.match(str(files)) for files in SHARED_FILES)
        shared = shared or item.get_closest_marker("either") is not None
        (rest if shared and zlib.crc32(item.nodeid.encode()) % count != index else kept).append(item)
    config.hook.pytest_deselected(items=rest)
    items[:] = kept
