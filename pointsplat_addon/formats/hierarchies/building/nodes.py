"""Merges points and nodes into the nodes of coarser pages, and codes them.

Rows (ROWS + A, n) float64 stand for elements: weight (squared radius of the balls, summed), mean position (3),
covariance about it (6), weighted means of the squared radius and of A attributes. Balls have half the spacing of their
page as radius. Sums are taken about each node's own mean, as in core/lod/balls.
"""

from __future__ import annotations

import numpy as np

from ....core.lod.balls.tree import FEW_SATURATION, ONE_SATURATION, SPREAD, merged_rows
from ....core.numeric.linear import bilinear_form
from ....core.numeric.record import record
from ....core.surface.neighbourhoods.planes import eigenvalues, smallest_eigenvector
from ..pages import (
    Layout,
    decode_length,
    encode_color,
    encode_length,
    encode_normal,
    encode_position,
    frames,
    grid_of,
    linear_of_code,
    pack,
)
from .octree import cell_codes, sorted_codes

ROWS = 11
GRID = 7  # levels from a page's cube to the finest cells of its nodes
MOST = 1 << 14  # elements of a page
FEWER = 0.35  # of the elements below, which a page's nodes are at most, where cells of two to a side are coarser still
FINEST = 14  # levels of the cells by which elements are sorted
FLAT = 1e-3  # length of the mean normal from which on nodes lie in its plane
LEAST_AXIS = 1e-4  # of half-axes in the longest: nodes of points on a line or a plane are no thinner


@record
class Elements:
    """Elements of a page, in Morton order."""

    rows: np.ndarray  # (ROWS + A, n)
    classes: dict[str, np.ndarray]  # attributes that cannot be averaged (n,)


def attribute_rows(layout: Layout) -> dict[str, slice]:
    """Which rows hold the means of which attributes."""
    found, at = {}, ROWS
    for name, width in [
        *([("color", 3)] if layout.color else []),
        *([("normal", 3)] if layout.normal else []),
        *((name, 1) for name, kind in layout.attributes if name != "classification"),
    ]:
        found[name] = slice(at, at + width)
        at += width
    return found


def row_count(layout: Layout) -> int:
    return max((rows.stop for rows in attribute_rows(layout).values()), default=ROWS)


def elements_of_points(
    layout: Layout, position: np.ndarray, columns: dict[str, np.ndarray], spacing: float
) -> Elements:
    """Points (3, N) float64 as elements; columns: color (N, 3) uint8, normal (N, 3) and attributes (N,)."""
    rows = np.zeros((row_count(layout), position.shape[1]))
    rows[0] = rows[10] = max(0.5 * spacing, 1e-15) ** 2
    rows[1:4] = position
    for name, which in attribute_rows(layout).items():
        if name == "color":
            rows[which] = linear_of_code()[columns[name].T]
        else:
            rows[which] = columns[name].T
    return Elements(rows, {n: columns[n] for n, _ in layout.attributes if n == "classification"})


def joined(parts: list[Elements]) -> Elements:
    if len(parts) == 1:
        return parts[0]
    classes = {name: np.concatenate([p.classes[name] for p in parts]) for name in parts[0].classes}
    return Elements(np.concatenate([p.rows for p in parts], axis=1), classes)


def merged(elements: Elements, low: np.ndarray, edge: float) -> tuple[Elements, float]:
    """The nodes that stand for elements in a cube, and the edge of their cells.

    Cells are the finest, of at most 2^GRID to a side, for which there are at most MOST nodes and few against elements.
    """
    order, code = sorted_codes(cell_codes(elements.rows[1:4], low.tolist(), edge, FINEST), 3 * FINEST)
    step = code[1:] ^ code[:-1]
    most = min(MOST, FEWER * len(order))
    depth = GRID
    while depth > 1 and 1 + np.count_nonzero(step >> np.uint64(3 * (FINEST - depth))) > most:
        depth -= 1
    first = np.flatnonzero(np.r_[True, step >> np.uint64(3 * (FINEST - depth)) > 0])
    ends = np.append(first, len(order))
    in_order = bool((order[1:] > order[:-1]).all())
    rows = merged_rows(elements.rows if in_order else elements.rows[:, order], ends)
    middle = order[(ends[:-1] + ends[1:]) // 2]
    return Elements(rows, {name: c[middle] for name, c in elements.classes.items()}), edge / 2.0**depth


def pack_nodes(layout: Layout, nodes: Elements, saturation: float) -> tuple[bytes, np.ndarray, np.ndarray, float]:
    """The bytes of a page of nodes, low corner (3,) and steps (3,) of their positions, and the longest half-axis."""
    rows, where = nodes.rows, attribute_rows(layout)
    grid = grid_of(rows[1:4].min(axis=1), rows[1:4].max(axis=1), False)
    covariance = rows[4:10]
    facing = rows[where["normal"]] if layout.normal else None
    normal = _minor_axes(covariance, facing)
    code = encode_normal(normal)
    frame = frames()[code].T.astype(np.float64)
    shape = SPREAD * covariance
    shape[[0, 3, 5]] += rows[10]
    u, v = frame[3:6], frame[6:]
    uu, uv, vv = bilinear_form(shape, u, u), bilinear_form(shape, u, v), bilinear_form(shape, v, v)
    middle, half = 0.5 * (uu + vv), 0.5 * (uu - vv)
    apart = np.hypot(half, uv)
    angle = np.arctan2(uv, half) * (0.5 * 256 / np.pi)  # codes count 1/256 of half a turn
    squares = np.stack([middle + apart, np.maximum(middle - apart, 0), bilinear_form(shape, frame[:3], frame[:3])])
    radii = np.sqrt(np.maximum(squares, LEAST_AXIS**2 * squares[0]))
    longest = float(np.float32(radii.max()))
    lengths = encode_length(radii, longest)
    columns = encode_position(rows[1:4], grid) | {
        "normal": code,
        "angle": (np.round(angle).astype(np.int64) & 255).astype(np.uint8),
        "radii": lengths,
        "covered": _covered(rows, decode_length(lengths[:2], longest), saturation),
    }
    if layout.color:
        columns["color"] = encode_color(rows[where["color"]])
    if facing is not None:
        columns["coherence"] = np.round(np.minimum(np.sqrt((facing * facing).sum(axis=0)), 1) * 255)
    for name, kind in layout.attributes:
        if name in nodes.classes:
            columns[name] = nodes.classes[name]
        else:
            columns[name] = rows[where[name]][0] if kind == "<f4" else np.round(rows[where[name]][0])
    return pack(layout, False, False, columns), np.array(grid.low), np.array(grid.step), longest


def _minor_axes(covariance: np.ndarray, facing: np.ndarray | None) -> np.ndarray:
    """Directions (3, n) across which nodes are thin: mean normals `facing` (3, n) where there are any, else the
    eigenvectors of the least eigenvalues of covariances (6, n)."""
    normal = smallest_eigenvector(covariance, eigenvalues(covariance))
    np.negative(normal, out=normal, where=normal[2] < 0)
    if facing is not None:
        normal = np.where((facing * facing).sum(axis=0) > FLAT**2, facing, normal)
    return normal


def _covered(rows: np.ndarray, half_axes: np.ndarray, saturation: float) -> np.ndarray:
    """Covered fractions as uint8 codes: what balls leave of the largest silhouette of the kernel, of half-axes (2, n).

    Where their areas cover it t times it is covered by 1 - exp(-t (1 + s t)), see core/lod/balls/tree.py.
    """
    balls = rows[0] / rows[10]
    depth = rows[0] / np.maximum(half_axes[0].astype(np.float64) * half_axes[1], 1e-300)
    factor = np.maximum(saturation, FEW_SATURATION / balls)
    factor[balls < 1.01] = ONE_SATURATION
    covered = -np.expm1(-np.minimum(depth * (1 + factor * depth), 50.0))
    return np.maximum(np.round(covered * 255), 1)
