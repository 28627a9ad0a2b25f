"""Who does the steps of a build: this process, several on this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Protocol

from ....core.numeric import vectors
from .steps import Work, do

RETRIES = 3  # of steps whose worker died
AHEAD = 2  # steps for each worker that are handed out at once


class Workers(Protocol):
    """Does the steps of a build, here or elsewhere."""

    def run(self, works: Sequence[Work]) -> Iterator[tuple[int, dict[str, Any]]]:
        """Does all steps, in any order; yields the number and the result of each that is done. Raises what a step
        raises."""
        ...

    def close(self) -> None: ...


class Alone:
    """This process."""

    def run(self, works: Sequence[Work]) -> Iterator[tuple[int, dict[str, Any]]]:
        for work in works:
            yield work.number, do(Work(work.kind, work.folder, work.number, threads=True))

    def close(self) -> None:
        pass


class Processes:
    """Several processes of this machine, of one thread each."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self._count, mp_context=context, initializer=_single_thread)

    def run(self, works: Sequence[Work]) -> Iterator[tuple[int, dict[str, Any]]]:
        left = list(reversed(works))
        waiting: dict[Future, Work] = {}
        deaths = 0
        while left or waiting:
            try:
                while left and len(waiting) < AHEAD * self._count:
                    waiting[self._pool.submit(do, left[-1])] = left[-1]
                    left.pop()
                done, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    work = waiting[future]
                    found = future.result()
                    del waiting[future]
                    yield work.number, found
            except BrokenProcessPool:
                # A worker died. What the others had begun is begun again.
                deaths += 1
                if deaths > RETRIES:
                    raise
                left += waiting.values()
                waiting = {}
                self._pool.shutdown(wait=True, cancel_futures=True)
                self._pool = self._new()

    def close(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)


class Dask:
    """The workers of a cluster of dask.distributed. They see the build's folder and the inputs under the same paths."""

    def __init__(self, address: str) -> None:
        """Raises ImportError where Dask is not installed, OSError where no scheduler answers."""
        from distributed import Client

        self._client = Client(address)

    def run(self, works: Sequence[Work]) -> Iterator[tuple[int, dict[str, Any]]]:
        from distributed import as_completed

        left = list(reversed(works))
        numbers: dict[Any, int] = {}
        done = as_completed()

        def hand_out() -> None:
            threads = sum(self._client.nthreads().values()) or 1
            while left and len(numbers) < AHEAD * threads:
                work = left.pop()
                future = self._client.submit(do, work, pure=False, retries=RETRIES)
                numbers[future.key] = work.number
                done.add(future)

        hand_out()
        while numbers:
            future = next(done)
            yield numbers.pop(future.key), future.result()
            hand_out()

    def close(self) -> None:
        self._client.close()


def _single_thread() -> None:
    vectors.MOST_THREADS = 1


def workers_of(count: int, scheduler: str | None) -> Workers:
    """Raises ImportError and OSError, see `Dask`."""
    if scheduler:
        return Dask(scheduler)
    return Processes(count) if count > 1 else Alone()


def default_count() -> int:
    return os.cpu_count() or 1


Progress = Callable[[str, float], None]  # the stage, and the share of it that is done
