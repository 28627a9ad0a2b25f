"""What a view cannot see of many instances is left out before it is prepared, and pictures stay the same to the bit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.frame import frame
from pointsplat_addon.render.frame.visibility import crowds, occlusion, polygon_draws, tiles
from pointsplat_addon.render.prepare.meshes import crowd
from scripts.common import tower
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import opengl, render

SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)
PASSES = frozenset({"combined", "depth", "normal", "object_index", "crypto_object"})
COLORS = np.array([[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8], [0.6, 0.6, 0.1]])
VIEWS = {
    "street": cameras.camera((0.02, -0.9, 0.05), (0, 2, 0.2), resolution=(96, 72), near=0.02, far=60),
    "above": cameras.camera((0.5, -4, 3), (0, 0, 0), resolution=(96, 72), near=0.02, far=60),
    "parallel": cameras.camera((0, -6, 0.2), resolution=(96, 72), near=0.05, far=60, parallel=1.0),
}


@pytest.fixture
def seen(monkeypatch) -> list[Any]:
    """Which instances each picture was prepared with, where each four of them are a cell."""
    found: list[Any] = []

    def recorded(*given):
        scene, known = crowds.without_unseen(*given)
        found.append(scene.instances.seen)
        return scene, known

    monkeypatch.setattr(frame, "without_unseen", recorded)
    # Which triangles compute shaders draw follows from all that is in the picture, and they round in another way.
    monkeypatch.setattr(polygon_draws, "are_small", lambda *given: False)
    for module, name, value in ((crowd, "FEWEST", 0), (crowds, "FEWEST", 0), (crowd, "IN_CELL", 4),
                                (occlusion, "FEWEST_TRIANGLES", 0), (occlusion, "LEAST_PROMISE", 0.0),
                                (occlusion, "MOST_WORK", 1.0)):  # fmt: skip
        monkeypatch.setattr(module, name, value)
    opengl().store.clear()
    return found


def city(side: int = 12, wall: bool = False) -> Scene:
    """Towers, and a wall across the street, which is no crowd."""
    of = build.mesh(meshes.small_tower("tower"))
    things = [(of, matrix) for matrix in tower.grid(side)]
    if wall:
        position = np.array([[-9, 0.6, -3], [9, 0.6, -3], [9, 0.6, 3], [-9, 0.6, 3]], np.float32)
        things.append((build.mesh(meshes.flat_mesh("wall", position, np.array([[0, 1, 2], [0, 2, 3]]))), np.eye(4)))
    return build.scene(*things, table=build.materials(4, base_color=COLORS))


def drawn(scene: Scene, view: str, samples: int = 16) -> dict[str, np.ndarray]:
    return render(Case(scene, VIEWS[view], SETTINGS), PASSES, samples).pixels


@pytest.mark.parametrize("wide", [8.0, 48.0], ids=["towers", "cells"])
@pytest.mark.parametrize("cells", [1 << 21, 1 << 15], ids=["one tile", "tiles"])
@pytest.mark.parametrize(("view", "samples"), [("street", 16), ("street", 34), ("above", 16), ("parallel", 16)])
def test_pictures_are_the_same_to_the_bit(view, samples, cells, wide, seen, monkeypatch):
    scene = city()
    monkeypatch.setattr(tiles, "FEWEST_CELLS", cells)
    monkeypatch.setattr(tiles, "IN_INSTANCE", 0)
    monkeypatch.setattr(crowds, "WIDE", wide)
    found = drawn(scene, view, samples)
    assert view == "parallel" or not seen[-1].all()
    monkeypatch.setattr(crowd, "FEWEST", 1 << 60)
    for key, expected in drawn(scene, view, samples).items():
        np.testing.assert_array_equal(found[key], expected, err_msg=key)
    assert seen[-1] is None


def test_what_lies_behind_the_eye_and_behind_others_is_left_out(seen):
    scene = city()
    drawn(scene, "street")
    # The street is 3 units long before the eye: of 144 towers 30 lie behind it, and 60 beside the picture.
    behind = scene.instances.world_from_object[:, 1, 3] < -1.2
    assert not (seen[-1] & behind).any()
    assert 10 < seen[-1].sum() < 50


def test_what_is_no_crowd_hides_a_crowd_too(seen):
    scene = city(wall=True)
    drawn(scene, "street")
    beyond = scene.instances.world_from_object[:, 1, 3] > 0.9
    assert seen[-1][-1]
    assert not (seen[-1] & beyond).any()


def test_instances_that_are_hidden_from_cameras_stay_so(seen):
    scene = city()
    flags = np.arange(len(scene.instances)) % 2 == 0
    scene = replace(scene, instances=replace(scene.instances, seen=flags))
    drawn(scene, "street")
    assert not (seen[-1] & ~flags).any()
