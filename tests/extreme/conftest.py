"""Stiff and extreme cases: what each has to hold, and what was measured.

`pytest tests/extreme --stability=docs/notes/stability.md` writes the table of cases, bounds and worst errors into that
file, between the markers that it has for it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"
# The same examples in every run: what fails on one machine fails on all of them, and is printed with its blob.
QUIET = {"deadline": None, "derandomize": True, "database": None, "print_blob": True,
         "suppress_health_check": list(HealthCheck)}  # fmt: skip
settings.register_profile("extreme", max_examples=20, **QUIET)
settings.register_profile("long", max_examples=500, **QUIET)
settings.load_profile("extreme")

ROWS: dict[tuple[str, str, str], tuple[float, float, str]] = {}
Within = Callable[..., None]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--stability", help="a file into which the table of cases, bounds and worst errors is written")


@pytest.fixture
def within(request: pytest.FixtureRequest) -> Within:
    """`within(case, what holds, measured, bound)`: fails where the measured error is beyond its bound, and keeps the
    worst of all that were measured for a case."""

    def check(case: str, holds: str, measured: Any, bound: float) -> None:
        worst = float(np.max(measured))
        assert worst <= bound, f"{case}: {holds}: {worst:g} is beyond {bound:g}"
        key = (request.path.name, case, holds)
        known = ROWS.get(key, (bound, -np.inf, ""))
        mark = "yes" if request.node.get_closest_marker("long") else ""
        ROWS[key] = max(known[0], bound), max(known[1], worst), mark

    return check


def pytest_sessionfinish(session: pytest.Session) -> None:
    target = session.config.getoption("--stability", default=None)
    if target and ROWS:
        write_table(Path(target))


def write_table(path: Path) -> None:
    """Replace what stands between the markers of a file; rows of files that did not run stay, and so do those that only
    --long measures."""
    before, rest = path.read_text().split(BEGIN)
    table, after = rest.split(END)
    found = {file for file, _, _ in ROWS}
    rows: dict[tuple[str, str, str], str] = {}
    for line in table.strip().splitlines()[2:]:
        case, holds, _, _, mark, file = (cell.strip() for cell in line.strip("| ").split(" | "))
        if file not in found or mark == "yes":
            rows[file, case, holds] = line
    for (file, case, holds), (bound, worst, mark) in ROWS.items():
        # Measured -0.0 is 0.
        rows[file, case, holds] = f"| {case} | {holds} | {bound:.2g} | {worst + 0.0:.2g} | {mark or 'no'} | {file} |"
    lines = ["| case | what holds | bound | worst measured | only with --long | test |", "|---|---|---|---|---|---|"]
    path.write_text("\n".join([before + BEGIN, *lines, *(rows[key] for key in sorted(rows)), END + after]))
