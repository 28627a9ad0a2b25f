"""Builds a hierarchy on disk from scans of any size, in bounded memory.

1. The root's cube follows from headers, or from the points where headers do not know.
2. Points are sorted into runs by cells of its octree, with counts of points in each (`runs`).
3. Cells of at most a million points become chunks; their pages are built independently of each other (`subtree`).
4. Pages above the chunks are merged from these, and all are put into one file (`join`).

Each step's result is a file in the folder NAME.psh.building, which is there as a whole or not at all, and depends on
the inputs alone: whoever does the steps, in whatever order, and however often they are interrupted, the file is the
same to the byte.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np

from ....core.numeric.record import record, value_record
from ...points.reader import PointFileError, origin_of
from ..pages import Layout
from ..psh import VERSION
from .cells import CHUNK, chunks_of, groups_of
from .files import write_json
from .inputs import ATTRIBUTES, Input, inputs_of, tasks_of, warnings_of
from .join import join
from .octree import DEEPEST, DEPTH, Cell, cube_of
from .runs import merged_cells, run_path
from .steps import Plan, Work, indices_of, plan_facts, read_cube
from .workers import Progress, Workers, default_count, workers_of

STEP_MEMORY = 500 << 20  # bytes of a process that does steps, at most
OUTSIDE = 1e-3  # share of points outside of what headers say, from which on the points are measured


@value_record
class Settings:
    """What a person decides about a build."""

    memory: int  # bytes
    normals: bool = False
    attributes: tuple[str, ...] = ()  # of inputs.ATTRIBUTES
    workers: int = 0  # processes; 0: as many as there are processors
    scheduler: str | None = None  # address of a Dask scheduler, whose workers are used instead


@record
class Built:
    """What was built."""

    points: int
    dropped: int  # points without a finite position
    nbytes: int
    warnings: list[str] = field(default_factory=list)


def build(inputs: Sequence[Path], output: Path, settings: Settings, progress: Progress) -> Built:
    """Builds the hierarchy of scans, or goes on where an earlier build of the same was stopped.

    Raises PointFileError where an input is damaged, changes or has no points, ValueError where memory does not suffice
    for a single process, OSError; then what was done stays in the folder for the next try.
    """
    count = min(settings.workers or default_count(), settings.memory // STEP_MEMORY)
    if count < 1:
        raise ValueError(f"a build needs {STEP_MEMORY >> 20} MB of memory, not {settings.memory >> 20}")
    folder = output.with_name(output.name + ".building")
    files = inputs_of(inputs, progress)
    plan = _plan(files, settings)
    _enter(folder, plan)
    workers = workers_of(count, settings.scheduler)
    try:
        return _Build(folder, plan, workers, progress).run(output)
    finally:
        workers.close()


def _plan(files: list[Input], settings: Settings) -> Plan:
    unknown = set(settings.attributes) - set(ATTRIBUTES)
    if unknown:
        raise ValueError(f"attributes are {', '.join(ATTRIBUTES)}, not {', '.join(sorted(unknown))}")
    kept = [(name, ATTRIBUTES[name]) for name in ATTRIBUTES if name in settings.attributes]
    kept = [(name, kind) for name, kind in kept if any(name in one.attributes for one in files)]
    layout = Layout(any(one.color for one in files), settings.normals, tuple(kept))
    return Plan(tuple(files), tuple(tasks_of(files)), layout)


def _enter(folder: Path, plan: Plan) -> None:
    """Makes the folder of a build, or finds that of an earlier one of the same; empties that of another."""
    facts = json.loads(json.dumps({"version": VERSION, **plan_facts(plan)}))
    path, old = folder / "plan.json", _finished(folder)
    if old.exists():
        shutil.rmtree(old)
    if path.exists():
        try:
            if json.loads(path.read_text()) == facts:
                return
        except ValueError:
            pass
        _forget(folder)
    elif folder.exists() and any(folder.iterdir()):
        if not (folder / "begun").exists():
            raise FileExistsError(f"{folder} is there, and no build has made it")
        _forget(folder)
    folder.mkdir(exist_ok=True)
    (folder / "begun").touch()
    write_json(path, facts)


def _finished(folder: Path) -> Path:
    """What a folder is called while it is deleted, so that no build takes what is left for its own."""
    return folder.with_name(folder.name + ".finished")


def _forget(folder: Path) -> None:
    folder.rename(_finished(folder))
    shutil.rmtree(_finished(folder))


class _Build:
    """One build."""

    def __init__(self, folder: Path, plan: Plan, workers: Workers, progress: Progress) -> None:
        self.folder, self.plan, self.workers, self.progress = folder, plan, workers, progress
        self.warnings = warnings_of(plan.inputs)

    def run(self, output: Path) -> Built:
        self._cube()
        sorted_ = self._sorted()
        points = sum(s["points"] for s in sorted_)
        if points == 0:
            raise PointFileError(Path(self.plan.inputs[0].path), "has no points")
        groups, bounds = self._groups(sorted_)
        cube = read_cube(self.folder)
        self._steps("chunk", range(len(groups)), "Pages")
        for run in self.folder.glob("*.run"):
            run.unlink()
        crs = next((one.crs for one in self.plan.inputs if one.crs), "")
        facts = {"points": points, "origin": origin_of(np.array(bounds)).tolist(), "crs": crs}
        join(output, self.folder, self.plan.layout, cube, groups, facts, lambda share: self.progress("File", share))
        _forget(self.folder)
        dropped = sum(s.get("dropped", 0) for s in sorted_)
        if dropped:
            self.warnings.append(f"{dropped:,} points have no finite position, and are left out")
        return Built(points, dropped, output.stat().st_size, self.warnings)

    def _steps(self, kind: str, numbers: Sequence[int], stage: str) -> list[dict[str, Any]]:
        """Results of steps, in the order of their numbers."""
        found: dict[int, dict[str, Any]] = {}
        self.progress(stage, 0.0)
        for number, said in self.workers.run([Work(kind, str(self.folder), number) for number in numbers]):
            found[number] = said
            self.progress(stage, len(found) / len(numbers))
        return [found[number] for number in numbers]

    def _cube(self) -> None:
        """Writes the cube of the root, as far as headers tell, or as it was measured."""
        path, better = self.folder / "cube.json", self.folder / "cube.next"
        if better.exists():
            self._sort_again(better)
        if not path.exists():
            unknown = [
                i
                for i, parts in enumerate(self.plan.tasks)
                if any(self.plan.inputs[p.file].bounds is None for p in parts)
            ]
            boxes = [np.reshape(one.bounds, (2, 3)) for one in self.plan.inputs if one.bounds is not None]
            if unknown:
                measured = self._steps("measure", unknown, "Bounds")
                boxes += [np.array(m["bounds"]) for m in measured if m["bounds"] is not None]
            self._write_cube(path, boxes or [np.zeros((2, 3))])

    def _write_cube(self, path: Path, boxes: Sequence[np.ndarray], depth: int = DEPTH) -> None:
        cube = cube_of(np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0))
        write_json(path, [list(cube.low), cube.edge, depth])

    def _sorted(self) -> list[dict[str, Any]]:
        """What is said of the tasks' runs. Where many points lie outside of the cube, or too many in one of its cells,
        all is done again with the cube of the points and finer cells."""
        found = self._steps("sort", range(len(self.plan.tasks)), "Points")
        points = sum(s["points"] for s in found)
        outside = sum(s["outside"] for s in found) > OUTSIDE * points
        if outside:
            self.warnings.append("Many points lie outside of the bounds that headers name; they are read once more")
        depth = read_cube(self.folder).depth
        if points and (outside or (depth == DEPTH and self._is_crowded(found))):
            better = self.folder / "cube.next"
            boxes = [np.array(s["bounds"]) for s in found if s["bounds"] is not None]
            self._write_cube(better, boxes, DEPTH if outside else DEEPEST)
            self._sort_again(better)
            return self._sorted()
        return found

    def _is_crowded(self, sorted_: list[dict[str, Any]]) -> bool:
        """Tells whether a cell of the finest level has more points than a chunk should."""
        if (self.folder / "chunks.json").exists():
            return False
        self._write_runs(sorted_)
        return bool((merged_cells(indices_of(self.folder))[1] > CHUNK).any())

    def _write_runs(self, sorted_: list[dict[str, Any]]) -> None:
        names = [run_path(self.folder, f"sort-{i}", k).name for i, s in enumerate(sorted_) for k in range(s["runs"])]
        write_json(self.folder / "runs.json", names)

    def _sort_again(self, better: Path) -> None:
        """Forgets all runs, and then takes the cube that was measured."""
        for path in [*self.folder.glob("sort-*.json"), *self.folder.glob("*.run")]:
            path.unlink()
        better.replace(self.folder / "cube.json")

    def _groups(self, sorted_: list[dict[str, Any]]) -> tuple[list[list[Cell]], list[list[float]]]:
        """The chunks of each task, and the bounds of all points."""
        path = self.folder / "chunks.json"
        if not path.exists():
            self._write_runs(sorted_)
            depth = read_cube(self.folder).depth
            groups = groups_of(chunks_of(*merged_cells(indices_of(self.folder)), depth))
            bright = sorted({file for s in sorted_ for file in s["bright"]})
            boxes = np.array([s["bounds"] for s in sorted_ if s["bounds"] is not None])
            bounds = [boxes[:, 0].min(axis=0).tolist(), boxes[:, 1].max(axis=0).tolist()]
            listed = [[[c.level, c.code, c.points] for c in group] for group in groups]
            write_json(path, {"groups": listed, "bright": bright, "bounds": bounds})
        facts = json.loads(path.read_text())
        return [[Cell(*c) for c in group] for group in facts["groups"]], facts["bounds"]
