"""A tower block of 350,000 triangles, and grids of it: the scene of Coconu and Hege (2002), table 4, as arrays.

Three tiers, one on the other, of floors with recessed windows; parapets, and a spire. The same every time.
"""

from __future__ import annotations

import numpy as np

TRIANGLES = 350_000
TIERS = ((40, 60), (28, 60), (16, 48))  # cells along a side, floors
FLOOR = 1 / 300  # height of a floor; a cell is as wide. The tower is about 0.65 high and 0.13 wide
RECESS = 0.25  # of a cell: how deep a window lies
FRAME = 0.2  # of a cell: wall on each side of a window
WALL, GLASS, LIT, ROOF = range(4)  # materials
COLORS = ((0.62, 0.55, 0.45), (0.05, 0.08, 0.12), (0.85, 0.62, 0.3), (0.3, 0.12, 0.08))
SPACING = 0.3  # between towers of a grid


def _cell() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners (12, 3), quads (9, 4) and whether each is glass, of a unit cell of a wall that faces -Y."""
    a, b, d = FRAME, 1 - FRAME, RECESS
    outer = [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]
    rim = [(a, 0, a), (b, 0, a), (b, 0, b), (a, 0, b)]
    back = [(x, d, z) for x, _, z in rim]
    around = [(i, (i + 1) % 4) for i in range(4)]
    quads = [(i, j, 4 + j, 4 + i) for i, j in around] + [(4 + i, 4 + j, 8 + j, 8 + i) for i, j in around]
    quads.append((8, 9, 10, 11))
    return np.array(outer + rim + back, float), np.array(quads), np.arange(9) == 8


def _walls(cells: int, floors: int, foot: float, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Quads (Q, 4, 3) of four walls around the Z axis, and their materials (Q,)."""
    corners, quads, glass = _cell()
    column, floor = (a.ravel() for a in np.meshgrid(np.arange(cells), np.arange(floors)))
    at = np.stack([column - cells / 2, np.full(len(column), -cells / 2), floor + foot], axis=1)
    front = (corners[quads][None] + at[:, None, None]).reshape(-1, 4, 3)
    turns = [np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    pane = np.where(rng.random((4, len(column))) < 0.12, LIT, GLASS)
    material = np.where(glass, pane[:, :, None], WALL).reshape(-1)
    return np.concatenate([front @ turn.T for turn in turns]), material


def _roof(cells: int, height: float) -> np.ndarray:
    s = cells / 2
    return np.array([[(-s, -s, height), (s, -s, height), (s, s, height), (-s, s, height)]])


def _spire(height: float, triangles: int) -> np.ndarray:
    """A slender cone of so many triangles, (T, 3, 3)."""
    sides = 7
    rings = triangles // (2 * sides)
    turn = np.arange(sides) / sides * 2 * np.pi
    level = np.linspace(0, 1, rings + 1)
    radius = 3 * (1 - level) ** 1.5 + 0.2
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)[None] * radius[:, None, None]
    rows = np.concatenate([ring, np.broadcast_to((height + 28 * level)[:, None, None], (*ring.shape[:2], 1))], axis=2)
    a, b = rows[:-1], rows[1:]
    right_a, right_b = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    return np.concatenate([np.stack([a, right_a, right_b], 2), np.stack([a, right_b, b], 2)]).reshape(-1, 3, 3)


def tower(
    tiers: tuple[tuple[int, int], ...] = TIERS, triangles: int = TRIANGLES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (V, 3) float32, triangles (T, 3) int32, materials (T,) uint16; it stands on the origin, Z is up.

    Other `tiers` of other cells stand on as much ground; a spire makes up for what they lack of `triangles`.
    """
    rng = np.random.default_rng(7)
    quads, materials, foot = [], [], 0.0
    for cells, floors in tiers:
        walls, material = _walls(cells, floors, foot, rng)
        foot += floors
        quads += [walls, _roof(cells, foot)]
        materials += [material, np.array([ROOF])]
    square, kind = np.concatenate(quads), np.concatenate(materials)
    halves = np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    spire = _spire(foot, triangles - len(halves))
    corners = np.concatenate([halves, spire]) * (FLOOR * TIERS[0][0] / tiers[0][0])
    material = np.concatenate([kind, kind, np.full(len(spire), ROOF)]).astype(np.uint16)
    # Corners that coincide are one vertex, in the order in which they come.
    _, first, place = np.unique(
        np.rint(corners.reshape(-1, 3) * 1e6).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    position = corners.reshape(-1, 3)[first[order]].astype(np.float32)
    return position, rank[place.reshape(-1)].reshape(-1, 3).astype(np.int32), material


def grid(side: int) -> np.ndarray:
    """World matrices (side^2, 4, 4) of towers on a square grid about the origin, turned by quarters, and a little
    higher or lower than each other."""
    rng = np.random.default_rng(3)
    x, y = (a.ravel() for a in np.meshgrid(*[(np.arange(side) - (side - 1) / 2) * SPACING] * 2))
    turn = rng.integers(0, 4, len(x)) * np.pi / 2
    matrix = np.tile(np.eye(4), (len(x), 1, 1))
    matrix[:, 0, 0] = matrix[:, 1, 1] = np.cos(turn)
    matrix[:, 1, 0] = np.sin(turn)
    matrix[:, 0, 1] = -matrix[:, 1, 0]
    matrix[:, 2, 2] = rng.uniform(0.7, 1.15, len(x))
    matrix[:, 0, 3], matrix[:, 1, 3] = x, y
    return matrix
