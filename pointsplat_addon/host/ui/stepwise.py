"""Operators that work step by step, so that the window stays alive and Esc cancels."""

from __future__ import annotations

import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import bpy

from ...formats.points.reader import PointFileError

SLICE = 0.1  # seconds of work between two looks at the window


class Stepwise:
    """What operators share that import files: a generator that yields the share which is done, and leaves nothing
    behind where it is closed."""

    noun: str  # of what is imported, in messages

    def finish(self, result: Any) -> None:
        """Reports what the generator returned."""
        raise NotImplementedError

    def start(self, context: Any, work: Generator[float, None, Any]) -> set[str]:
        """Does the work: at once, or in the background of a window that called the operator."""
        operator: Any = self
        self._work = work
        if context.window is None or bpy.app.background or not operator.options.is_invoke:
            result = None
            while result is None:
                result = self._step(1e9)
            return result
        manager = context.window_manager
        manager.progress_begin(0, 100)
        self._timer = manager.event_timer_add(0.02, window=context.window)
        manager.modal_handler_add(operator)
        context.workspace.status_text_set(f"Importing {self.noun}; Esc cancels")
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        operator: Any = self
        result = None
        if event.type == "ESC":
            self._work.close()
            operator.report({"INFO"}, "The import is cancelled")
            result = {"CANCELLED"}
        elif event.type == "TIMER":
            result = self._step(SLICE)
            context.window_manager.progress_update(100 * self._share)
        if result is None:
            return {"RUNNING_MODAL"}
        context.window_manager.progress_end()
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        return result

    def _step(self, seconds: float) -> set[str] | None:
        """Works on for a while; returns the operator's result once it is there."""
        operator: Any = self
        end = time.monotonic() + seconds
        try:
            while time.monotonic() < end:
                self._share = next(self._work)
        except StopIteration as done:
            self.finish(done.value)
            return {"FINISHED"}
        except (PointFileError, ValueError, OSError, MemoryError) as error:
            operator.report({"ERROR"}, str(error) or f"There is not enough memory for the {self.noun}")
            return {"CANCELLED"}
        return None

    def paths(self) -> list[Path]:
        """The files that were chosen: `files` in `directory`, else `filepath`."""
        operator: Any = self
        folder = Path(bpy.path.abspath(operator.directory)) if operator.directory else Path()
        named = [folder / item.name for item in operator.files if item.name]
        return named or [Path(bpy.path.abspath(operator.filepath))]

    _work: Generator[float, None, Any]
    _timer: Any = None
    _share = 0.0
