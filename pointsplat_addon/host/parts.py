"""One picture drawn in parts by several processes, and joined by one: what scripts/render.py asks for.

The parts lie in a folder: of each view layer and part a file that holds the rectangles which are drawn and, by pass,
their scene-linear pixels. Blender joins them before it composites, so that the picture is that of one process.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..core.numeric.record import value_record
from ..render.plan.request import Result

REPORT, DRAWN = "report", "drawn"  # in a file, beside the passes


class PartError(Exception):
    """Parts that make no picture; the message says why."""


@value_record
class Parts:
    """The parts of a picture."""

    folder: Path
    count: int
    index: int | None  # of the part that is drawn, from 0; None: all are there, and joined

    def path(self, layer: int, index: int) -> Path:
        """The file of a part of the view layer with that index."""
        return self.folder / f"layer{layer}_{index + 1}_of_{self.count}.npz"


asked: Parts | None = None  # None: pictures are drawn whole


def save(parts: Parts, layer: int, result: Result) -> None:
    """Write what was drawn of a part. Readers see the whole file or none. OSError: it cannot be written."""
    assert parts.index is not None
    path = parts.path(layer, parts.index)
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = result.drawn or ()
    pixels = {
        name: np.concatenate([array[y:up, x:right].reshape(-1, array.shape[2]) for x, y, right, up in drawn])
        for name, array in result.pixels.items()
    }
    held = {REPORT: np.array(json.dumps(result.report)), DRAWN: np.array(drawn, np.int64).reshape(-1, 4)}
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with part.open("wb") as file:
            np.savez(file, **held, **{f"pass_{name}": array for name, array in pixels.items()})  # pyright: ignore[reportArgumentType]
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def joined(parts: Parts, layer: int, size: tuple[int, int], lines: Callable[[str], None]) -> Result:
    """The picture of `size` (width, height) whose parts are all there.

    `lines` is told which part is read. PartError: one is missing or damaged, or they leave a pixel open."""
    width, height = size
    pixels: dict[str, np.ndarray] = {}
    report: dict[str, Any] = {}
    covered = np.zeros((height, width), np.uint8)
    for index in range(parts.count):
        path = parts.path(layer, index)
        lines(f"Joining part {index + 1} of {parts.count}")
        try:
            with np.load(path, allow_pickle=False) as held:
                drawn, told = held[DRAWN].tolist(), json.loads(str(held[REPORT]))
                found = {name.removeprefix("pass_"): held[name] for name in held.files if name.startswith("pass_")}
            at = 0
            for x, y, right, up in drawn:
                covered[y:up, x:right] += 1
                area = (up - y) * (right - x)
                for name, rows in found.items():
                    picture = pixels.setdefault(name, np.empty((height, width, rows.shape[1]), np.float32))
                    picture[y:up, x:right] = rows[at : at + area].reshape(up - y, right - x, -1)
                at += area
        except FileNotFoundError:
            raise PartError(f"part {index + 1} of {parts.count} is missing: {path}") from None
        except (OSError, ValueError, KeyError) as error:
            raise PartError(f"part {index + 1} of {parts.count} cannot be read: {path}: {error}") from error
        if drawn and not report:
            report = told
    if not (covered == 1).all():
        raise PartError(f"the {parts.count} parts in {parts.folder} are not of one picture of {width} x {height}")
    return Result(pixels, report)
