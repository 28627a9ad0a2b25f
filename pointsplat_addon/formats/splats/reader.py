"""What all readers of captured splats offer: a header, and the splats in chunks.

As for scans, a reader takes nothing for granted that a file says of itself: sizes are compared with the bytes that
there are before memory is allocated for them. Values that cannot be drawn are left out and counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, Self

import numpy as np

from ...core.numeric.record import record
from ...core.numeric.vectors import each_block
from ...core.scene.captured import COEFFICIENTS, CapturedSplats
from ..points.reader import OpenFile, PointFileError
from .axes import Y_DOWN

CHUNK = 1 << 18  # splats
BLOCK = 1 << 13  # splats that a thread decodes at once: what is in between stays in the processor's cache
C0 = 0.28209479177387814  # the real spherical harmonic of degree 0
DEGREES = {0: 0, **{count: degree for degree, count in enumerate(COEFFICIENTS, 1)}}  # by numbers of coefficients


@record
class SplatHeader:
    """What a file says of its splats before they are read."""

    path: Path
    format: str  # for people: "SPZ 4"
    count: int  # splats, of which some may be left out
    coefficients: int = 0  # of higher degrees, 0 or one of COEFFICIENTS
    antialiased: bool = False
    axes: str = Y_DOWN  # see axes.py
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # which positions are relative to


class Decoded(NamedTuple):
    """Arrays that a block of splats is decoded into: those of CapturedSplats, (n, ...) float32."""

    position: np.ndarray
    scale: np.ndarray
    rotation: np.ndarray  # w, x, y, z of any length
    base: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray  # (n, K, 3)

    def part(self, rows: slice) -> Decoded:
        return Decoded(*(array[rows] for array in self))


class SplatReader(OpenFile, Protocol):
    """An open file."""

    header: SplatHeader
    dropped: int  # splats that were left out by what was read so far
    unturned: int  # splats whose quaternion is zero, so that they are not turned
    warnings: list[str]

    def chunks(self, size: int = CHUNK) -> Iterator[CapturedSplats]:
        """Yields the splats in order, at most `size` at a time, in the file's axes relative to the header's origin.

        Raises PointFileError where the file is damaged, after the chunks before that place.
        """
        ...


class BlockReader:
    """What readers share whose splats can be decoded in any order: they decode blocks, in several threads."""

    header: SplatHeader

    def __init__(self) -> None:
        self.dropped = self.unturned = 0
        self.warnings: list[str] = []

    def decode(self, first: int, out: Decoded) -> None:
        """Decodes the splats from `first` on, as many as `out` holds."""
        raise NotImplementedError

    def chunks(self, size: int = CHUNK) -> Iterator[CapturedSplats]:
        self.dropped = self.unturned = 0
        for first in range(0, self.header.count, size):
            yield self._chunk(first, min(size, self.header.count - first))

    def _chunk(self, first: int, count: int) -> CapturedSplats:
        """The splats that can be drawn among `count` ones."""
        shapes = (3,), (3,), (4,), (3,), (), (self.header.coefficients, 3)
        out = Decoded(*(np.empty((count, *shape), np.float32) for shape in shapes))
        kept = np.ones(count, bool)
        unturned = np.zeros(count, bool)

        def work(rows: slice) -> None:
            part = out.part(rows)
            with np.errstate(all="ignore"):  # numbers beyond what their types hold: left out below
                self.decode(first + rows.start, part)
                unturned[rows] = normalise(part.rotation)
            if not all(np.isfinite(array).all() for array in part):
                kept[rows] = np.logical_and.reduce([_finite(array) for array in part])

        each_block(count, work, BLOCK)
        self.unturned += int(np.count_nonzero(unturned & kept))
        if not kept.all():
            self.dropped += int(count - np.count_nonzero(kept))
            out = Decoded(*(array[kept] for array in out))
        sh = out.sh if self.header.coefficients else None
        origin = np.array(self.header.origin, np.float64)
        return CapturedSplats(*out[:5], sh=sh, origin=origin, antialiased=self.header.antialiased)

    def close(self) -> None:
        """Closes the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _finite(array: np.ndarray) -> np.ndarray:
    """(n,) bool: rows that are numbers."""
    return np.isfinite(array.reshape(len(array), -1)).all(axis=1)


def normalise(rotation: np.ndarray) -> np.ndarray:
    """Makes quaternions (n, 4) unit ones in place, zeros the identity; returns which were zero, (n,) bool."""
    square = np.einsum("ij,ij->i", rotation, rotation)
    extreme = (square < 1e-30) | (square > 1e30)  # a float32's square loses digits or overflows
    if extreme.any():
        rotation[extreme] /= np.maximum(np.abs(rotation[extreme]).max(axis=1, keepdims=True), np.float32(1e-38))
        square[extreme] = np.einsum("ij,ij->i", rotation[extreme], rotation[extreme])
    zero = square == 0
    if zero.any():
        rotation[zero] = (1, 0, 0, 0)
        square[zero] = 1
    rotation /= np.sqrt(square)[:, None]
    return zero


def sigmoid(logit: np.ndarray, out: np.ndarray) -> None:
    """Opacities of logits (n,): of plus infinity 1, of minus infinity no number."""
    np.negative(logit, out=out)
    lost = np.isposinf(out)
    np.exp(out, out=out)
    out += 1
    np.reciprocal(out, out=out)
    if lost.any():
        out[lost] = np.nan


def exponential(log: np.ndarray, out: np.ndarray) -> None:
    """Scales of their logarithms (n, ...): of infinite ones no number."""
    np.exp(log, out=out)
    lost = np.isneginf(log)
    if lost.any():
        out[lost] = np.nan


def coefficients_of(color: np.ndarray, out: np.ndarray) -> None:
    """Coefficients of degree 0 of display values (n, 3) that have no other degrees."""
    np.subtract(color, np.float32(0.5), out=out)
    out *= np.float32(1 / C0)


def messages(reader: SplatReader) -> list[str]:
    """Returns what a person should know of what was read."""
    found = list(reader.warnings)
    if reader.dropped:
        found.append(f"{reader.dropped:,} splats with values that are no numbers are left out")
    if reader.unturned:
        found.append(f"{reader.unturned:,} splats whose rotation is zero are not turned")
    return found


def checked_coefficients(path: Path, count: int) -> int:
    """Returns a number of coefficients. Raises PointFileError where it is not that of whole degrees up to 4."""
    if count not in DEGREES:
        raise PointFileError(path, f"has {count} coefficients of spherical harmonics, expected one of {[*DEGREES]}")
    return count
