"""Chooses the groups at which indirect light is gathered: one in each cell of space for surfaces that are turned alike.

Cells have edges of a power of two, and of the groups in one that is chosen which lies nearest to its middle: where the
camera moves, mostly the same place of a surface.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....core.indirect.sites import FINE, Sites, cell_keys, cells, scrambled, sites
from ....core.numeric.record import record
from ....core.numeric.vectors import dot
from ...passes.indirect.interpolate import TILE
from ...passes.uniforms import SampleView

SIDES = 4 * TILE, 2 * TILE, TILE  # of squares of pixels that have receivers, one after the other
MAIN = 0.3  # of all groups in a cell, that those of a receiver are where not every square has one: not among hairs
TURNS = 2  # steps of normals along each axis, either way
ALIKE = 0.95  # cosine between normals of a receiver and of what the picture shows where its cell's middle is
SAME_PLANE, SUNK = 0.1, 0.01  # edges that the middle may lie above that, and below: in hollows it would be in the dark
LIFT = 0.05  # edges that sites are raised: what stands for a curved surface lies now above, now below it
FACING = 1e-3  # sine between normals of surfaces that face each other
CORNERS = 2  # walls, at most, that sites are kept away from
WIDEST = 1.5  # edges of cells over the side of the squares of pixels that they stand for, at most; half of it at least


@record
class Receivers:
    """R groups of a list, sorted by tile."""

    rows: np.ndarray  # (R,) int64, of the list
    pixels: np.ndarray  # (R, 2) float32: where in the picture they are
    level: np.ndarray  # (R,) float64: binary logarithm of their cells' edges
    tiles: np.ndarray  # (rows, columns, 2) float32: the first receiver of each tile, and how many it has

    @property
    def none(self) -> Receivers:
        """None of them."""
        return Receivers(self.rows[:0], self.pixels[:0], self.level[:0], np.zeros_like(self.tiles))

    def without_tiles(self, which: np.ndarray) -> Receivers:
        """Returns some of them, (R,) bool, without telling in which tiles they are."""
        return Receivers(self.rows[which], self.pixels[which], self.level[which], np.zeros_like(self.tiles))


@record
class Groups:
    """N groups of a picture."""

    eye: np.ndarray  # (3,) float64, in the space of the light tree
    position: np.ndarray  # (N, 3) float64, in it
    normal: np.ndarray  # (N, 3) float32, unit
    depth: np.ndarray  # (N,) float32; 0: there is none
    pixel: np.ndarray  # (N,) int64, row by row
    balls: np.ndarray | None = None  # (N,) bool: which are of balls; None: none


def sites_of(groups: Groups, rows: np.ndarray, level: np.ndarray, view: SampleView, sole: np.ndarray | None) -> Sites:
    """Returns the sites of groups `rows` (n,) in cells of 2^level, (n,): the middle of each cell, in the group's plane,
    where the picture shows that this surface is there; else a place next to the group. Both are raised a little, and
    lie before other surfaces that the pixels around show, not in or behind these.

    `sole`: (H * W,), of sole_groups; None: groups are seen by way of mirrors, in which cells may be wider than rooms.
    They have places next to them, no farther away or higher than if they were seen directly.
    """
    position, normal = groups.position[rows], groups.normal[rows].astype(np.float64)
    if sole is None:
        away = np.linalg.norm(position - groups.eye, axis=1) if view.camera.perspective else np.ones(len(rows))
        level = np.minimum(level, _levels(away, view, SIDES[0]))
    edge = np.exp2(level)
    shown = np.full(view.size[0] * view.size[1], -1)
    there = np.flatnonzero(groups.depth != 0)
    shown[groups.pixel[there]] = there
    near, beside = sites(position, normal, level, FINE), position
    for _ in range(CORNERS):
        away = _above_what_is_beside(groups, rows, near.position, edge, shown, view.size[0])
        moved = np.flatnonzero(away.any(axis=1))
        if len(moved) == 0:
            break
        # By a step of the lattice, in the group's plane; not where they face each other.
        along = away[moved] - (away[moved] * normal[moved]).sum(axis=1, keepdims=True) * normal[moved]
        along *= (edge[moved] / FINE)[:, None] / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), FACING)
        beside = beside.copy()
        beside[moved] += along
        near = sites(beside, normal, level, FINE)
    if sole is None:
        found = near
    else:
        found = _middles(groups, position, normal, level, view, sole, near)
        away = _above_what_is_beside(groups, rows, found.position, edge, shown, view.size[0])
        found = near.take(away.any(axis=1), found)
    return replace(found, position=found.position + (LIFT * np.exp2(level))[:, None] * found.normal)


def _above_what_is_beside(
    groups: Groups, rows: np.ndarray, place: np.ndarray, edge: np.ndarray, shown: np.ndarray, width: int
) -> np.ndarray:
    """Returns normals (n, 3) of surfaces beside groups `rows` (n,), in hollows, that places (n, 3) do not lie before by
    LIFT edges (n,); (0, 0, 0): of none.

    `shown` (H * W,): a group of each pixel; -1: none. Those next to a group's count.
    """
    position, normal = groups.position.take(rows, axis=0).T, groups.normal.take(rows, axis=0).T
    found, least = np.zeros((len(rows), 3)), np.full(len(rows), LIFT)
    x, y = groups.pixel[rows] % width, groups.pixel[rows] // width
    for step in range(9):
        at = np.clip(y + step // 3 - 1, 0, len(shown) // width - 1) * width + np.clip(x + step % 3 - 1, 0, width - 1)
        other = shown[at]
        turned = groups.normal.take(other, axis=0).T
        some = np.flatnonzero((other >= 0) & (dot(normal, turned) < ALIKE))
        turned, there, size = turned[:, some], groups.position.take(other[some], axis=0).T, edge[some]
        to = there - position[:, some]
        higher, before = dot(to, normal[:, some]), -dot(to, turned)
        hollow = (dot(to, to) < size**2) & (higher > SUNK * size) & (before > -SUNK * size)
        above = dot(place[some].T - there, turned) / size
        nearer = np.flatnonzero(hollow & (above < least[some]))
        found[some[nearer]], least[some[nearer]] = turned[:, nearer].T, above[nearer]
    return found


def _middles(
    groups: Groups,
    position: np.ndarray,
    normal: np.ndarray,
    level: np.ndarray,
    view: SampleView,
    sole: np.ndarray,
    near: Sites,
) -> Sites:
    """Returns sites in the middles of cells, where the picture shows that the surface is there, and `near` elsewhere;
    see sites_of."""
    middle = sites(position, normal, level)
    at = middle.position - groups.eye
    x, y, z = view.world_from_view[:3, :3].T @ at.T
    fx, fy, cx, cy = view.camera.pixel_from_view()
    depth = np.maximum(-z, 1e-30) if view.camera.perspective else np.ones(len(z))
    width, height = view.size
    with np.errstate(all="ignore"):
        column, row = np.floor(cx + fx * x / depth), np.floor(cy + fy * y / depth)
    within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    other = sole[np.where(within, row * width + column, 0).astype(np.int64)]
    within &= other >= 0
    off = ((middle.position - groups.position[other]) * groups.normal[other]).sum(axis=1) / np.exp2(level)
    alike = (groups.normal[other] * normal).sum(axis=1) > ALIKE
    return middle.take(within & alike & (off > -SUNK) & (off < SAME_PLANE), near)


def _levels(away: np.ndarray, view: SampleView, side: int) -> np.ndarray:
    """(N,) float64: binary logarithms of the edges of cells that stand for squares of `side` pixels of surfaces so far
    `away`, (N,)."""
    with np.errstate(divide="ignore"):
        return np.floor(np.log2(WIDEST * side / view.camera.pixel_from_view()[0] * away))


def sole_groups(groups: Groups, view: SampleView) -> np.ndarray:
    """Returns the group of each pixel that has no other, (H * W,) int64; -1: it has none, or several."""
    width, height = view.size
    there = np.flatnonzero(groups.depth != 0)
    found = np.full(width * height, -1)
    found[groups.pixel[there]] = there
    found[np.bincount(groups.pixel[there], minlength=width * height) != 1] = -1
    return found


def directions_to_eye(view: SampleView, place: np.ndarray) -> np.ndarray:
    """(N, 3), unit, of places from the eye (N, 3)."""
    if not view.camera.perspective:
        return np.broadcast_to(view.world_from_view[:3, 2].astype(place.dtype), place.shape)
    return -place / np.maximum(np.linalg.norm(place, axis=1, keepdims=True), 1e-30)


def choose_receivers(groups: Groups, view: SampleView, side: int, fewest: int | np.ndarray, every: bool) -> Receivers:
    """Chooses receivers among groups.

    `side`: of a tile, in pixels. `fewest`: groups that a receiver stands for, one number or (N,); `every`: where no
    tile around has one, one is chosen for fewer.
    """
    width, height = view.size
    there = np.flatnonzero(groups.depth != 0)
    pixel, position, normal = (of.take(there, axis=0) for of in (groups.pixel, groups.position, groups.normal))
    x, y = pixel % width, pixel // width
    columns, rows = -(-width // side), -(-height // side)
    tile = (y // side) * columns + x // side
    away = groups.depth[there].astype(np.float64) if view.camera.perspective else np.ones(len(there))
    level = _levels(away, view, side)
    cell, off = cells(position, level)
    turned = np.clip(np.floor((normal.T * 0.999 + 1) * TURNS), 0, 2 * TURNS - 1)
    turned = turned[0] + 2 * TURNS * (turned[1] + 2 * TURNS * turned[2])
    in_cell = cell_keys(cell.T, scrambled(level.astype(np.int64).view(np.uint64)))
    key = scrambled(in_cell ^ scrambled(turned.astype(np.uint64)))
    order = np.argsort(key)
    first = np.flatnonzero(np.append(True, key[order][1:] != key[order][:-1])) if len(order) else order
    number = np.diff(np.append(first, len(order)))
    of_cell = np.empty(len(order), np.int64)
    of_cell[order] = np.repeat(np.arange(len(first)), number)
    nearest = _nearest(off, order, first, of_cell)
    enough = number >= (fewest[there[nearest]] if isinstance(fewest, np.ndarray) else fewest)
    if not every:
        _, owner = np.unique(in_cell[nearest], return_inverse=True)
        enough &= number > MAIN * np.bincount(owner, number)[owner]
    chosen = nearest[enough]
    if every:
        bare = np.flatnonzero(~_with_neighbours(tile[chosen], rows, columns)[tile])
        best = bare[np.lexsort((off[bare], -number[of_cell[bare]], tile[bare]))]
        chosen = np.concatenate([chosen, best[np.diff(tile[best], prepend=-1) > 0]])
    # The largest come first; by their keys they would depend on the unit of length.
    chosen = chosen[np.lexsort((chosen, -number[of_cell[chosen]], tile[chosen]))]
    counts = np.bincount(tile[chosen], minlength=rows * columns)
    starts = np.cumsum(counts) - counts
    tiles = np.stack([starts, counts], axis=1).astype(np.float32).reshape(rows, columns, 2)
    pixels = np.stack([x[chosen], y[chosen]], axis=1).astype(np.float32) + np.float32(0.5)
    return Receivers(there[chosen], pixels, level[chosen], tiles)


def _nearest(off: np.ndarray, order: np.ndarray, first: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Which of N items is the nearest of each of G groups, (G,): the first of those that are least `off`, (N,). `order`
    (N,): groups follow one another, and begin at `first` (G,); `group` (N,)."""
    if len(order) == 0:
        return order
    least = np.minimum.reduceat(off[order], first)
    return np.minimum.reduceat(np.where(off <= least[group], np.arange(len(order)), len(order))[order], first)


def _with_neighbours(tile: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """(rows * columns,) bool: tiles that are among `tile` (n,), or next to one."""
    found = np.zeros((rows + 2, columns + 2), bool)
    y, x = tile // columns, tile % columns
    for step in range(9):
        found[y + step // 3, x + step % 3] = True
    return found[1:-1, 1:-1].ravel()
