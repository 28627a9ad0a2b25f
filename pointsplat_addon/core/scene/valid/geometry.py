"""Removes points, triangles and strands of a geometry that cannot be drawn (the rules stand in ../validation.py)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...numeric.record import value_record
from ...numeric.segments import offsets, owners
from ...numeric.vectors import cross, dot, each_block
from ..cloud import FARTHEST, LENGTHS, PointCloud
from ..mesh import LARGEST, SMALLEST, Joined, Mesh, joined, squared_edges, triangle_corners
from ..strands import Strands

MOST_STRAND_POINTS = 1 << 24  # of one geometry: float32 counts no farther


# Points


def valid_points(cloud: PointCloud) -> tuple[PointCloud, int]:
    """Removes points with a NaN or an infinity in any attribute, or a length beyond FARTHEST; returns how many.

    A cloud without such points is returned itself. Velocities of that kind become zero. Where the origin is no
    position, all points go.
    """
    good = np.ones(len(cloud), bool)
    if not (np.abs(cloud.origin) <= FARTHEST).all():
        good[:] = False
        cloud = replace(cloud, origin=np.zeros(3))
    if cloud.velocity is not None and not (np.abs(cloud.velocity) <= FARTHEST).all():
        moves = (np.abs(cloud.velocity) <= FARTHEST).all(axis=1)
        cloud = replace(cloud, velocity=np.where(moves[:, None], cloud.velocity, np.float32(0)))
    for name, array in cloud.arrays().items():
        if array.dtype.kind != "f" or array.size == 0:
            continue
        most = FARTHEST if name in LENGTHS else np.finfo(np.float32).max
        # Row by row only where there is something to find: that takes many times as long. NaN compares as false.
        if not (array.min() >= -most and array.max() <= most):
            good &= (np.abs(array) <= most).all(axis=tuple(range(1, array.ndim)))
    dropped = len(cloud) - int(np.count_nonzero(good))
    return (cloud if dropped == 0 else cloud.take(good)), dropped


# Triangles


@value_record
class DroppedTriangles:
    """Counts of triangles that are not drawn, by reason. Each is counted once, under the first reason that holds."""

    bad_index: int = 0  # a corner refers to no vertex
    non_finite: int = 0  # a corner holds a NaN or an infinity
    huge: int = 0  # a coordinate beyond LARGEST
    tiny: int = 0  # all edges below SMALLEST
    degenerate: int = 0  # no area, or a height that is rounding noise

    @property
    def total(self) -> int:
        return self.bad_index + self.non_finite + self.huge + self.tiny + self.degenerate

    @property
    def message(self) -> str:
        """One warning, or "" where nothing was dropped."""
        reasons = {
            "with an index out of range": self.bad_index,
            "with NaN or infinite coordinates": self.non_finite,
            "too large": self.huge,
            "too small": self.tiny,
            "without area": self.degenerate,
        }
        parts = [f"{count} {reason}" for reason, count in reasons.items() if count]
        if not parts:
            return ""
        noun = "triangle is" if self.total == 1 else "triangles are"
        return f"{self.total} {noun} not drawn ({', '.join(parts)})"


def valid_mesh(mesh: Mesh) -> tuple[Mesh, DroppedTriangles]:
    """Removes triangles that cannot be drawn and moves vertices that are nowhere, which no other triangle uses, to a
    vertex that one uses. A mesh with nothing to change is returned itself.

    Samples are shared by poses of equal topology: it says which triangles are left.
    """
    valid, dropped = valid_triangles(mesh)
    position = mesh.position
    if len(position) and not (position.min() >= -LARGEST and position.max() <= LARGEST):
        nowhere = ~(np.abs(position) <= LARGEST).all(axis=1)
        position = position.copy()
        position[nowhere] = position[mesh.triangles[valid.argmax(), 0]] if valid.any() else 0
        mesh = replace(mesh, position=position)
    if dropped.total == 0:
        return mesh, dropped
    left = hashlib.blake2b(np.packbits(valid).tobytes(), digest_size=16).hexdigest()
    return replace(mesh.take(np.flatnonzero(valid)), topology=mesh.topology and f"{mesh.topology} {left}"), dropped


def valid_meshes(meshes: Sequence[Mesh]) -> list[tuple[Mesh, DroppedTriangles]]:
    """`valid_mesh` of each. Small meshes are looked at together, and each by itself where one of them has something to
    change."""
    whole = {row for some in joined(meshes) if _are_whole(some) for row in some.rows}
    return [(mesh, DroppedTriangles()) if row in whole else valid_mesh(mesh) for row, mesh in enumerate(meshes)]


def _are_whole(some: Joined) -> bool:
    count = np.diff(some.first)
    low, high = (np.repeat(ends, count)[:, None] for ends in (some.first_vertex[:-1], some.first_vertex[1:]))
    if not ((some.triangles >= low) & (some.triangles < high)).all():
        return False
    if not (some.position.min() >= -LARGEST and some.position.max() <= LARGEST):
        return False
    return valid_triangles(Mesh("", "", some.position, some.triangles))[1].total == 0


def valid_triangles(mesh: Mesh) -> tuple[np.ndarray, DroppedTriangles]:
    """Finds which triangles can be drawn, (T,) bool, and counts the others by reason.

    A triangle is degenerate when a quarter of the spacing of float32 numbers, at its corner opposite the longest
    edge and along each coordinate axis, is enough to flatten it. Needles that are exactly representable stay,
    whatever their aspect ratio; so do triangles a few such spacings large, far from the origin.
    """
    triangles, vertices = mesh.triangles, len(mesh.position)
    count = len(triangles)
    valid = np.ones(count, bool)
    if count == 0:
        return valid, DroppedTriangles()
    if triangles.min() < 0 or triangles.max() >= vertices:
        valid &= ((triangles >= 0) & (triangles < vertices)).all(axis=1)
    bad_index = count - int(np.count_nonzero(valid))

    dropped: list[list[int]] = []  # appending is safe from any thread

    def look(block: slice) -> None:
        rows = np.arange(block.start, block.stop)[valid[block]] if bad_index else block
        corners = triangle_corners(mesh, rows)
        extent = np.abs(corners).max(axis=0)  # per coordinate; NaN spreads
        largest = extent.max(axis=0)
        finite = np.isfinite(largest)
        small = largest <= LARGEST
        with np.errstate(invalid="ignore", over="ignore"):
            squared = squared_edges(corners)
            long_enough = squared.max(axis=0) >= SMALLEST**2
            flat = _degenerate(corners, squared, extent)
        kinds = ~finite, finite & ~small, small & ~long_enough, small & long_enough & flat
        dropped.append([int(np.count_nonzero(kind)) for kind in kinds])
        valid[rows] = small & long_enough & ~flat

    each_block(count, look)
    return valid, DroppedTriangles(bad_index, *(sum(kind) for kind in zip(*dropped, strict=True)))


def _degenerate(corners: np.ndarray, squared: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """(n,) bool: moving the apex by a quarter of a float32 spacing flattens the triangle."""
    normal = cross(corners[1] - corners[0], corners[2] - corners[0])
    longest = squared.max(axis=0)
    # Most triangles are far from flat. The cross product of a shift and the base is at most shift times base.
    shift = 0.25 * np.finfo(np.float32).eps * extent.max(axis=0)
    flat = ~(dot(normal, normal) > 9 * shift * shift * longest)
    rows = np.flatnonzero(flat)
    if len(rows):
        corners, extent, normal = corners[:, :, rows], extent[:, rows], normal[:, rows]
        apex = squared[:, rows].argmax(axis=0)
        every = np.arange(len(rows))
        base = np.abs(corners[(apex + 2) % 3, :, every] - corners[(apex + 1) % 3, :, every]).T
        shift = 0.25 * np.finfo(np.float32).eps * extent
        noise = np.stack(
            [shift[(c + 1) % 3] * base[(c + 2) % 3] + shift[(c + 2) % 3] * base[(c + 1) % 3] for c in (0, 1, 2)]
        )
        flat[rows] = (np.abs(normal) <= noise).all(axis=0)
    return flat


# Strands


def valid_strands(strands: Strands) -> tuple[Strands, tuple[str, ...]]:
    """Removes what of strands cannot be drawn, and returns messages that count it.

    A point that is not finite, or has such a radius or value, breaks its strand in two. Points at the position of the
    one before, strands with fewer than two points, and strands whose radius is 0 everywhere are removed; negative radii
    become 0. Strands with nothing to change are returned themselves.
    """
    position = np.asarray(strands.position, np.float32).reshape(-1, 3)[:MOST_STRAND_POINTS]
    count = len(position)
    whole = np.asarray(strands.start, np.int64)
    owner = owners(np.diff(whole))[:count]
    with np.errstate(invalid="ignore"):
        good = (np.abs(position) < FARTHEST).all(axis=1) & (np.abs(strands.radius[:count]) < FARTHEST)
    for value in (strands.color, strands.surface, strands.emission):
        if value is not None:
            good &= np.isfinite(value[:count]).all(axis=1)
    origin = np.asarray(strands.origin, float)
    if not (np.abs(origin) <= FARTHEST).all():
        good[:], origin = False, np.zeros(3)
    begins = np.ones(count, bool)
    begins[1:] = (owner[1:] != owner[:-1]) | ~good[:-1]
    repeated = np.zeros(count, bool)
    repeated[1:] = (position[1:] == position[:-1]).all(axis=1) & ~begins[1:]
    rows = np.flatnonzero(good & ~repeated)
    radius = np.maximum(np.asarray(strands.radius, np.float32)[rows], 0)
    run = np.cumsum(begins)[rows]
    number = np.bincount(run)
    several, wide = number > 1, np.bincount(run, radius) > 0
    found = np.zeros((2, len(whole) - 1), bool)  # strands as given: with two points somewhere, and drawn somewhere
    for strand, runs in zip(found, (several, several & wide), strict=True):
        strand[owner[rows[runs[run]]]] = True
    messages = (
        *_counted(int(np.count_nonzero(~good)), "point", "is not finite", "are not finite"),
        *_counted(int((~found[0]).sum()), "strand", "has less than two positions", "have less than two positions"),
        *_counted(int((found[0] & ~found[1]).sum()), "strand", "has no radius", "have no radius"),
        *([f"strands beyond {count} points are left out"] if len(strands.position) > count else []),
    )
    drawn = (several & wide)[run]
    rows, radius = rows[drawn], radius[drawn]
    start = offsets(number[several & wide])
    if len(rows) == len(strands.position) and np.array_equal(start, whole) and (radius == strands.radius).all():
        return strands, messages
    of_points = ("normal", "color", "surface", "emission")
    taken = {name: array[rows] for name in of_points if (array := getattr(strands, name)) is not None}
    of_strands = owner[rows[start[:-1]]]
    taken |= {name: array[of_strands] for name in ("uv", "material") if (array := getattr(strands, name)) is not None}
    return replace(strands, position=position[rows], start=start, radius=radius, origin=origin, **taken), messages


def _counted(number: int, what: str, one: str, many: str) -> list[str]:
    if number == 0:
        return []
    return [f"1 {what} {one} and is left out" if number == 1 else f"{number} {what}s {many} and are left out"]
