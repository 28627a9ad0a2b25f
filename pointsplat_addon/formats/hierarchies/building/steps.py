"""The steps of a build: each writes one file and returns what is said of it, and does nothing where that is there.

A step is a function of the build's folder, its plan and a number. Any process on any machine that sees the folder and
the inputs may do it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ....core.numeric.record import value_record
from ..pages import Layout
from .cells import layer_around
from .columns import attribute_codes, color_bytes
from .files import write_arrays, write_json
from .inputs import PARTS, Input, Part, read_part
from .octree import Cell, Cube, cube_of_cell
from .runs import Batch, Index, read_index, read_ranges, row_ranges, write_runs
from .subtree import Subtree, build_subtree


@value_record
class Plan:
    """What all steps of a build know."""

    inputs: tuple[Input, ...]
    tasks: tuple[tuple[Part, ...], ...]
    layout: Layout

    @property
    def columns(self) -> set[str]:
        """Columns that are read beside the position."""
        return {*(["color"] if self.layout.color else []), *(name for name, _ in self.layout.attributes)}


@value_record
class Work:
    """One step."""

    kind: str  # a name in STEPS
    folder: str
    number: int
    threads: bool = False  # whether it may use all processors


def do(work: Work) -> dict[str, Any]:
    """Does a step, unless its result is there. Returns what is said of the result."""
    folder = Path(work.folder)
    said = folder / f"{work.kind}-{work.number}.json"
    if not said.exists():
        write_json(said, STEPS[work.kind](folder, work))
    return json.loads(said.read_text())


# ---------------------------------------------------------------------------- plans


def plan_facts(plan: Plan) -> dict[str, Any]:
    inputs = [_values(one) for one in plan.inputs]
    tasks = [[[p.file, p.first, p.count] for p in parts] for parts in plan.tasks]
    layout = [plan.layout.color, plan.layout.normal, [list(a) for a in plan.layout.attributes]]
    return {"inputs": inputs, "tasks": tasks, "layout": layout}


def _values(one: Input) -> list[Any]:
    bounds = None if one.bounds is None else list(one.bounds)
    return [
        one.path,
        one.size,
        one.modified,
        one.count,
        bounds,
        one.crs,
        one.color,
        list(one.attributes),
        one.divisible,
    ]


@lru_cache(maxsize=4)
def _read_plan(path: str, modified: int) -> Plan:
    facts = json.loads(Path(path).read_text())
    inputs = tuple(
        Input(p, s, m, n, None if b is None else tuple(b), crs, color, tuple(names), divisible)
        for p, s, m, n, b, crs, color, names, divisible in facts["inputs"]
    )
    color, normal, attributes = facts["layout"]
    layout = Layout(color, normal, tuple((name, kind) for name, kind in attributes))
    return Plan(inputs, tuple(tuple(Part(*part) for part in parts) for parts in facts["tasks"]), layout)


def read_plan(folder: Path) -> Plan:
    path = folder / "plan.json"
    return _read_plan(str(path), path.stat().st_mtime_ns)


# ---------------------------------------------------------------------------- points of files


def _pieces(plan: Plan, parts: tuple[Part, ...], threads: bool, bright: set[int], said: dict) -> Iterator[Batch]:
    """Points of files in the types that the hierarchy keeps, without those whose position is not finite. Files whose
    colours have 16 bits are added to `bright`."""
    for part in parts:
        one = plan.inputs[part.file]
        whole: list[Batch] | None = [] if part.count is None and one.count <= PARTS else None
        for chunk in read_part(one, part, plan.columns, threads):
            piece = _piece(plan, chunk, part.file, bright, said)
            if whole is None:
                yield piece
            else:
                whole.append(piece)
        for piece in whole or ():
            if piece.dark >= 0 and part.file in bright:
                piece.columns["color"][:] = 0
            yield Batch(piece.position, piece.columns)


def _piece(plan: Plan, chunk: dict[str, np.ndarray], file: int, bright: set[int], said: dict) -> Batch:
    position = chunk["position"]
    columns: dict[str, np.ndarray] = {}
    dark = -1
    if plan.layout.color:
        if "color" in chunk:
            columns["color"], narrow = color_bytes(chunk["color"])
            dark = file if narrow else -1
            if not narrow and chunk["color"].dtype.itemsize > 1 and chunk["color"].dtype.kind != "f":
                bright.add(file)
        else:
            columns["color"] = np.full((len(position), 3), 255, np.uint8)
    for name, kind in plan.layout.attributes:
        given = chunk.get(name)
        columns[name] = np.zeros(len(position), kind) if given is None else attribute_codes(given, kind)
    if not np.isfinite(position.sum()):
        finite = np.isfinite(position).all(axis=1)
        said["dropped"] = said.get("dropped", 0) + int(np.count_nonzero(~finite))
        position, columns = position[finite], {name: column[finite] for name, column in columns.items()}
    return Batch(position, columns, dark)


def _measure(folder: Path, work: Work) -> dict[str, Any]:
    """Bounds of the points of a task, for files whose headers do not tell them."""
    plan = read_plan(folder)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in plan.tasks[work.number]:
        for chunk in read_part(plan.inputs[part.file], part, set(), work.threads):
            position = chunk["position"][np.isfinite(chunk["position"]).all(axis=1)]
            if len(position):
                low, high = np.minimum(low, position.min(axis=0)), np.maximum(high, position.max(axis=0))
    return {"bounds": [low.tolist(), high.tolist()] if np.isfinite(low).all() else None}


def read_cube(folder: Path) -> Cube:
    low, edge, depth = json.loads((folder / "cube.json").read_text())
    return Cube(tuple(low), edge, depth)


def _sort(folder: Path, work: Work) -> dict[str, Any]:
    """Sorts the points of a task into runs."""
    plan = read_plan(folder)
    bright: set[int] = set()
    said: dict[str, Any] = {}
    pieces = _pieces(plan, plan.tasks[work.number], work.threads, bright, said)
    found = write_runs(pieces, read_cube(folder), folder, f"sort-{work.number}")
    return {**said, **found, "bright": sorted(bright)}


# ---------------------------------------------------------------------------- chunks


@lru_cache(maxsize=2)
def _indices(folder: str, modified: int) -> tuple[Index, ...]:
    runs = json.loads((Path(folder) / "runs.json").read_text())
    return tuple(read_index(Path(folder) / name) for name in runs)


def indices_of(folder: Path) -> tuple[Index, ...]:
    """The indices of all runs, of which runs.json has the names."""
    return _indices(str(folder), (folder / "runs.json").stat().st_mtime_ns)


def points_in(folder: Path, low: np.ndarray, high: np.ndarray, names: list[str], bright: set[int]) -> Batch:
    """All points of cells in ranges of codes: from low (R,) to high, rising."""
    parts: list[Batch] = []
    for index in indices_of(folder):
        ranges = row_ranges(*index.ranges(low, high))
        if ranges:
            parts += read_ranges(index.path, ranges, names, bright)
    columns = {name: np.concatenate([p.columns[name] for p in parts]) for name in (names if parts else ())}
    return Batch(np.concatenate([p.position for p in parts]) if parts else np.empty((0, 3)), columns)


def _chunk(folder: Path, work: Work) -> dict[str, Any]:
    """Builds the pages of some chunks."""
    plan, cube = read_plan(folder), read_cube(folder)
    facts = json.loads((folder / "chunks.json").read_text())
    bright = set(facts["bright"])
    names = [name for name, _ in plan.layout.attributes] + (["color"] if plan.layout.color else [])
    parts = []
    for level, code, count in facts["groups"][work.number]:
        cell = Cell(level, code, count)
        first, stop = cell.range(cube.depth)
        points = points_in(folder, np.array([first]), np.array([stop]), names, bright)
        if plan.layout.normal:
            points.columns["normal"] = _normals(folder, cell, cube, points)
        parts.append(build_subtree(plan.layout, points, *cube_of_cell(cube, cell)))
    write_subtrees(folder / f"chunk-{work.number}.pages", parts)
    return {"bytes": sum(len(blob) for part in parts for blob in part.blobs)}


def _normals(folder: Path, cell: Cell, cube: Cube, points: Batch) -> np.ndarray:
    """Normals (N, 3) of a chunk's points, from neighbours within and around it."""
    from .normals import MARGIN, normals_of

    low, edge = cube_of_cell(cube, cell)
    around = points_in(folder, *layer_around(cell, cube.depth), [], set())
    # Chunks of some hundred thousand points are some hundred of them wide.
    width = MARGIN * edge / max(len(points.position), 1) ** 0.5
    near = ((around.position >= low - width) & (around.position <= low + edge + width)).all(axis=1)
    all_points = np.concatenate([points.position, around.position[near]])
    return normals_of((all_points - low).astype(np.float32))[: len(points.position)]


def write_subtrees(path: Path, parts: list[Subtree]) -> None:
    offset = np.cumsum([0, *(sum(len(b) for b in p.blobs) for p in parts)])
    pages = [p.pages.copy() for p in parts]
    for some, at in zip(pages, offset[:-1], strict=True):
        some["offset"] += np.uint64(at)
    arrays = {
        "pages": np.concatenate(pages),
        "first": np.cumsum([0, *(len(p) for p in pages)]),
        "element": np.cumsum([0, *(p.top.rows.shape[1] for p in parts)]),
        "rows": np.concatenate([np.ascontiguousarray(p.top.rows.T) for p in parts]),
    }
    arrays |= {f"class {n}": np.concatenate([p.top.classes[n] for p in parts]) for n in parts[0].top.classes}
    # What is read as a whole in the end comes last.
    arrays["blobs"] = np.frombuffer(b"".join(b for p in parts for b in p.blobs), np.uint8)
    write_arrays(path, arrays, {"saturation": [p.saturation for p in parts]})


STEPS: dict[str, Callable[[Path, Work], dict[str, Any]]] = {"measure": _measure, "sort": _sort, "chunk": _chunk}
