"""Builds hierarchies on disk from within Blender: on a thread, so that a window stays alive meanwhile."""

from __future__ import annotations

import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

from ...formats.hierarchies.building.build import STEP_MEMORY, Built, Settings, build

POLL = 0.05  # seconds
# Where the work of a stage begins and ends, of all.
STAGES = {
    "Headers": (0.0, 0.01),
    "Bounds": (0.01, 0.05),
    "Points": (0.05, 0.5),
    "Pages": (0.5, 0.97),
    "File": (0.97, 1.0),
}


class StoppedError(Exception):
    """The build was stopped."""


def build_scan(
    paths: Sequence[Path], output: Path, normals: bool, attributes: tuple[str, ...]
) -> Generator[float, None, Built]:
    """Builds a hierarchy, or goes on where an earlier build of the same was stopped.

    Yields the share that is done. Closed before its end it stops behind the step at hand, within seconds; what was done
    stays beside the output for the next try. Raises what `building.build` raises.
    """
    stopped = threading.Event()
    share = 0.0

    def progress(stage: str, done: float) -> None:
        nonlocal share
        if stopped.is_set():
            raise StoppedError
        low, high = STAGES[stage]
        share = low + done * (high - low)

    # One process, this one: Blender's cannot be started again as others.
    settings = Settings(STEP_MEMORY, normals, attributes, workers=1)
    with ThreadPoolExecutor(1) as thread:
        building = thread.submit(build, paths, output, settings, progress)
        try:
            while not building.done():
                wait([building], POLL)
                yield share
        finally:
            stopped.set()
        return building.result()
