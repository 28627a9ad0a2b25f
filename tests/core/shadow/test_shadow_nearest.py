"""What a table knows of the nearest entry around a direction, which tells how far soft shadows reach."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.shadow import builder
from pointsplat_addon.render.shadow.packed_tables import pack
from scripts.common.shadow_truth import LOOSE, SHARP, nearest_around, receiver_of, transmittance

DOWN = np.array([0.0, 0.0, -1.0])
LIGHTS = {
    "sun": Light("SUN", np.ones(3), np.zeros(3), np.array([0.36, 0.48, -0.8]), radius=0.05),
    "outside": Light("POINT", np.ones(3), np.array([0.0, 0.2, 3.0]), DOWN, radius=0.2),
    "inside": Light("POINT", np.ones(3), np.array([0.05, 0.1, 0.0]), DOWN, radius=0.1),
    "seam": Light("POINT", np.ones(3), np.array([0.0, 0.0, 1.1]), DOWN, radius=0.1),
}


def disks(count: int, radius: float, seed: int) -> builder.Casters:
    """Facing anywhere, in a cube of side 2."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0][:, :2] * radius
    return builder.Casters(
        "OPAQUE", np.zeros(3), rng.uniform(-1, 1, (count, 3)).astype(np.float32), axes=axes.astype(np.float32)
    )


def cells(level) -> tuple[np.ndarray, ...]:
    """Latitude, longitude, width along the row and nearest entry (O,) of a level's cells."""
    cell, grid = level.occupied(), level.grid
    row = np.searchsorted(grid.first, cell, side="right") - 1
    longitude = (cell - grid.first[row] + grid.column0[row]) / grid.density[row]
    return grid.latitude[row], longitude, 1 / grid.density[row], level.distance[level.links[:-1]]


@pytest.mark.parametrize("name", LIGHTS)
def test_no_entry_that_a_look_up_reads_is_nearer(name):
    table = builder.build_table(LIGHTS[name], [disks(300, 0.004, 1), disks(60, 0.04, 2)], 256)
    assert len({level.grid.step for level in table.levels}) >= 2
    rng = np.random.default_rng(3)
    receiver = rng.uniform(-1, 1, (400, 3)) @ table.frame.light_from_world.T
    latitude, longitude, _ = table.frame.spherical(receiver + table.frame.light_from_world @ (-table.frame.origin))
    cosine = np.ones(400) if table.frame.parallel else np.cos(latitude)
    for reach in (0.0, 2.0, 8.0, 30.0):
        reach = np.full(400, reach * table.frame.step)
        found = nearest_around(table.nearest, latitude, longitude, reach / np.maximum(cosine - 1 + LOOSE, 1e-3))
        least = np.full(400, np.inf)
        for level in table.levels:
            there, along, width, distance = cells(level)
            away = longitude[:, None] - along
            if level.grid.wraps:
                away = (away + np.pi) % (2 * np.pi) - np.pi
            near = np.abs(latitude[:, None] - there) <= reach[:, None] + level.grid.step
            near &= np.abs(away) <= reach[:, None] / cosine[:, None] + width
            least = np.minimum(least, np.where(near, distance, np.inf).min(axis=1))
        assert (found <= least).all()
    assert table.nearest.least == min(level.distance.min() for level in table.levels)


def test_where_nothing_is_near_soft_shadows_are_looked_up_as_hard_ones():
    """A floor and a ball over its middle: the floor's own entries are near, whatever else the table holds."""
    x = (np.arange(100) + 0.5) / 25 - 2
    floor = np.stack(np.meshgrid(x, x, [0.0]), axis=-1).reshape(-1, 3).astype(np.float32)
    axes = np.tile(np.eye(3, dtype=np.float32)[:2] * 0.03, (len(floor), 1, 1))
    ball = disks(300, 0.03, 0)
    ball = replace(ball, position=ball.position * 0.2 + np.array([0, 0, 2], np.float32))
    light = replace(LIGHTS["sun"], radius=np.radians(0.526) / 2)  # Blender's
    table = builder.build_table(light, [builder.Casters("OPAQUE", np.zeros(3), floor, axes=axes), ball], 256)
    up = np.tile([0.0, 0, 1], (len(floor), 1))
    spread = (
        receiver_of(table, floor.astype(float), up).spread_at_nearest(table) * table.emitter.radius / table.frame.step
    )
    # Measured 0.84.
    assert (spread <= SHARP).mean() > 0.8
    shaded = transmittance(table, floor.astype(float), up) < 0.9
    assert shaded.any()
    assert (spread[shaded] > SHARP).all()


def test_lamps_without_a_size_carry_no_squares():
    casters = [disks(300, 0.02, 0)]
    soft = builder.build_table(LIGHTS["outside"], casters, 64)
    hard = builder.build_table(replace(LIGHTS["outside"], radius=0.0), casters, 64)
    assert len(hard.nearest.distance) == 1 < len(soft.nearest.distance)
    assert pack([hard]).squares.tolist() == [0]
    assert pack([soft]).squares[0] > 0
