"""Voxels below a pixel: which are merged for a view, and what their pictures show, against rays through a ball."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from itertools import pairwise, product

import numpy as np
import pytest

from pointsplat_addon.core.numeric.pixel_filter import blackman_harris
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.volume import Medium, Volume
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare import hierarchies
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.prepare.separation import separate_translucent
from scripts.scenes import build, drawing
from scripts.scenes.build import moved
from scripts.scenes.cameras import camera
from scripts.scenes.store import STORE

VOXELS = 40  # along the radius of 1
WIDTH = 2.4  # of what is seen
SKY = World(color=np.ones(3))


@cache
def ball() -> Volume:
    """The unit ball as voxels, of which those at the rim are filled in part."""
    index = np.stack(np.meshgrid(*3 * [np.arange(-VOXELS - 1, VOXELS + 2)], indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = (np.arange(4) + 0.5) / 4 - 0.5
    inside = np.sum([((index + o) ** 2).sum(axis=1) < VOXELS**2 for o in product(*3 * [offsets])], axis=0) / 64
    some = inside > 0
    matrix = np.diag([1 / VOXELS] * 3 + [1.0])
    return Volume("ball of even blocks", "Ball", index[some].astype(np.int32), matrix,
                  {"density": inside[some].astype(np.float32)})  # fmt: skip


def scene(depth: float):
    """The ball, with an optical depth across it, before a sky of 1."""
    table = replace(build.materials(), media=(Medium(density=depth / 2, color=np.zeros(3)),))
    thing = Geometry(f"ball {depth}", "Ball", volume=ball())
    return build.scene((thing, moved((0.003, 0.002, 0.001))), lights=(), world=SKY, table=table)


def eye(size: int, perspective: bool = False, **more):
    sized = {"field_of_view": 0.5} if perspective else {"parallel": WIDTH}
    return camera((2.6, -4.0, 2.2), (0, 0, 0), resolution=(size, size), **sized, **more)


def truth(size: int, depth: float) -> np.ndarray:
    """exp(-depth of the chord) by a pixel filter of 1.5 pixels, (size, size) float64, from 16x16 rays a pixel."""
    view = eye(size).view_from_world
    middle = view[:3, :3] @ (0.003, 0.002, 0.001) + view[:3, 3]
    margin, fine = 2, 16
    at = ((np.arange((size + 2 * margin) * fine) + 0.5) / fine - margin - size / 2) * WIDTH / size
    away = (at[None] - middle[0]) ** 2 + (at[:, None] - middle[1]) ** 2
    rays = np.exp(-0.5 * depth * 2 * np.sqrt(np.maximum(1 - away, 0)))
    weights = blackman_harris((np.arange(-margin * fine, (margin + 1) * fine) + 0.5) / fine - 0.5, 1.5)
    weights /= weights.sum()
    rows = np.stack([weights @ rays[fine * y : fine * (y + 2 * margin + 1)] for y in range(size)])
    return np.stack([rows[:, fine * x : fine * (x + 2 * margin + 1)] @ weights for x in range(size)], axis=1)


def count(view, instances=1, **more) -> int:
    """How many splats are drawn of thin balls."""
    thing = scene(0.5).geometries[0]
    made = build.scene(*[(thing, moved((1e-3 * i, 0, 0))) for i in range(instances)], lights=(), world=SKY)
    made = replace(made, materials=scene(0.5).materials)
    separate, _ = separate_translucent(made, STORE)
    layer = prepare(separate, view, Settings(technique="VISIBILITY"), 16, STORE, **more).translucent
    return layer.cut.splats // instances


@pytest.mark.parametrize(
    ("size", "depth", "rmse", "worst"),
    [
        (17, 0.5, 0.0006, 0.0018),
        (17, 4.0, 0.0038, 0.013),
        (34, 0.5, 0.0012, 0.0051),
        (34, 4.0, 0.0054, 0.024),
        (68, 0.5, 0.0015, 0.0076),
        (68, 4.0, 0.0087, 0.051),
    ],
)
def test_a_ball_lets_through_what_its_chords_say(size, depth, rmse, worst, monkeypatch):
    """By blocks of 0.71 and 1.41 pixels. The bounds are what was measured, rounded up; most of it is the rim of voxels,
    which is as soft as their kernel: merging adds to the squared error of dense balls less than a hundredth."""
    request = Request(eye(size), Settings(use_adaptive_sampling=False), frozenset({"combined"}), 16)
    expected, errors = truth(size, depth), []
    for widest in (hierarchies.WIDEST_BLOCK, 1e-9):
        monkeypatch.setattr(hierarchies, "WIDEST_BLOCK", widest)
        errors.append(drawing.opengl().render(scene(depth), request).pixels["combined"][..., 0] - expected)
    merged, voxels = ((error**2).mean() for error in errors)
    assert merged**0.5 < rmse
    assert np.abs(errors[0]).max() < worst
    if depth == 4.0:
        assert merged < 1.01 * voxels


def test_voxels_are_merged_as_far_as_they_are_small():
    """Up to one and a half pixels; at another distance of perspective cameras; not at all where one is near."""
    every = len(ball().index)
    counts = [count(eye(size)) for size in (17, 34, 68, 80)]
    assert counts[3] == every
    assert counts[0] < 0.03 * every  # most of which is the rim, that stays
    assert all(1.4 * few < many for few, many in pairwise(counts))
    near, far = (camera((0, -away, 0), resolution=(40, 40), field_of_view=3.2) for away in (0.5, 84.0))
    assert count(near) == every
    assert count(far) == counts[1]


def test_a_flat_ball_beside_a_lamp_is_drawn():
    """An object without an extent along an axis has no space of its own in which a lamp could lie."""
    thing, lamp = scene(0.5).geometries[0], Light("POINT", np.ones(3), np.zeros(3), np.array([0, 0, -1.0]), radius=0.1)
    made = build.scene((thing, np.diag([1.0, 1.0, 0.0, 1.0])), lights=(lamp,), world=SKY)
    request = Request(eye(34), Settings(), frozenset({"combined"}), 4)
    assert np.isfinite(drawing.opengl().render(made, request).pixels["combined"]).all()


def test_nodes_count_among_the_widest_splats():
    """In a viewport an octree's nodes are as wide as the tolerance, wherever its voxels are smaller."""
    store, settings = Store(), Settings(technique="VISIBILITY", tolerance=6.0)

    def drawn():
        separate, _ = separate_translucent(scene(0.5), store)
        return prepare(separate, eye(20), settings, 16, store, interactive=True)

    drawn()
    while store.building:
        time.sleep(0.01)
    prepared = drawn()
    assert prepared.translucent.cut.nodes > 0
    assert prepared.widest_translucent >= 6.0


def test_every_tile_of_a_picture_has_the_same_voxels():
    """Though a part of them alone is in its window."""
    whole = eye(34)
    assert {count(replace(whole, region=region)) for region in ((0, 0, 8, 8), (16, 16, 20, 30))} == {count(whole)}


def test_viewports_and_crowds_have_all_voxels():
    every = len(ball().index)
    assert count(eye(34), instances=hierarchies.MOST_INSTANCES + 1) == every
    assert count(eye(34), instances=2) < every / 2
    assert count(eye(34), interactive=True) == every
